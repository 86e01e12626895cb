"""Reading the coefficient file by the standard library alone: units, ranges and checksum are verified."""

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

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


def _stored(place: str, unit: str, **limits: float) -> tuple[str, str, dict[str, float]]:
    # place: section and key in the file; limits: see `_number`
    return place, unit, limits


@dataclass(frozen=True, slots=True)
class WheelCoefficients:
    """Law of one wheel: radius = radius_ref + slope (load - reference_load), valid from `load_min_N` to `load_max_N`.

    With the covariance of (radius_ref, slope), and the scatter of single runs about the law, `residual_std_m`.
    """

    radius_ref_m: Annotated[float, _stored("wheel.radius_ref", "m", above=0.0)]
    slope_m_per_N: Annotated[float, _stored("wheel.slope", "m/N")]
    reference_load_N: Annotated[float, _stored("wheel.reference_load", "N", low=0.0)]
    variance_radius_ref_m2: Annotated[float, _stored("wheel.variance_radius_ref", "m^2", low=0.0)]
    covariance_m2_per_N: Annotated[float, _stored("wheel.covariance_radius_ref_slope", "m^2/N")]
    variance_slope_m2_per_N2: Annotated[float, _stored("wheel.variance_slope", "m^2/N^2", low=0.0)]
    residual_std_m: Annotated[float, _stored("wheel.residual_std", "m", low=0.0)]
    load_min_N: Annotated[float, _stored("valid.min", "N", low=0.0)]
    load_max_N: Annotated[float, _stored("valid.max", "N", low=0.0)]
    counts_per_rev: float

    def radius_m(self, load_N: float) -> float:
        """Return the radius at `load_N`; the valid range is the caller's to obey."""
        return self.radius_ref_m + self.slope_m_per_N * (load_N - self.reference_load_N)


@dataclass(frozen=True, slots=True)
class Coefficients:
    """A coefficient file as the vehicle uses it, in SI units.

    `outside`: ``refuse`` or ``clamp`` a load that was not measured; `load_table`: name -> wheel loads (left, right);
    `cross_covariance`: numbers in `JOINT` of parameters estimated together, and their covariance; `unapplied_effects`:
    of the simulator's model, that this odometry lacks; `failed_checks`: what makes the law doubtful, as sentences;
    `run_covariance_m2`: of both radii, by single runs.
    """

    name: str
    simulated: bool
    checksum: str
    outside: str
    left: WheelCoefficients
    right: WheelCoefficients
    track_m: Annotated[float, _stored("vehicle.track", "m", above=0.0)]
    track_std_m: Annotated[float, _stored("vehicle.track_std", "m", low=0.0)]
    wheelbase_m: Annotated[float, _stored("vehicle.wheelbase", "m", above=0.0)]
    mass_kg: Annotated[float, _stored("vehicle.mass", "kg", above=0.0)]
    cog_x_m: Annotated[float, _stored("vehicle.cog_x", "m")]
    cog_y_m: Annotated[float, _stored("vehicle.cog_y", "m")]
    load_track_m: Annotated[float, _stored("vehicle.load_track", "m", above=0.0)]
    load_wheelbase_m: Annotated[float, _stored("vehicle.load_wheelbase", "m", above=0.0)]
    max_wheel_load_N: Annotated[float, _stored("vehicle.max_wheel_load", "N", low=0.0)]
    gravity_mps2: Annotated[float, _stored("vehicle.gravity", "m/s^2", above=0.0)]
    wrap_bits: int | None
    along_m_per_sqrt_m: Annotated[float, _stored("noise.along", "m/m^0.5", low=0.0)]
    heading_rad_per_sqrt_m: Annotated[float, _stored("noise.heading", "rad/m^0.5", low=0.0)]
    count_std: Annotated[float, _stored("noise.count_std", "count", low=0.0)]
    max_step_m: Annotated[float, _stored("limits.max_step", "m", above=0.0)]
    max_gap_s: Annotated[float, _stored("limits.max_gap", "s", above=0.0)]
    load_table: dict[str, tuple[float, float]]
    cross_covariance: tuple[tuple[int, int, float], ...]
    unapplied_effects: tuple[str, ...]
    failed_checks: tuple[str, ...] = ()
    run_covariance_m2: float = 0.0

    def takes(self, loads_N: Sequence[float], nearest_N: Sequence[float]) -> bool:
        """Return whether loads hold: the nearest valid ones are equal, or replace them where a wheel can carry them."""
        clamps, most_N = self.outside == "clamp", self.max_wheel_load_N
        pairs = zip(loads_N, nearest_N, strict=True)
        return all(load_N == near_N or (clamps and 0.0 < load_N <= most_N) for load_N, near_N in pairs)

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
            wrap_bits=None if wrap is None else _bits(encoder),
            load_table=table,
            cross_covariance=_cross_covariance(document),
            run_covariance_m2=_run_covariance_m2(document),
            unapplied_effects=tuple(str(item.get("effect")) for item in _parts(document, "effects")),
            failed_checks=tuple(map(str, document.get("failed_checks") or ())),
            **_numbers(cls, vehicle=("vehicle", own), noise=("noise", noise), limits=("limits", limits)),
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


