"""What columns may mean: by their names in English, German, French, Italian, Spanish; by what their numbers do."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib import resources
from typing import Final
from unicodedata import combining, normalize

import numpy as np

from calib.campaign.ingest.mapping import TABLE_COLUMNS, units_for
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers.sheets import COUNT_UNITS, unit_spelled
from calib.campaign.settings import bracketed, recognise, spelled
from calib.types import FloatArray
from calib.units import split_suffix

#: what stands behind the side in the name of a wheel: left_wheel_joint, wheel_left_joint, Enc_L_raw
_BEHIND: Final = re.compile(
    r"(_(joint|wheel|motor|axle|axis|pos|position|encoder|enc|counts?|cnt|ticks?|data|raw|geber|rad|drive|shaft|total))+$"
)
#: first letters of a robot's wheels: fl, rear_right_drive; 'rear' of two wheels is no axle of its own
_AXLE_FIRST: Final = re.compile(r"(?:^|_)(fl|fr|rl|rr|bl|br)$")
_AXLES: Final = {"f": "front", "r": "rear", "b": "rear"}
_SIDES: Final = {
    "left": re.compile(r"(?:^|_)(l|li|left|links|linkes|linker|lhs|g|gauche|izq|izquierd[ao]|sx|sinistr[ao])(?=_|$)"),
    "right": re.compile(r"(?:^|_)(r|re|right|rechts|rechtes|rechter|rhs|d|droite?|der|derech[ao]|dx|destr[ao])(?=_|$)"),
}

#: directions along a corridor, in words: plain, or as `plain_text` gives them
_DIRECTIONS: Final = (
    ("out", r"out|hin(fahrt|weg)?|vor(waerts)?|forward|fwd|there|forth|outbound|a|ab|a->b|aller|ida|andata|>|\+"),
    ("back", r"backward(s)?|bwd|back|(zu)?rueck(waerts|fahrt|weg)?|her|ret(urn|our)?|inbound|vuelta|ritorno|reverse"),
    ("back", r"b|ba|b->a|<"),
)

_UMLAUTS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})


@cache
def _names() -> dict[str, dict[str, str]]:
    """Return ``names.toml``: calib's columns of run table and log -> what their names may look like, parts put in."""
    document = tomllib.loads(resources.files(__package__).joinpath("names.toml").read_text(encoding="utf-8"))
    parts = document.pop("parts")
    columns = {
        section: {
            name: re.sub(r"<(\w+)>", lambda part: str(parts[part[1]]), "|".join(forms)) for name, forms in of.items()
        }
        for section, of in document.items()
    }
    return columns | {"parts": parts}


def plain_text(text: str) -> str:
    """Return a text in lower case with umlauts spelt out and without accents."""
    spelt = text.strip().lower().translate(_UMLAUTS).replace("°", "")
    return "".join(sign for sign in normalize("NFKD", spelt) if not combining(sign))


def direction_of(text: str) -> str | None:
    """Return ``out`` or ``back`` where a text names a direction along a corridor."""
    return next((way for way, pattern in _DIRECTIONS if re.fullmatch(pattern, plain_text(text))), None)


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, plain, and the unit where it names one that calib knows.

    `name`: as found, for example ``Strecke [mm]`` or ``Weg in mm``.
    """
    in_words = re.sub(r"\s+in\s+(\S+)\s*$", r" [\1]", name.strip())
    stem, unit = split_suffix(spelled(in_words))
    before, inside = bracketed(in_words)
    if unit is None and inside is not None:
        # a side, a unit that is not known, or one of a counter
        parts = _names()["parts"]
        is_side = re.fullmatch(f"{parts['left']}|{parts['right']}", plain_text(inside))
        stem = f"{before}_{inside}" if is_side else before
    return plain_text(re.sub(r"[.\s\-]+", "_", stem)).strip("_"), unit


def count_unit(name: str) -> str | None:
    """Return the unit of a wheel's column where its name has one in brackets: ``counts``, ``rad``, ``rad/s``."""
    unit = unit_spelled(bracketed(name)[1] or "")
    return unit if unit in COUNT_UNITS else None


def guessed_table_column(name: str) -> str | None:
    """Return the column of the run table that a name may mean, or None."""
    exact = recognise(name, TABLE_COLUMNS).name
    return exact if exact in TABLE_COLUMNS else _matching(*stem_and_unit(name), "table")


