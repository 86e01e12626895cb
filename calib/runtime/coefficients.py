"""Reading the coefficient file with the standard library alone: units, ranges and checksum are verified."""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["CoefficientError", "Coefficients", "WheelCoefficients"]

FORMAT = "calib-coefficients/1"
#: parameters of the pose's covariance in their order, and their units
JOINT = {
    "radius_left_m": "m",
    "slope_left_m_per_N": "m/N",
    "radius_right_m": "m",
    "slope_right_m_per_N": "m/N",
    "track_m": "m",
}


class CoefficientError(ValueError):
    """A coefficient file that cannot be used; the text says where and why in one line."""


@dataclass(frozen=True, slots=True)
class WheelCoefficients:
    """Law of one wheel: radius = radius_ref + slope (load - reference_load), valid from `load_min_N` to `load_max_N`.

    With the covariance of (radius_ref, slope), and the scatter of single runs about the law, `residual_std_m`.
    """

    radius_ref_m: float
    slope_m_per_N: float
    reference_load_N: float
    variance_radius_ref_m2: float
    covariance_m2_per_N: float
    variance_slope_m2_per_N2: float
    residual_std_m: float
    load_min_N: float
    load_max_N: float
    counts_per_rev: float

    def radius_m(self, load_N: float) -> float:
        """Return the radius at `load_N`; the valid range is the caller's to obey."""
        return self.radius_ref_m + self.slope_m_per_N * (load_N - self.reference_load_N)


@dataclass(frozen=True, slots=True)
class Coefficients:
    """A coefficient file as the vehicle uses it, in SI units.

    `outside`: ``refuse`` or ``clamp`` a load that was not measured; `load_table`: name -> wheel loads (left, right);
    `cross_covariance`: numbers in `JOINT` of parameters estimated together, and their covariance; `unapplied_effects`:
    of the simulator's model, that this odometry lacks.
    """

    name: str
    simulated: bool
    checksum: str
    outside: str
    left: WheelCoefficients
    right: WheelCoefficients
    track_m: float
    track_std_m: float
    wheelbase_m: float
    mass_kg: float
    cog_x_m: float
    cog_y_m: float
    load_track_m: float
    load_wheelbase_m: float
    max_wheel_load_N: float
    gravity_mps2: float
    wrap_bits: int | None
    along_m_per_sqrt_m: float
    heading_rad_per_sqrt_m: float
    count_std: float
    max_step_m: float
    max_gap_s: float
    load_table: dict[str, tuple[float, float]]
    cross_covariance: tuple[tuple[int, int, float], ...]
    unapplied_effects: tuple[str, ...]

    @classmethod
    def read(cls, path: str | Path) -> "Coefficients":
        """Read and verify the file at `path`.

        Raises
        ------
        CoefficientError
            Where the file cannot be read, lacks something, or is not what was written.
        """
        try:
            text = Path(path).read_bytes().decode("utf-8-sig")
        except (OSError, ValueError) as error:
            raise CoefficientError(f"{path}: cannot be read ({error})") from error
        try:
            return cls.parse(text)
        except CoefficientError as error:
            raise CoefficientError(f"{path}: {error}") from error

    @classmethod
    def parse(cls, text: str) -> "Coefficients":
        """Return the coefficients in the JSON `text`; see `read`."""
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise CoefficientError(f"no JSON ({error})") from error
        if not isinstance(document, dict) or document.get("format") != FORMAT:
            raise CoefficientError(f"not of format {FORMAT}")
        try:
            computed = _checksum(document)
        except (ValueError, OverflowError, RecursionError) as error:
            raise CoefficientError(f"holds what is no finite number ({error})") from error
        if document.get("checksum") != computed:
            raise CoefficientError("checksum does not fit: the file was altered or damaged; export it again")
        if document.get("outside") not in ("refuse", "clamp"):
            raise CoefficientError("outside is neither 'refuse' nor 'clamp'")
        encoder = _part(document, "encoder")
        wrap = encoder.get("wrap_bits")
        table = {}
        for index, point in enumerate(_parts(document, "load_table")):
            at = f"load_table.{index}"
            left, right = (_number(point, f"load_{side}", "N", at, low=0.0) for side in ("left", "right"))
            table[str(point.get("name"))] = (left, right)
        vehicle, noise, limits = (_part(document, key) for key in ("vehicle", "noise", "limits"))
        # for wheel loads: the odometry's unless these were calibrated
        own = {f"load_{name}": vehicle.get(name) for name in ("track", "wheelbase")} | vehicle
        coefficients = cls(
            name=str(document.get("name", "")),
            simulated=document.get("simulated") is not False,
            checksum=computed,
            outside=document["outside"],
            left=_wheel(document, "left"),
            right=_wheel(document, "right"),
            track_m=_number(vehicle, "track", "m", "vehicle", above=0.0),
            track_std_m=_number(vehicle, "track_std", "m", "vehicle", low=0.0),
            wheelbase_m=_number(vehicle, "wheelbase", "m", "vehicle", above=0.0),
            mass_kg=_number(vehicle, "mass", "kg", "vehicle", above=0.0),
            cog_x_m=_number(vehicle, "cog_x", "m", "vehicle"),
            cog_y_m=_number(vehicle, "cog_y", "m", "vehicle"),
            load_track_m=_number(own, "load_track", "m", "vehicle", above=0.0),
            load_wheelbase_m=_number(own, "load_wheelbase", "m", "vehicle", above=0.0),
            max_wheel_load_N=_number(vehicle, "max_wheel_load", "N", "vehicle", low=0.0),
            gravity_mps2=_number(vehicle, "gravity", "m/s^2", "vehicle", above=0.0),
            wrap_bits=None if wrap is None else _bits(encoder),
            along_m_per_sqrt_m=_number(noise, "along", "m/m^0.5", "noise", low=0.0),
            heading_rad_per_sqrt_m=_number(noise, "heading", "rad/m^0.5", "noise", low=0.0),
            count_std=_number(noise, "count_std", "count", "noise", low=0.0),
            max_step_m=_number(limits, "max_step", "m", "limits", above=0.0),
            max_gap_s=_number(limits, "max_gap", "s", "limits", above=0.0),
            load_table=table,
            cross_covariance=_cross_covariance(document),
            unapplied_effects=tuple(str(item.get("effect")) for item in _parts(document, "effects")),
        )
        for side, wheel in (("left", coefficients.left), ("right", coefficients.right)):
            if not (wheel.radius_m(wheel.load_min_N) > 0.0 and wheel.radius_m(wheel.load_max_N) > 0.0):
                raise CoefficientError(f"wheels.{side}: the radius is not above zero in the valid range")
        return coefficients

    def wheel_loads_N(self, payload_kg: float, payload_x_m: float, payload_y_m: float) -> tuple[float, float, float]:
        """Return the static loads (left, right, front) in N under a payload (Eqs 1-2 and the force balance).

        Parameters
        ----------
        payload_kg : float
            Mass of the payload.
        payload_x_m, payload_y_m : float
            Its centre of mass, ahead of the rear axle and left of the centre line.
        """
        total = self.mass_kg + payload_kg
        ahead = (self.mass_kg * self.cog_x_m + payload_kg * payload_x_m) / self.load_wheelbase_m
        aside = (self.mass_kg * self.cog_y_m + payload_kg * payload_y_m) / self.load_track_m
        left = self.gravity_mps2 * (0.5 * (total - ahead) + aside)
        right = self.gravity_mps2 * (0.5 * (total - ahead) - aside)
        return left, right, self.gravity_mps2 * ahead


