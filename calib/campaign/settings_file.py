"""Read ``campaign.toml``: sections with defaults, every value checked, units in key names converted and noted."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from calib.campaign.model import Campaign, Logs, Note, RunTable
from calib.campaign.readers.table import LARGEST_VALUE
from calib.campaign.settings import (
    ENCODER_KINDS,
    FRAMES,
    ODOMETRY_SOURCES,
    SPEED_COUNT_M,
    Encoder,
    EncoderKind,
    Odometry,
    OdometryModel,
    Rangefinder,
    Reference,
    recognise,
)
from calib.errors import BadFileError
from calib.limits import (
    LABEL_CHARACTERS,
    SETTINGS_BYTES,
    refuse_beyond,
    refuse_hostile_document,
    refuse_hostile_keys,
)
from calib.vehicle import DRIVES, Vehicle

_POSITIVE: Final = frozenset(
    {
        "track_m",
        "wheelbase_m",
        "wheel_radius_m",
        "mass_kg",
        "max_wheel_load_N",
        "counts_per_rev",
        "counts_per_rev_left",
        "counts_per_rev_right",
        "counts_per_rev_front",
        "front_wheel_radius_m",
        "half_length_plus_half_width_m",
        "radius_left_m",
        "radius_right_m",
        "sigma_m",
        "sigma_xy_m",
        "sigma_theta_rad",
    }
)
_SMALLEST: Final = 1e-12
#: largest size of what would else be degrees or millimetres by mistake
_LARGEST: Final = {"sensor_yaw_rad": 2 * math.pi, "sensor_x_m": 100.0, "sensor_y_m": 100.0}
#: keys that scale every result: a default for them is said as suspicious
_WEIGHTY: Final = {"vehicle": ("track_m", "wheel_radius_m")}


def typed(value: Any, kind: type, shown: str, key: str, expected: str) -> Any:
    """Return a value of the kind expected, or refuse it.

    Parameters
    ----------
    value : object
        What the file says.
    kind : type
        What it has to be.
    shown, key : str
        File and key, for the message.
    expected : str
        What it has to be, in words.

    Raises
    ------
    BadFileError
        Where it is of another kind.
    """
    if not isinstance(value, kind):
        raise BadFileError(shown, column=key, found=repr(value)[:60], expected=expected, remedy="correct the value")
    return value


class Sections:
    """Numbers of the known sections, each key recognised, converted and checked."""

    def __init__(self, document: Mapping[str, Any], shown: str, notes: list[Note], extra: dict[str, Any]) -> None:
        self.document, self.shown, self.notes, self.extra = document, shown, notes, extra
        self.read: set[str] = set()
        self.chosen: set[tuple[str, str]] = set()

    def choice(self, section: str, key: str, allowed: Sequence[str]) -> Any:
        """Return a key that names one of several things, None where it is not given."""
        self.chosen.add((section, key))
        found = typed(self.document.get(section, {}), dict, self.shown, section, f"a section [{section}]").get(key)
        if found is None or found in allowed:
            return found
        expected = " or ".join(f'"{name}"' for name in allowed)
        remedy = "choose one of them, or leave the key out"
        raise BadFileError(self.shown, repr(found)[:60], expected, remedy, column=f"{section}.{key}")

    def numbers(self, section: str, known: Sequence[str]) -> dict[str, float]:
        """Return the section's known keys in SI units; unknown ones go to `extra` and are said."""
        self.read.add(section)
        found = typed(self.document.get(section, {}), dict, self.shown, section, f"a section [{section}]")
        values: dict[str, float] = {}
        for key, value in found.items():
            if (section, key) in self.chosen:
                continue
            column = f"{section}.{key}"
            match = recognise(key, known, further=False)
            if match.name not in known:
                self.extra.setdefault(section, {})[key] = value
                hint = f"; did you mean {match.unitless}? A key names its unit" if match.unitless else ""
                self.notes.append(
                    Note("suspicious", f"{self.shown}, {column}", f"the key is not known and not used{hint}", "key")
                )
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(_float(value)) <= LARGEST_VALUE:
                raise BadFileError(
                    self.shown, repr(value)[:60], "a finite number below 1e30", "correct it", column=column
                )
            if match.name in values:
                raise BadFileError(self.shown, "the key in two units", "one", "remove one", column=column)
            number = match.factor * value + match.offset
            if match.name in _POSITIVE and number < _SMALLEST:
                raise BadFileError(self.shown, f"{value:g}", "more than 0", "correct the value", column=column)
            most = _LARGEST.get(match.name)
            if most is not None and abs(number) > most:
                expected = f"at most {most:.4g} in size, in the unit of {match.name}"
                remedy = "name the unit in the key (sensor_yaw_deg, sensor_x_mm), or correct the value"
                raise BadFileError(self.shown, f"{value:g}", expected, remedy, column=column)
            if match.said:
                self.notes.append(Note("info", f"{self.shown}, {column}", match.said, "unit"))
            values[match.name] = number
        missing = [key for key in _WEIGHTY.get(section, ()) if key not in values]
        if missing:
            self.notes.append(
                Note(
                    "suspicious",
                    f"{self.shown}, {section}",
                    f"{', '.join(missing)} not given; the defaults of a 0.7 m track, 0.1 m wheel vehicle are used; "
                    "give the vehicle's own",
                    "default_vehicle",
                )
            )
        return values


