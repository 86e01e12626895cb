"""``campaign.toml``, read (defaults, values checked, units in key names converted and noted) and written."""

import datetime
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, Field, StrictBool, TypeAdapter, ValidationError

from calib import errors
from calib.campaign.model import Campaign, Logs, Note, RunTable
from calib.campaign.readers.table import LARGEST_VALUE
from calib.campaign.settings import SPEED_COUNT_M, Encoder, Odometry, OdometryModel, Rangefinder, Reference, recognise
from calib.errors import BadFileError, BadInputError
from calib.vehicle import Vehicle

FORMAT: Final = "calib-campaign/1"
#: section -> what it becomes
_SECTIONS: Final[Mapping[str, type]] = {
    "vehicle": Vehicle,
    "encoder": Encoder,
    "model": OdometryModel,
    "rangefinder": Rangefinder,
    "reference": Reference,
    "odometry": Odometry,
}
#: keys that hold a word
_WORDS: Final = frozenset({"drive", "frame", "kind", "from"})
#: fields of the sections' classes that are no keys, and the reverse
_NO_KEYS: Final = frozenset({"front", "mecanum", "source"})
_FURTHER_KEYS: Final = {"encoder": ("counts_per_rev",), "odometry": ("from",)}

#: what a laboratory has to state, by section: results lean on it
STATED: Final[Mapping[str, tuple[str, ...]]] = {
    "vehicle": ("track_m", "wheelbase_m", "wheel_radius_m", "mass_kg", "cog_x_m"),
    "encoder": ("counts_per_rev",),
    "rangefinder": ("sigma_m",),
    "reference": ("sigma_xy_m", "sigma_theta_rad"),
}


class _Heading(BaseModel):
    format: Literal["calib-campaign/1"] | None = None
    name: Annotated[str, Field(max_length=errors.LABEL_CHARACTERS)]
    simulated: StrictBool = False
    #: keys that an earlier program filled in
    assumed: list[str] = []


def read_settings(path: Path, shown: str) -> Campaign:
    """Read and check ``campaign.toml``; returns a campaign without runs.

    Missing keys have defaults; without ``[model]`` it is the nominal vehicle. Raises BadFileError where the file is
    missing, is no TOML, or holds a value of the wrong kind or range.
    """
    return parse_settings(load_toml(path, shown), shown, path.parent.resolve().name)


def parse_settings(document: dict[str, object], shown: str, default_name: str) -> Campaign:
    """Check a settings document; see `read_settings`. Takes out the keys above its sections."""
    heading = {key: document.pop(key) for key in _Heading.model_fields if key in document}
    try:
        head = _Heading.model_validate({"name": default_name, **heading})
    except ValidationError as error:
        raise _refused(error, shown, "", heading) from error
    part = _Sections(document, shown)
    if head.format is None:
        part.notes.append(Note("info", shown, f'no format is given; "{FORMAT}" was assumed', "format"))
    vehicle: Vehicle = part.checked("vehicle")
    if vehicle.cog_x_m > vehicle.wheelbase_m and "vehicle.cog_x_m" in _not_stated(document):
        vehicle = replace(vehicle, cog_x_m=vehicle.cog_x_m * vehicle.wheelbase_m)
    encoder = part.checked("encoder", _counts(part, vehicle))
    radii = dict.fromkeys(("radius_left_m", "radius_right_m"), vehicle.wheel_radius_m)
    nominal = {**radii, "track_m": vehicle.track_m, "reference_load_N": vehicle.unladen_load_N}
    for key in sorted(document.keys() - {*_SECTIONS, *_READ_LATER}):
        part.say(key, "the section or key is not known and not used", "key")
    settings = Campaign(
        root=None,
        name=head.name,
        simulated=head.simulated,
        vehicle=vehicle,
        encoder=encoder,
        model=part.checked("model", nominal | part.keys("model")),
        rangefinder=part.checked("rangefinder"),
        reference=part.checked("reference"),
        odometry=part.checked("odometry"),
        runs=RunTable.empty(),
        logs=Logs.empty(0),
        extra={key: value for key, value in document.items() if key not in part.read} | part.unknown,
        notes=tuple(part.notes),
        assumed=tuple(dict.fromkeys((*head.assumed, *_not_stated(document)))),
    )
    _check_together(settings, shown)
    return settings


#: sections that fit, diagnosis, report and certificate read
_READ_LATER: Final = ("uncertainty", "effects", "report", "certificate")


