"""One section of a settings file: every key recognised, converted to SI units, checked and said."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from calib.campaign.columns import recognise
from calib.campaign.model import Note
from calib.campaign.readers.table import LARGEST
from calib.errors import BadFileError

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
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(_float(value)) <= LARGEST:
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