def _float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


FORMAT: Final = "calib-campaign/1"

_VEHICLE: Final = tuple(field.name for field in fields(Vehicle) if field.name != "drive")
_REFERENCE: Final = tuple(field.name for field in fields(Reference) if field.name != "frame")
_MODEL: Final = tuple(field.name for field in fields(OdometryModel) if field.name not in {"front", "mecanum"})
_ENCODER: Final = ("counts_per_rev", "counts_per_rev_left", "counts_per_rev_right", "counts_per_rev_front", "wrap_bits")

#: what a laboratory has to state, by section; results lean on each of them
STATED: Final[Mapping[str, tuple[str, ...]]] = {
    "vehicle": ("track_m", "wheelbase_m", "wheel_radius_m", "mass_kg", "cog_x_m"),
    "encoder": ("counts_per_rev",),
    "rangefinder": ("sigma_m",),
    "reference": ("sigma_xy_m", "sigma_theta_rad"),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """What ``campaign.toml`` says, with what was said on the API."""

    name: str
    simulated: bool
    vehicle: Vehicle
    encoder: Encoder
    model: OdometryModel
    rangefinder: Rangefinder
    reference: Reference
    odometry: Odometry
    extra: Mapping[str, Any]
    notes: tuple[Note, ...]
    assumed: tuple[str, ...] = ()

    def campaign(self, runs: RunTable, logs: Logs, **further: Any) -> Campaign:
        """Return the campaign of these settings; `further` fields of `Campaign` default to what a new one has."""
        own = {part.name: getattr(self, part.name) for part in fields(self)}
        return Campaign(**{"root": None, **own, "notes": (), "runs": runs, "logs": logs, **further})


def read_settings(path: Path, shown: str) -> Settings:
    """Read and check ``campaign.toml``.

    With defaults where keys are missing; without ``[model]`` the simulator believes in the nominal vehicle. Raises
    BadFileError where the file is missing, is no TOML, or holds a value of the wrong kind or range.
    """
    return parse_settings(load_toml(path, shown), shown, path.parent.resolve().name)


def parse_settings(document: dict[str, Any], shown: str, default_name: str) -> Settings:
    """Check a settings document; see `read_settings`. Its keys ``format``, ``name``, ``simulated`` are taken out."""
    notes: list[Note] = []
    found_format = document.pop("format", None)
    if found_format is None:
        notes.append(Note("info", shown, f'no format is given; "{FORMAT}" was assumed', "format"))
    elif found_format != FORMAT:
        raise BadFileError(
            shown,
            column="format",
            found=repr(found_format)[:60],
            expected=f'"{FORMAT}"',
            remedy="convert the campaign, or correct the key if it is one of this format",
        )
    name = typed(document.pop("name", default_name), str, shown, "name", "a text")
    refuse_beyond(len(name), LABEL_CHARACTERS, shown=shown, what="characters", remedy="shorten it", column="name")
    simulated = typed(document.pop("simulated", False), bool, shown, "simulated", "true or false")
    declared = _declared(document, shown)
    extra: dict[str, Any] = {}
    section = Sections(document, shown, notes, extra)
    drive = section.choice("vehicle", "drive", DRIVES)
    geometry: dict[str, Any] = section.numbers("vehicle", _VEHICLE) | ({} if drive is None else {"drive": drive})
    vehicle = Vehicle(**geometry)
    encoder = _encoder(section, notes, shown, vehicle)
    believed = section.numbers("model", _MODEL)
    nominal: dict[str, Any] = {
        "radius_left_m": vehicle.wheel_radius_m,
        "radius_right_m": vehicle.wheel_radius_m,
        "track_m": vehicle.track_m,
        "reference_load_N": vehicle.unladen_load_N,
    }
    model = OdometryModel(**(nominal | believed))
    rangefinder = Rangefinder(**section.numbers("rangefinder", ("sigma_m", "min_m", "max_m")))
    frame = section.choice("reference", "frame", FRAMES)
    reference = Reference(**section.numbers("reference", _REFERENCE), frame=frame)
    odometry = Odometry(section.choice("odometry", "from", ODOMETRY_SOURCES))
    section.numbers("odometry", ())
    _check_source(odometry, vehicle, shown)
    if not 0.0 <= vehicle.cog_x_m <= vehicle.wheelbase_m:
        expected = f"a place between rear axle (0) and front wheel ({vehicle.wheelbase_m:g})"
        remedy = "give the centre of mass ahead of the rear axle, in metres"
        raise BadFileError(shown, f"{vehicle.cog_x_m:g}", expected, remedy, column="vehicle.cog_x_m")
    extra = {key: value for key, value in document.items() if key not in section.read} | extra
    assumed = tuple(dict.fromkeys((*declared, *not_stated(document))))
    return Settings(
        name, simulated, vehicle, encoder, model, rangefinder, reference, odometry, extra, tuple(notes), assumed
    )


def not_stated(document: Mapping[str, Any]) -> list[str]:
    """Return the keys of `STATED` that a settings document leaves out, no matter what unit it gives the others in."""
    missing = []
    for section, keys in STATED.items():
        part = document.get(section, {})
        given = {recognise(key, keys, further=False).name for key in part} if isinstance(part, Mapping) else set()
        of_sides = {"counts_per_rev_left", "counts_per_rev_right"} <= set(part)
        if section == "encoder" and (of_sides or part.get("kind") == "speed"):
            given.add("counts_per_rev")
        missing += [f"{section}.{key}" for key in keys if key not in given]
    return missing


def _declared(document: dict[str, Any], shown: str) -> list[str]:
    """Take out the key ``assumed``: what an earlier program filled in."""
    declared = typed(document.pop("assumed", []), list, shown, "assumed", 'a list of keys, as ["rangefinder.sigma_m"]')
    return [str(typed(key, str, shown, "assumed", "keys as texts")) for key in declared]


def load_toml(path: Path, shown: str, *, remedy: str = "") -> dict[str, Any]:
    """Return a TOML file as read, within the sizes of `calib.limits`, with errors that name the place.

    `remedy`: what to do where there is none; without it, how to make a campaign.
    """
    if not path.is_file():
        raise BadFileError(
            shown,
            found="a folder" if path.is_dir() else "no such file",
            expected="a settings file",
            remedy=remedy or "give a folder that holds campaign.toml, or make one with 'calib ingest'",
        )
    try:
        size = path.stat().st_size
        refuse_beyond(size, SETTINGS_BYTES, shown=shown, what="bytes", remedy="check that it is a settings file")
        data = path.read_bytes()
        text = data.decode("utf-16" if data[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig")
        refuse_hostile_keys(text, shown)
        document = tomllib.loads(text)
    except OSError as error:
        raise BadFileError(
            shown, found=error.strerror or "an unreadable file", expected="a readable file", remedy="check its rights"
        ) from error
    except UnicodeError as error:
        raise BadFileError(shown, "text that is not UTF-8", "UTF-8, as TOML asks", "save the file as UTF-8") from error
    except (tomllib.TOMLDecodeError, ValueError, RecursionError) as error:
        raise BadFileError(
            shown, f"no valid TOML ({str(error)[:120]})", "key = value lines and [sections]", "correct the line"
        ) from error
    refuse_hostile_document(document, shown)
    return document


def _check_source(odometry: Odometry, vehicle: Vehicle, shown: str) -> None:
    """Refuse an odometry that the vehicle's drive cannot have."""
    expected = {"front": ("tricycle",), "wheels": ("mecanum",), "shaft": ("ackermann",)}.get(odometry.source or "rear")
    if expected is not None and vehicle.drive not in expected:
        raise BadFileError(
            shown,
            column="odometry.from",
            found=f'"{odometry.source}" with [vehicle] drive = "{vehicle.drive}"',
            expected=f'"{odometry.source}" with drive = "{expected[0]}" only',
            remedy="correct the one that is wrong",
        )


def _encoder(section: Sections, notes: list[Note], shown: str, vehicle: Vehicle) -> Encoder:
    kind: EncoderKind = section.choice("encoder", "kind", ENCODER_KINDS) or "counts"
    values = section.numbers("encoder", _ENCODER)
    # speeds have no counts: the way is kept in counts of SPEED_COUNT_M
    of_speed = 2.0 * math.pi * vehicle.wheel_radius_m / SPEED_COUNT_M if kind == "speed" else None
    both = values.get("counts_per_rev", of_speed)
    left, right = values.get("counts_per_rev_left", both), values.get("counts_per_rev_right", both)
    if left is None or right is None:
        notes.append(
            Note(
                "suspicious",
                f"{shown}, encoder.counts_per_rev",
                "not given for both wheels; 4096 is used for what is missing, and every radius scales with it",
                "default_encoder",
            )
        )
    bits = values.get("wrap_bits")
    if bits is not None and bits not in {8, 12, 13, 16, 20, 24, 32}:
        expected = "16 or 32 (8, 12, 13, 20, 24 are read too)"
        remedy = "give the width of the counter, or remove the key where it does not wrap"
        raise BadFileError(shown, f"{bits:g}", expected, remedy, column="encoder.wrap_bits")
    return Encoder(
        counts_per_rev_left=4096.0 if left is None else left,
        counts_per_rev_right=4096.0 if right is None else right,
        wrap_bits=None if bits is None else int(bits),
        counts_per_rev_front=values.get("counts_per_rev_front"),
        kind=kind,
    )