def _numbers(kind: type, **sections: tuple[str, dict[str, Any]]) -> dict[str, Any]:
    # a class's values by field; sections: by name in `_stored`, place and content
    values = {}
    for field, hint in get_type_hints(kind, include_extras=True).items():
        for place, unit, limits in getattr(hint, "__metadata__", ()):
            name, _, key = place.partition(".")
            at, section = sections[name]
            values[field] = _number(section, key, unit, at, **limits)
    return values


def _wheel(document: dict[str, Any], side: str) -> WheelCoefficients:
    at = f"wheels.{side}"
    wheel = _part(_part(document, "wheels"), side)
    valid = _part(wheel, "valid_load")
    numbers = _numbers(WheelCoefficients, wheel=(at, wheel), valid=(f"{at}.valid_load", valid))
    per_rev = _number(_part(document, "encoder"), f"counts_per_rev_{side}", "count/rev", "encoder", above=0.0)
    coefficients = WheelCoefficients(counts_per_rev=per_rev, **numbers)
    if coefficients.load_min_N > coefficients.load_max_N:
        raise CoefficientError(f"{at}.valid_load: min stands above max")
    return coefficients


def _cross_covariance(document: dict[str, Any]) -> tuple[tuple[int, int, float], ...]:
    together = document.get("joint_geometry")
    if together is None:
        return ()
    together = _part(document, "joint_geometry")
    if together.get("source") != "rear":
        raise CoefficientError("joint_geometry: odometry from other wheels; this one reads two wheels on one axle")
    names = list(JOINT)
    entries = []
    for index, entry in enumerate(_parts(together, "covariance")):
        pair = (entry.get("first"), entry.get("second"))
        if not set(pair) <= set(names):
            continue
        first, second = sorted(names.index(str(name)) for name in pair)
        if first // 2 == second // 2:
            continue
        one, other = (JOINT[str(name)] for name in pair)
        unit = f"({one})^2" if one == other else f"({one})({other})"
        entries.append((first, second, _number(entry, "covariance", unit, f"joint_geometry.covariance.{index}")))
    return tuple(entries)


def _run_covariance_m2(document: dict[str, Any]) -> float:
    together = document.get("joint_geometry") or {}
    shared = together.get("run_covariance") is not None
    return _number(together, "run_covariance", "m^2", "joint_geometry") if shared else 0.0


def _part(document: dict[str, Any], key: str) -> dict[str, Any]:
    section = document.get(key)
    if not isinstance(section, dict):
        raise CoefficientError(f"{key}: missing")
    return section


def _parts(document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    sections = document.get(key, [])
    if not isinstance(sections, list) or not all(isinstance(item, dict) for item in sections):
        raise CoefficientError(f"{key}: no list of sections")
    return sections


def _bits(encoder: dict[str, Any]) -> int:
    bits = _number(encoder, "wrap_bits", "bit", "encoder", low=8.0)
    if bits != int(bits) or bits > 48:
        raise CoefficientError(f"encoder.wrap_bits: {bits} is no whole number up to 48")
    return int(bits)


def _number(
    section: dict[str, Any], key: str, unit: str, at: str, *, low: float = -math.inf, above: float = -math.inf
) -> float:
    quantity = section.get(key)
    if not isinstance(quantity, dict) or quantity.get("unit") != unit:
        raise CoefficientError(f"{at}.{key}: missing, or its unit is not {unit}")
    value = quantity.get("value")
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