class _Sections:
    def __init__(self, document: Mapping[str, Any], shown: str) -> None:
        self.document, self.shown = document, shown
        self.notes: list[Note] = []
        self.read: set[str] = set()
        self.unknown: dict[str, dict[str, object]] = {}

    def keys(self, section: str) -> dict[str, object]:
        self.read.add(section)
        table = self.document.get(section, {})
        if not isinstance(table, dict):
            expected, remedy = f"a section [{section}]", "correct the value"
            raise BadFileError(self.shown, repr(table)[:60], expected, remedy, column=section)
        known = _known(section)
        values: dict[str, object] = {}
        for key, value in table.items():
            column = f"{section}.{key}"
            match = recognise(key, known, further=False)
            if match.name not in known:
                self.unknown.setdefault(section, {})[key] = value
                hint = f"; did you mean {match.unitless}? A key names its unit" if match.unitless else ""
                self.say(column, f"the key is not known and not used{hint}", "key")
                continue
            if match.name in values:
                raise BadFileError(self.shown, "the key in two units", "one", "remove one", column=column)
            if match.name not in _WORDS:
                if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_VALUE:
                    expected = "a finite number below 1e30"
                    raise BadFileError(self.shown, repr(value)[:60], expected, "correct it", column=column)
                value = match.factor * value + match.offset
            if match.said:
                self.say(column, match.said, "unit", "info")
            values[match.name] = value
        missing = [key for key in ("track_m", "wheel_radius_m") if section == "vehicle" and key not in values]
        if missing:
            text = f"{', '.join(missing)} not given; a track of 0.7 m and a radius of 0.1 m are used; give your own"
            self.say(section, text, "default_vehicle")
        return values

    def checked(self, section: str, values: Mapping[str, Any] | None = None) -> Any:
        try:
            return _adapter(_SECTIONS[section]).validate_python(self.keys(section) if values is None else values)
        except ValidationError as error:
            table, known = self.document.get(section, {}), _known(section)
            names = {recognise(key, known, further=False).name: key for key in table}
            raise _refused(error, self.shown, section, table, names) from error

    def say(self, column: str, text: str, code: str, level: str = "suspicious") -> None:
        self.notes.append(Note(level, f"{self.shown}, {column}", text, code))


#: of a section's class, made when first asked for
_adapter: Final = lru_cache(TypeAdapter)


def _known(section: str) -> tuple[str, ...]:
    names = (field.name for field in fields(_SECTIONS[section]) if field.name not in _NO_KEYS)
    return (*_FURTHER_KEYS.get(section, ()), *names)


def _refused(
    error: ValidationError, shown: str, section: str, table: Mapping[str, Any], names: Mapping[str, str] | None = None
) -> BadFileError:
    fault = error.errors(include_url=False)[0]
    name, limits = str(fault["loc"][0]), fault.get("ctx", {})
    key = (names or {}).get(name, name)
    remedy = "correct the value, or leave the key out"
    if name == "format":
        remedy = "it is of a newer calib: update this one, or make the campaign anew with 'calib ingest'"
    match fault["type"]:
        case "greater_than_equal" if limits["ge"] > 0:
            expected = "more than 0"
        case "greater_than_equal" | "less_than_equal":
            expected = f"at most {limits.get('le', 0) or -limits['ge']:.4g} in size, in the unit of {name}"
            remedy = "name the unit in the key (sensor_yaw_deg, sensor_x_mm), or correct the value"
        case "literal_error":
            expected = str(limits["expected"]).replace("'", '"')
        case "value_error":
            expected = str(limits["error"])
        case _:
            expected = re.sub("^.* should (be|have) ", "", fault["msg"])
    value = table.get(key, fault["input"])
    shown_value = f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else repr(value)[:60]
    return BadFileError(shown, shown_value, expected, remedy, column=f"{section}.{key}" if section else key)


def _counts(part: _Sections, vehicle: Vehicle) -> dict[str, object]:
    values, sides = part.keys("encoder"), ("counts_per_rev_left", "counts_per_rev_right")
    # speeds have no counts: the distance is in counts of SPEED_COUNT_M
    of_speed = 2.0 * math.pi * vehicle.wheel_radius_m / SPEED_COUNT_M if values.get("kind") == "speed" else None
    if (both := values.pop("counts_per_rev", of_speed)) is not None:
        return dict.fromkeys(sides, both) | values
    if not set(sides) <= values.keys():
        whose = "a rear wheel's radius" if "counts_per_rev_front" in values else "every radius"
        text = f"not given for both wheels; 4096 is used for what is missing, and {whose} scales with it"
        part.say("encoder.counts_per_rev", text, "default_encoder")
    return values


def _check_together(settings: Campaign, shown: str) -> None:
    vehicle, source = settings.vehicle, settings.odometry.source
    drive = {"front": "tricycle", "wheels": "mecanum", "shaft": "ackermann"}.get(source or "", vehicle.drive)
    if vehicle.drive != drive:
        actual, expected = f'"{source}" with [vehicle] drive = "{vehicle.drive}"', f'"{source}" with drive = "{drive}"'
        raise BadFileError(shown, actual, expected, "correct the one that is wrong", column="odometry.from")
    if not 0.0 <= vehicle.cog_x_m <= vehicle.wheelbase_m:
        expected = f"a place between rear axle (0) and front wheel ({vehicle.wheelbase_m:g})"
        remedy = "give the centre of mass ahead of the rear axle, in metres"
        raise BadFileError(shown, f"{vehicle.cog_x_m:g}", expected, remedy, column="vehicle.cog_x_m")