def guessed_log_column(name: str) -> str | None:
    """Return the column of a log that a name may mean, or None.

    `name`: as found; of a recording's ``stream:column`` or ``group/channel`` the last part counts first.
    """
    last = re.sub(r"^(position|velocity|effort)\.", "", re.split(r"[:/]", name)[-1])
    return _guessed_in_log(last) or _guessed_in_log(re.sub(r"[:/.]+", "_", name).strip("_"))


def _guessed_in_log(name: str) -> str | None:
    exact = recognise(name, LOG_COLUMNS).name
    if exact in LOG_COLUMNS:
        return exact
    stem, unit = stem_and_unit(name)
    short = _BEHIND.sub("", stem)
    if corner := _AXLE_FIRST.search(short):
        return f"counts_{_AXLES[corner[1][0]]}_{'left' if corner[1][1] == 'l' else 'right'}"
    wheel = _matching(short, None, "log") if short != stem else None
    # only wheels: pose_x_raw is none
    return wheel if wheel and wheel.startswith("counts_") else _matching(stem, unit, "log")


def _matching(stem: str, unit: str | None, section: str) -> str | None:
    force = _names()["parts"]["force"]
    for target, pattern in _names()[section].items():
        if not re.fullmatch(pattern, stem):
            continue
        if target.startswith("load_") and unit is None and not re.search(f"las|loa|^f|(^|_){force}(_|$)", stem):
            # a side alone is a wheel of any kind
            continue
        if unit is None or target.startswith("counts_") or unit in units_for(target):
            return target
    return None


def side_of(name: str) -> str | None:
    """Return ``left`` or ``right`` where a name says the side: ``Geber_links``, ``encoderLeft``, ``QL``."""
    for part in (re.split(r"[:/]", name)[-1], re.sub(r"[:/]", "_", name)):
        stem = stem_and_unit(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", part))[0].replace(".", "_")
        if side := next((side for side, pattern in _SIDES.items() if pattern.search(stem)), None):
            return side
    return None


def rises_evenly(values: FloatArray) -> bool:
    """Return whether values of shape (n_rows,) rise in even steps, as a clock does."""
    steps = np.diff(values)
    usual = float(np.median(steps)) if len(steps) > 1 else 0.0
    return usual > 0 and bool((steps >= 0).all() and np.mean(np.abs(steps - usual) < _EVEN * usual) > _MOSTLY)


def usual_step(values: FloatArray) -> float:
    """Return the median step between rows, of the steps other than 0."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


#: share of all steps that a column rises by in the end, where it rises without a break
_RISES: Final = 0.98
#: shares of a turn: a jump back of an angle, and its span with rounding
_JUMP, _ONE_TURN = 0.75, 1.001
#: how far a clock's step is from the usual one, as a share of it, and the share of steps that are so
_EVEN, _MOSTLY = 0.05, 0.9
#: least correlation of a counter's steps with the next: a smooth drive has nearly 1, noise on a speed -0.5
_ALIKE: Final = 0.2
#: what a plain counter does, and an angle without end
RISES: Final = "rises without a break"
#: turn at which an angle starts again -> what it does then
_TURNS: Final = {2 * np.pi: "an angle that starts again after 2 pi", 360.0: "an angle that starts again after 360"}
#: what the numbers of a wheel do -> the unit that they are in then
BEHAVIOURS: Final = {
    "increments, a count a sample": "counts/sample",
    _TURNS[2 * np.pi]: "rad",
    _TURNS[360.0]: "deg",
    RISES: "",
}


def behaviour(values: FloatArray, *, whole: bool) -> str:
    """Return what a column's numbers do, of `BEHAVIOURS`; empty where they do nothing that a wheel does.

    `values` (shape (n_rows,)): finite; `whole`: whether all are integers.
    """
    steps, span = np.diff(values), float(np.ptp(values))
    total = float(np.abs(steps).sum())
    if not span:
        return ""
    if abs(values[-1] - values[0]) > _RISES * total:
        return RISES
    for turn, words in _TURNS.items():
        jumps = np.abs(steps) > _JUMP * turn
        steady = np.abs(steps[~jumps]).max(initial=0.0) < 0.5 * turn
        if _JUMP * turn < span <= _ONE_TURN * turn and jumps.any() and steady:
            return words
    # what moves goes on: the steps of a counter are alike from one to the next, but where it starts again; those of
    # increments are not
    steps = steps[np.abs(steps) < _JUMP * span]
    alike = float(np.sum(steps[1:] * steps[:-1])) / max(float(np.sum(steps * steps)), 1.0)
    return "increments, a count a sample" if whole and alike < _ALIKE else ""
