"""The coefficient file: the master from which vehicle, controller and simulator get the radius law."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from datetime import date
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, ValidationError, model_validator

from calib.campaign.model import Campaign
from calib.campaign.settings import FrontModel, MecanumModel, OdometryModel, OdometrySource, Reference
from calib.campaign.wheels import STEERED
from calib.coefficients import sections
from calib.coefficients.sections import Quantity, Section, VehicleSection, WheelsSection, first_fault, validated
from calib.documents import checksum, to_json
from calib.errors import BadFileError, BadInputError, ImplausibleError, RefusedError
from calib.radius.law import JOINT, RadiusLaw
from calib.types import FloatArray, floats, unit_of
from calib.vehicle import Drive, Vehicle

FORMAT: Final = "calib-coefficients/1"
#: what ``calib geometry --into`` and ``--json`` write, with the coefficient file as a section
GEOMETRY_FORMAT: Final = "calib-geometry/1"
GEOMETRY_FILE: Final = "geometry.json"

Outside = Literal["refuse", "clamp"]

#: a coefficient file has some 10 kB
FILE_LIMIT_BYTES: Final = 16 << 20


class EncoderSection(Section):
    """Rear-wheel encoders; wrap_bits is null where the counter does not wrap."""

    counts_per_rev_left: sections.CountsPerRev
    counts_per_rev_right: sections.CountsPerRev
    wrap_bits: sections.Bits | None = None


class CovarianceEntry(Section):
    """Covariance of two parameters of the geometry; of one with itself: its variance."""

    first: str
    second: str
    covariance: Quantity


class GeometrySection(Section):
    """Geometry estimated together: every parameter of the drive, and the joint covariance of those determined.

    Of other drives than two wheels on an axle too, and with the terms that couple left, right and track. Parameters
    without a variance were not determined and keep their nominal value. run_covariance: of a single run's scatter
    about both laws.
    """

    drive: Drive
    source: OdometrySource
    parameters: dict[str, Quantity]
    covariance: list[CovarianceEntry]
    run_covariance: Quantity | None = None

    @model_validator(mode="after")
    def _known(self) -> Self:
        names = {name for entry in self.covariance for name in (entry.first, entry.second)}
        if not names <= set(self.parameters):
            raise ValueError(f"covariance names {', '.join(sorted(names - set(self.parameters)))}, which have no value")
        return self

    @property
    def values(self) -> dict[str, float]:
        """Value of each parameter."""
        return {name: quantity.value for name, quantity in self.parameters.items()}

    @classmethod
    def of_together(
        cls,
        drive: str,
        source: str,
        values: Mapping[str, float],
        names: Sequence[str],
        covariance: FloatArray,
        run_covariance_m2: float | None,
    ) -> Self:
        """Return the section of parameters estimated together.

        Parameters
        ----------
        drive, source, values
            Drive, wheels of the odometry, and all parameters.
        names, covariance
            Those that were determined, and their covariance.
        run_covariance_m2
            By the scatter of single runs; None: not estimated.
        """
        units = {name: unit_of(name) for name in values}
        entries = []
        for row, column in combinations_with_replacement(range(len(names)), 2):
            one, other = units[names[row]], units[names[column]]
            unit = f"({one})^2" if one == other else f"({one})({other})"
            entry = Quantity.of(value=float(covariance[row, column]), unit=unit)
            entries.append(CovarianceEntry.of(first=names[row], second=names[column], covariance=entry))
        return cls.of(
            drive=drive,
            source=source,
            parameters={name: Quantity.of(value=value, unit=units[name]) for name, value in values.items()},
            covariance=entries,
            run_covariance=None if run_covariance_m2 is None else Quantity.of(value=run_covariance_m2, unit="m^2"),
        )


class AcceptedSection(Section):
    """Findings beyond the bounds of the vehicle that the user passed on, and why."""

    reason: str
    findings: list[str]


class InputFile(Section):
    """A file that the coefficients were computed from."""

    path: str
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class CoefficientFile(Section):
    """A coefficient file as read or about to be written; immutable.

    Numbers carry their unit in the file; `law`, `geometry` and `radius_m` give plain SI arrays. The checksum covers
    everything else; `changed` makes a variant with a checksum of its own.
    """

    format: Literal["calib-coefficients/1"]
    calib_version: str
    name: str
    created: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")] | None = None
    simulated: bool
    outside: Outside
    wheels: WheelsSection
    vehicle: VehicleSection
    encoder: EncoderSection
    noise: sections.NoiseSection
    limits: sections.LimitsSection
    load_table: list[sections.LoadPoint] = Field(default_factory=list)
    effects: list[sections.EffectSection] = Field(default_factory=list)
    joint_geometry: GeometrySection | None = None
    #: fields that were neither measured nor stated
    assumed: list[str] = Field(default_factory=list)
    inputs: list[InputFile] = Field(default_factory=list)
    accepted_implausible: AcceptedSection | None = None
    #: of the law, each with its sentence; not in the file where all passed
    failed_checks: list[str] = Field(default_factory=list)
    checksum: Annotated[str, Field(pattern="^sha256:[0-9a-f]{64}$")]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        bits = math.inf if self.encoder.wrap_bits is None else self.encoder.wrap_bits.value
        for side, wheel in self.wheels:
            per_rev = getattr(self.encoder, f"counts_per_rev_{side}").value
            half = 2.0 ** (bits - 1.0) / per_rev * 2.0 * math.pi * wheel.radius_ref.value
            if self.limits.max_step.value >= 0.9 * half:
                raise ValueError(f"limits.max_step: half a wrap of the counter is {half:.3g} m, a step must be less")
        if self.created is not None:
            date.fromisoformat(self.created)
        names = [point.name for point in self.load_table]
        if len(set(names)) != len(names):
            raise ValueError("load_table: two lines have the same name")
        return self

    def to_dict(self) -> dict[str, Any]:
        """Return the document as plain Python values, in the order of the file."""
        return self.model_dump(mode="json", exclude=None if self.failed_checks else {"failed_checks"})

    def to_bytes(self) -> bytes:
        """Return the file's content: UTF-8 JSON; the same bytes for the same content."""
        return to_json(self.to_dict()).encode("utf-8")

    def changed(self, **changes: Any) -> "CoefficientFile":
        """Return the file with `changes` (models or plain values) replaced and a new checksum."""
        return sealed(**{**self.to_dict(), **changes})

    def calibrated(self, **lengths_m: float) -> "CoefficientFile":
        """Return the file with the odometry's `track` and `wheelbase`; the wheel loads keep to the vehicle's own."""
        vehicle = self.to_dict()["vehicle"]
        for name, length_m in lengths_m.items():
            if length_m != vehicle[name]["value"]:
                vehicle |= {f"load_{name}": vehicle[name], name: {"value": length_m, "unit": "m"}}
        return self.changed(vehicle=vehicle)

    def accepted(self, reason: str, findings: Sequence[str]) -> "CoefficientFile":
        """Return the file with the findings beyond the bounds that the user accepts; the file itself without any."""
        if not findings:
            return self
        return self.changed(accepted_implausible={"reason": reason, "findings": list(findings)})

    @property
    def law(self) -> RadiusLaw:
        """The laws of both wheels, for arrays; they ignore the valid range."""
        shared = None if self.joint_geometry is None else self.joint_geometry.run_covariance
        return RadiusLaw(self.wheels.left.law, self.wheels.right.law, self._joint(), shared.value if shared else 0.0)

    @property
    def together(self) -> dict[str, float]:
        """Value of each parameter estimated together; empty without a geometry."""
        return {} if self.joint_geometry is None else self.joint_geometry.values

    def sensor(self, stated: Reference) -> Reference:
        """Return the reference with its sensor where the geometry found it; as `stated` without one."""
        return replace(stated, **{name: self.together.get(name, getattr(stated, name)) for name in SENSOR_PLACES})

    def refuse_other_vehicle(self, campaign: Campaign) -> None:
        """Raise RefusedError where the file was made for another vehicle than the campaign's.

        Drive and counts a revolution are stated; radii and track may differ as far as calibration moves them.
        """
        from calib.kinematics.readings import PLAUSIBLE_CHANGE, PLAUSIBLE_TRACK_CHANGE, implausible

        own, theirs, encoder = self.geometry, campaign.vehicle, campaign.encoder
        differences = []
        if own.drive != theirs.drive and {own.drive, theirs.drive} != {"differential", "skid"}:
            differences.append(f"drive {own.drive} (not {theirs.drive})")
        # a front wheel with counts of its own needs none of the rear wheels
        for name in ("counts_per_rev_left", "counts_per_rev_right") if encoder.counts_per_rev_front is None else ():
            one, other = getattr(self.encoder, name).value, getattr(encoder, name)
            if not math.isclose(one, other):
                differences.append(f"{name} {one:.10g} (not {other:.10g})")
        lengths = [("wheel_radius_m", wheel.radius_ref.value, PLAUSIBLE_CHANGE) for _, wheel in self.wheels]
        # four mecanum wheels turn about their length and width, not about a track
        lengths += [("track_m", own.track_m, PLAUSIBLE_TRACK_CHANGE)] if theirs.drive != "mecanum" else []
        for name, value, most in lengths if self.accepted_implausible is None else ():
            if implausible(name, value / getattr(theirs, name), most, theirs.drive):
                differences.append(f"{name} {value:.4g} (not {getattr(theirs, name):.4g})")
        if differences:
            raise RefusedError(
                f"coefficients of {self.name}: found {', '.join(dict.fromkeys(differences))}; expected the vehicle of "
                f"{campaign.name}; give coefficients of this vehicle, or correct campaign.toml"
            )

    def _joint(self) -> FloatArray | None:
        together = self.joint_geometry
        if together is None or together.source != "rear":
            return None
        joint = RadiusLaw(self.wheels.left.law, self.wheels.right.law).covariance(self.vehicle.track_std.value)
        for entry in together.covariance:
            if entry.first in JOINT and entry.second in JOINT:
                one, other = JOINT.index(entry.first), JOINT.index(entry.second)
                joint[one, other] = joint[other, one] = entry.covariance.value
        return joint

    @property
    def geometry(self) -> Vehicle:
        """The vehicle."""
        numbers = self.vehicle.si()
        stated = {part.name: numbers[part.name] for part in fields(Vehicle) if part.name in numbers}
        stated["front_wheel_radius_m"] = self.together.get("front_radius_m", stated["front_wheel_radius_m"])
        return Vehicle(
            **stated,
            drive=self.vehicle.drive if self.joint_geometry is None else self.joint_geometry.drive,
            half_length_plus_half_width_m=self.together.get("half_length_plus_half_width_m"),
        )

    @property
    def loaded(self) -> Vehicle:
        """The vehicle with the lengths by which its wheel loads are computed."""
        lengths = self.vehicle.si("load_track", "load_wheelbase").items()
        return replace(self.geometry, **{name.removeprefix("load_"): m for name, m in lengths if m is not None})

    def radius_m(self, load_left_N: ArrayLike, load_right_N: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the radii (left, right) for loads of any shape.

        Raises RefusedError where one lies outside the valid range and the file says ``refuse``, or no wheel can carry
        it; BadInputError where it is not finite.
        """
        return _radius(self, "left", load_left_N), _radius(self, "right", load_right_N)


def load_coefficients(path: Path | str) -> CoefficientFile:
    """Read a coefficient file, or that of a geometry's result, and verify its schema and checksum.

    Raises BadFileError; ImplausibleError where the geometry is doubtful or wrong and was not accepted.
    """
    path = Path(path)
    path = within if (within := path / GEOMETRY_FILE).is_file() else path
    try:
        if path.stat().st_size > FILE_LIMIT_BYTES:
            raise _bad(path, f"{path.stat().st_size} bytes", f"at most {FILE_LIMIT_BYTES}")
        document = json.loads(path.read_bytes().decode("utf-8-sig"), object_pairs_hook=_no_duplicates)
    except OSError as error:
        raise BadFileError(path, error.strerror or "no file", "a coefficient file", "give the path of one") from error
    except (ValueError, RecursionError) as error:
        raise _bad(path, f"no JSON ({error})", "the JSON that calib export writes") from error
    if isinstance(document, dict) and document.get("format") == GEOMETRY_FORMAT:
        if document.get("coefficients") is None and document.get("why"):
            raise ImplausibleError(f"{path}, geometry {document.get('verdict')}", document["why"])
        document = document.get("coefficients")
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        format_found = document.get("format") if isinstance(document, dict) else type(document).__name__
        raise _bad(path, f"format {format_found!r}", repr(FORMAT), column="format")
    try:
        file = CoefficientFile.model_validate(document)
        computed = checksum(document)
    except ValidationError as error:
        where, actual, expected = first_fault(error)
        raise _bad(path, actual, expected, column=where or None) from error
    except (ValueError, OverflowError) as error:
        raise _bad(path, str(error), "finite numbers") from error
    if computed != file.checksum:
        actual, expected = f"content of {computed[:19]}", f"{file.checksum[:19]} as written in the file"
        remedy = "the file was altered or damaged: export it again"
        raise BadFileError(path, actual, expected, remedy, column="checksum")
    # the checksum covers the file as it is written, with or without optional sections
    written = checksum(file.to_dict())
    return file if written == computed else file.model_copy(update={"checksum": written})


def sealed(**parts: Any) -> CoefficientFile:
    """Return the coefficient file of its sections, as models or plain values, with the checksum of its content."""
    file = validated(CoefficientFile, {**parts, "checksum": "sha256:" + "0" * 64})
    return file.model_copy(update={"checksum": checksum(file.to_dict())})


def believed_model(file: CoefficientFile, reference_load_N: float) -> OdometryModel:
    """Return the odometry's model of a coefficient file, centred on a load; with its steering or four wheels."""
    law, values = file.law, file.together
    front = mecanum = None
    source = "rear" if file.joint_geometry is None else file.joint_geometry.source
    if source in STEERED:
        from calib.kinematics import drives

        radius = "front_radius_m" if source == "front" else "rear_radius_m"
        names = (radius, "wheelbase_m", drives.STEERING_ZERO, drives.STEERING_SCALE)
        slips = (values.get(name, 0.0) for name in (drives.UNDERSTEER, drives.SIDE_SLIP))
        front = FrontModel(*(values[name] for name in names), *slips)
    left_m, right_m = (float(wheel.radius_m(reference_load_N)) for wheel in (law.left, law.right))
    if source == "wheels":
        grown = (left_m + right_m) / (law.left.radius_ref_m + law.right.radius_ref_m)
        mecanum = MecanumModel(grown * values["wheel_radius_m"], values["half_length_plus_half_width_m"])
    slopes = law.left.slope_m_per_N, law.right.slope_m_per_N
    return OdometryModel(left_m, right_m, file.geometry.track_m, reference_load_N, *slopes, front, mecanum)


#: how the ids of effects begin that act on an instrument, not on the vehicle
OF_INSTRUMENTS: Final = ("rangefinder_", "reference_", "beam_", "gyro_")
#: where the reference's sensor is, as settings and parameters name it
SENSOR_PLACES: Final = ("sensor_x_m", "sensor_y_m", "sensor_yaw_rad")


def effects_left_out(file: CoefficientFile, what: str) -> tuple[str, ...]:
    """Return which of the model's effects `what` lacks, and what that means."""
    if not file.effects:
        return ()
    names = ", ".join(dict.fromkeys(effect.effect for effect in file.effects))
    return (f"{what}: {names} of the model; its radius laws and its track alone are used", *fitted_beside(file))


def fitted_beside(file: CoefficientFile) -> tuple[str, ...]:
    """Return what a vehicle has to expect that lacks effects which act on it."""
    if all(effect.effect.startswith(OF_INSTRUMENTS) for effect in file.effects):
        return ()
    return (
        "with radii and track alone a vehicle may err more than with the model before: 'calib diagnose --apply' says "
        "by how much",
    )


def _radius(file: CoefficientFile, side: str, load_N: ArrayLike) -> FloatArray:
    wheel, loads = getattr(file.wheels, side), floats(load_N)
    low, high = wheel.valid_load.min.value, wheel.valid_load.max.value
    if not np.isfinite(loads).all():
        raise BadInputError(f"{side} wheel load: found NaN or infinity; expected newtons; check the load sensor")
    clamps = (file.outside == "clamp") & (loads > 0.0) & (loads <= file.vehicle.max_wheel_load.value)
    if (((loads < low) | (loads > high)) & ~clamps).any():
        worst = float(loads.flat[int(np.argmax(np.maximum(low - loads, loads - high)))])
        raise RefusedError(
            f"{side} wheel load: found {worst:g} N; expected {low:g} to {high:g} N, the loads measured and 1 % of "
            "their span (at least 1 N) beyond; measure there, give another load, or export with --outside clamp"
        )
    return np.asarray(wheel.law.radius_m(np.clip(loads, low, high)))


def _no_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, object]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("an object has the same key twice")
    return document


def _bad(path: Path, actual: str, expected: str, *, column: str | None = None) -> BadFileError:
    return BadFileError(path, column=column, found=actual, expected=expected, remedy="export the coefficients again")