def _not_stated(document: Mapping[str, Any]) -> list[str]:
    missing = []
    for section, keys in STATED.items():
        part = document.get(section, {})
        stated = {recognise(key, keys, further=False).name for key in part} if isinstance(part, Mapping) else set()
        of_sides = {"counts_per_rev_left", "counts_per_rev_right"} <= set(part)
        if section == "encoder" and (of_sides or part.get("kind") == "speed"):
            stated.add("counts_per_rev")
        missing += [f"{section}.{key}" for key in keys if key not in stated]
    return missing


def load_toml(path: Path, shown: str, *, remedy: str = "") -> dict[str, object]:
    """Return a TOML file as read, within the sizes of `calib.errors`; errors name the place.

    `remedy`: what to do without a file.
    """
    if not path.is_file():
        actual, expected = "a folder" if path.is_dir() else "no such file", "a settings file"
        remedy = remedy or "give a folder that holds campaign.toml, or make one with 'calib ingest'"
        raise BadFileError(shown, actual, expected, remedy)
    try:
        size, hint = path.stat().st_size, "check that it is a settings file"
        errors.refuse_beyond(size, errors.SETTINGS_BYTES, shown=shown, what="bytes", remedy=hint)
        data = path.read_bytes()
        text = data.decode("utf-16" if data[:2] in {b"\xff\xfe", b"\xfe\xff"} else "utf-8-sig")
        errors.refuse_hostile_keys(text, shown)
        document = tomllib.loads(text)
    except OSError as error:
        actual = error.strerror or "an unreadable file"
        raise BadFileError(shown, actual, "a readable file", "check its rights") from error
    except UnicodeError as error:
        raise BadFileError(shown, "text that is not UTF-8", "UTF-8, as TOML asks", "save the file as UTF-8") from error
    except (tomllib.TOMLDecodeError, ValueError, RecursionError) as error:
        actual, expected = f"no valid TOML ({str(error)[:120]})", "key = value lines and [sections]"
        raise BadFileError(shown, actual, expected, "correct the line") from error
    errors.refuse_hostile_document(document, shown)
    return document


_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")
#: written only where they differ from their default
_WHERE_GIVEN: Final = frozenset({"drive", "kind", "sensor_x_m", "sensor_y_m", "sensor_yaw_rad"})


def to_toml(document: Mapping[str, Any]) -> str:
    """Return `document` as TOML: plain keys first, then one section a nested mapping.

    Raises BadInputError where a value cannot be written (not finite, None, an unknown type).
    """
    lines: list[str] = []
    _section(document, (), lines)
    return "\n".join(lines).strip("\n") + "\n"


def _section(table: Mapping[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    if path and (len(inner) < len(table) or not table):
        lines += ["", f"[{'.'.join(map(_key, path))}]"]
    lines += [f"{_key(key)} = {toml_value(value, key)}" for key, value in table.items() if key not in inner]
    for key, value in inner.items():
        _section(value, (*path, key), lines)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else toml_value(key)


def toml_value(value: Any, key: str = "value") -> str:
    """Return a value as TOML on one line; see `to_toml`."""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(str(k))} = {toml_value(v, str(k))}" for k, v in value.items()) + "}"
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(item, key) for item in value) + "]"
    if isinstance(value, int | float) and math.isfinite(value):
        return json.dumps(value)
    expected = "a text, number or list that TOML can hold"
    raise BadInputError(f"{key}: found {value!r}; expected {expected}; correct the value")


def written_settings(campaign: Campaign) -> dict[str, object]:
    """Return the document of a campaign's settings, for `to_toml`."""
    document: dict[str, object] = {
        "format": FORMAT,
        "name": campaign.name,
        "simulated": bool(campaign.simulated),
        **({"assumed": list(campaign.assumed)} if campaign.assumed else {}),
        **{key: _plain(getattr(campaign, key)) for key in ("vehicle", "encoder", "model", "rangefinder", "reference")},
        "encoder": _encoder_keys(campaign.encoder),
    }
    if campaign.odometry.source is not None:
        document["odometry"] = {"from": campaign.odometry.source}
    for key, value in campaign.extra.items():
        own = document.setdefault(key, value)
        if isinstance(value, Mapping) and isinstance(own, dict):
            document[key] = {**value, **own}
    return document


def _plain(section: Any) -> dict[str, float | str]:
    return {
        field.name: value if isinstance(value, str) else float(value)
        for field in fields(section)
        if isinstance(value := getattr(section, field.name), (str, int, float))
        and (field.name not in _WHERE_GIVEN or value != field.default)
    }


def _encoder_keys(encoder: Encoder) -> dict[str, float | str]:
    values = {key: int(x) if isinstance(x, float) and x.is_integer() else x for key, x in _plain(encoder).items()}
    if values["counts_per_rev_left"] == values["counts_per_rev_right"]:
        values = {"counts_per_rev": values.pop("counts_per_rev_left")} | values
        del values["counts_per_rev_right"]
    return values