def _wheel(document: dict[str, Any], side: str) -> WheelCoefficients:
    at = f"wheels.{side}"
    wheel = _part(_part(document, "wheels"), side)
    valid = _part(wheel, "valid_load")
    made = WheelCoefficients(
        radius_ref_m=_number(wheel, "radius_ref", "m", at, above=0.0),
        slope_m_per_N=_number(wheel, "slope", "m/N", at),
        reference_load_N=_number(wheel, "reference_load", "N", at, low=0.0),
        variance_radius_ref_m2=_number(wheel, "variance_radius_ref", "m^2", at, low=0.0),
        covariance_m2_per_N=_number(wheel, "covariance_radius_ref_slope", "m^2/N", at),
        variance_slope_m2_per_N2=_number(wheel, "variance_slope", "m^2/N^2", at, low=0.0),
        residual_std_m=_number(wheel, "residual_std", "m", at, low=0.0),
        load_min_N=_number(valid, "min", "N", f"{at}.valid_load", low=0.0),
        load_max_N=_number(valid, "max", "N", f"{at}.valid_load", low=0.0),
        counts_per_rev=_number(_part(document, "encoder"), f"counts_per_rev_{side}", "count/rev", "encoder", above=0.0),
    )
    if made.load_min_N > made.load_max_N:
        raise CoefficientError(f"{at}.valid_load: min stands above max")
    return made


def _cross_covariance(document: dict[str, Any]) -> tuple[tuple[int, int, float], ...]:
    together = document.get("joint_geometry")
    if together is None:
        return ()
    together = _part(document, "joint_geometry")
    if together.get("source") != "rear":
        raise CoefficientError("joint_geometry: odometry from other wheels; this one reads two wheels on one axle")
    names = list(JOINT)
    found = []
    for index, entry in enumerate(_parts(together, "covariance")):
        pair = (entry.get("first"), entry.get("second"))
        if not set(pair) <= set(names):
            continue
        first, second = sorted(names.index(str(name)) for name in pair)
        if first // 2 == second // 2:
            # within a wheel's own law, which has it
            continue
        one, other = (JOINT[str(name)] for name in pair)
        unit = f"({one})^2" if one == other else f"({one})({other})"
        found.append((first, second, _number(entry, "covariance", unit, f"joint_geometry.covariance.{index}")))
    return tuple(found)


def _part(document: dict[str, Any], key: str) -> dict[str, Any]:
    found = document.get(key)
    if not isinstance(found, dict):
        raise CoefficientError(f"{key}: missing")
    return found


def _parts(document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    found = document.get(key, [])
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise CoefficientError(f"{key}: no list of sections")
    return found


def _bits(encoder: dict[str, Any]) -> int:
    bits = _number(encoder, "wrap_bits", "bit", "encoder", low=8.0)
    if bits != int(bits) or bits > 48:
        raise CoefficientError(f"encoder.wrap_bits: {bits} is no whole number up to 48")
    return int(bits)


def _number(
    section: dict[str, Any], key: str, unit: str, at: str, *, low: float = -math.inf, above: float = -math.inf
) -> float:
    found = section.get(key)
    if not isinstance(found, dict) or found.get("unit") != unit:
        raise CoefficientError(f"{at}.{key}: missing, or its unit is not {unit}")
    value = found.get("value")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise CoefficientError(f"{at}.{key}: its value is no finite number")
    if value < low or value <= above:
        raise CoefficientError(f"{at}.{key}: {value} is out of range")
    return float(value)


def _checksum(document: dict[str, Any]) -> str:
    body = {key: value for key, value in document.items() if key != "checksum"}
    text = json.dumps(_doubles(body), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return "sha256:" + hashlib.sha256(text.encode("ascii")).hexdigest()


def _doubles(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _doubles(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_doubles(item) for item in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
