"""What columns may mean, by names in five languages and numbers; how far streams lag."""

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import product
from typing import Any, Final
from unicodedata import combining, normalize

import numpy as np

from calib.campaign.ingest.mapping import TABLE_COLUMNS, units_for
from calib.campaign.model import LOG_COLUMNS
from calib.campaign.readers.sheets import COUNT_UNITS, unit_spelled
from calib.campaign.settings import bracketed, recognise, spelled
from calib.types import SUFFIXES, BoolArray, FloatArray, floats, split_suffix, unit_named

#: behind the side: left_wheel_joint, wheel_left_joint, Enc_L_raw
_WHEEL_SUFFIX: Final = re.compile(
    r"(_(joint|wheel|motor|axle|axis|pos|position|encoder|enc|counts?|cnt|ticks?|data|raw|geber|rad|drive|shaft|total|rpm))+$"
)
_LETTERS: Final = (
    {"SIDE": "left", "INITIAL": "l", "FRENCH": "g", "ITALIAN": "s", "SWEDISH": "v"},
    {"SIDE": "right", "INITIAL": "r", "FRENCH": "d", "ITALIAN": "d", "SWEDISH": "h"},
)
_UMLAUTS: Final = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "ø": "oe", "ł": "l"})


@cache
def shipped() -> dict[str, Any]:
    """Return columns' possible names, and the text of empty settings."""
    return tomllib.loads(resources.files(__package__).joinpath("names.toml").read_text(encoding="utf-8"))


@cache
def _names() -> dict[str, dict[str, str]]:
    document = dict(shipped())
    parts = document.pop("parts")
    del document["blank"]
    columns: dict[str, dict[str, str]] = {section: {} for section in document}
    for section, of in document.items():
        for (name, forms), signs in product(of.items(), _LETTERS):
            form = "|".join(forms)
            for sign, letter in signs.items():
                name, form = name.replace(sign, letter), form.replace(sign, letter)
            columns[section][name] = re.sub(r"<(\w+)>", lambda part: str(parts[part[1]]), form)
    return columns | {"parts": parts}


def plain_text(text: str) -> str:
    """Return a text in lower case, umlauts spelt out, without accents."""
    spelt = text.strip().lower().translate(_UMLAUTS).replace("°", "")
    return "".join(sign for sign in normalize("NFKD", spelt) if not combining(sign))


def direction_of(text: str) -> str | None:
    """Return ``out`` or ``back`` where a text names a direction."""
    plain = plain_text(text)
    return next((way for way, pattern in _names()["direction"].items() if re.fullmatch(pattern, plain)), None)


def load_of(text: str, unit: str) -> float | None:
    """Return the load in a text, in kg (``200 kg``, ``with 62,5kg``, ``leer``) or N; else None."""
    if unit == "kg" and re.search(r"\b(leer|empty|unbeladen|unladen|vide|vuoto|vacio)\b", plain_text(text)):
        return 0.0
    match = re.search(rf"(\d+(?:[.,]\d+)?)_?\s*{unit.lower()}\b", plain_text(text))
    return float(match[1].replace(",", ".")) if match else None


def stem_and_unit(name: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, plain, and the unit if calib knows it.

    `name`: ``Strecke [mm]``, ``Weg in mm`` or ``v_left_m_s``.
    """
    in_words = name.strip()
    match = re.fullmatch(r"(.{2,}?)(?:\s+in\s+|\s*[/,]\s*|\s)([^\s/,]+)", in_words)
    if match and unit_named(match[2]) not in {None, "day"}:
        in_words = f"{match[1]} [{match[2]}]"
    in_words = re.sub(r"_(mm?|km|rad|deg)_([sh])$", r" [\1/\2]", in_words)
    stem, unit = split_suffix(spelled(in_words))
    before, inside = bracketed(in_words)
    if unit is None and inside is not None:
        parts = _names()["parts"]
        is_side = re.fullmatch(f"{parts['left']}|{parts['right']}", plain_text(inside))
        stem = f"{before}_{inside}" if is_side else before
    return plain_text(re.sub(r"[.\s\-]+", "_", stem)).strip("_"), unit


def count_unit(name: str) -> str | None:
    """Return the unit in a wheel's name, as ``rpm`` or ``turns``; ``[counts]`` in brackets."""
    unit = unit_spelled(bracketed(name)[1] or name.lower().rpartition("_rpm")[1][1:])
    if unit in COUNT_UNITS:
        return unit
    (stem, own), parts = stem_and_unit(name), _names()["parts"]
    by_word = {"turns": "turns", "rate": "rpm"} if side_of(name) else {}
    named = (unit for part, unit in by_word.items() if any(re.fullmatch(parts[part], word) for word in stem.split("_")))
    return {"radps": "rad/s", "degps": "deg/s"}.get(own or "") or next(named, None)


def excludes(text: str, valid: bool) -> bool:
    """Return whether a remark, or an answer on being `valid`, leaves a run out."""
    return re.search(_names()["parts"]["bad"] + r"|^(no?|non|nein|nej|nie)$" * valid, plain_text(text)) is not None


def guessed_table_column(name: str) -> str | None:
    """Return the run table's column of a name, or None."""
    exact = recognise(name, TABLE_COLUMNS).name
    return exact if exact in TABLE_COLUMNS else _matching(*stem_and_unit(name), "table")


def reading_of(name: str) -> tuple[str, str] | None:
    """Return the distance or counts, and ``start`` or ``end``, that a column reads; else None.

    `name`: as ``Laser start [mm]`` or ``Zähler links Ende``.
    """
    stem, unit = stem_and_unit(name)
    parts, words = _names()["parts"], stem.split("_")
    for moment in ("start", "end"):
        others = [word for word in words if not re.fullmatch(parts[moment], word)]
        plain = "_".join(others)
        target = "distance_m" if re.fullmatch(parts["rangefinder"], plain) else _matching(plain, unit, "table")
        if count_unit(name) == "counts" and (side := side_of(plain)):
            target = f"counts_{side}"
        if 0 < len(others) == len(words) - 1 and target in {"distance_m", "counts_left", "counts_right"}:
            return target, moment
    return None


def guessed_log_column(name: str) -> str | None:
    """Return the log's column of a name, or None; of ``stream:column`` the last part first."""
    parts = re.split(r"[:/.]*[:/](?![^\[(]*[\])])", name)
    # of ROS, "rostopic echo -p" as well
    last = re.sub(r"^(%|field\.|position\.|velocity\.|effort\.)+", "", parts[-1])
    return _guessed_in_log(last) or _guessed_in_log("_".join(parts).strip("_"))


def _guessed_in_log(name: str) -> str | None:
    exact = recognise(name, LOG_COLUMNS).name
    if exact in LOG_COLUMNS:
        return exact
    stem, unit = stem_and_unit(name)
    short = _WHEEL_SUFFIX.sub("", stem)
    wheel = _matching(short, None, "log") if short != stem else None
    return wheel if wheel and wheel.startswith("counts_") else _wheel_of(name) or _matching(stem, unit, "log")


def _wheel_of(name: str) -> str | None:
    parts, (stem, unit) = _names()["parts"], stem_and_unit(name)
    measures, words = SUFFIXES[unit][0] if unit else "", stem.split("_")

    def of(*names: str) -> set[str]:
        return {word for word in words if any(re.fullmatch(parts[part], word) for part in names)}

    rolls, speed = of("wheel", "turns", "angle", "rate", *(["rolled"] if measures == "m" else [])), of("speed")
    rolls |= of("beside") if measures == "radps" else set()
    left, right = of("left"), of("right")
    others = {*words} - rolls - speed - of("beside") - left - right
    if len(left) + len(right) != 1 or not rolls or others or measures not in {"", "m", "rad", "radps", "mps"}:
        return None
    side = "left" if left else "right"
    by_speed = speed and (measures == "mps" or (not unit and count_unit(name) is None))
    return f"speed_{side}_mps" if by_speed else f"counts_{side}"


def _matching(stem: str, unit: str | None, section: str) -> str | None:
    force, no_wheel, not_measured = (_names()["parts"][part] for part in ("force", "no_wheel", "not_measured"))
    for target, pattern in _names()[section].items():
        if not re.fullmatch(pattern, stem) or (target.startswith("counts_") and re.search(no_wheel, stem)):
            continue
        if target.startswith(("distance_", "range_", "load_", "ref_")) and re.search(not_measured, stem):
            continue
        if target.startswith("load_") and unit is None and not re.search(f"las|loa|^f|(^|_){force}(_|$)", stem):
            continue
        if unit is None and stem in {"t", "d"} and section == "table":
            continue
        if unit is None or (target.startswith("counts_") and "mps" not in SUFFIXES[unit]) or unit in units_for(target):
            return target
    return None


def by_rangefinder(name: str) -> bool:
    """Return whether a column names an instrument of lengths."""
    return re.search(_names()["parts"]["measured"], stem_and_unit(name)[0]) is not None


def side_of(name: str) -> str | None:
    """Return the side, ``left`` or ``right``, in a name: ``Geber_links``, ``encoderLeft``, ``QL``."""
    for part in (re.split(r"[:/]", name)[-1], re.sub(r"[:/]", "_", name)):
        stem = stem_and_unit(re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", part))[0].replace(".", "_")
        # m_rl and ml are of mecanum drives and motors, g is gauche
        for side, further in (("left", "[rh]l|g"), ("right", "[rh]r|d")):
            if re.search(f"(?:^|_)({_names()['parts'][side]}|{further})(?=_|$)", stem):
                return side
    return None


def rises_evenly(values: FloatArray) -> bool:
    """Return whether values (n_rows,) rise in even steps, as a clock does."""
    steps = np.diff(values)
    usual = float(np.median(steps)) if len(steps) > 1 else 0.0
    return usual > 0 and bool((steps >= 0).all() and np.mean(np.abs(steps - usual) < _EVEN * usual) > _MOSTLY)


def usual_step(values: FloatArray) -> float:
    """Return the median step between rows, without steps of 0."""
    steps = np.abs(np.diff(values))
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


_MONOTONIC_SHARE: Final = 0.98
#: of a turn: an angle's jump back, and the span of one that starts again
_JUMP, ONE_TURN = 0.75, 1.001
#: largest deviation of a clock's steps, for this share of them
_EVEN, _MOSTLY = 0.05, 0.9
_MIN_STEP_CORRELATION: Final = 0.2
#: of its span, by which a drive's increments leave those at rest; of their steps, those back
_RETURN_SHARE: Final = 0.25
RISES: Final = "rises without a break"
_TURNS: Final = {2 * np.pi: "an angle that starts again after 2 pi", 360.0: "an angle that starts again after 360"}
#: what a wheel's numbers do -> their unit
BEHAVIOURS: Final = {
    "increments, a count a sample": "counts/sample",
    _TURNS[2 * np.pi]: "rad",
    _TURNS[360.0]: "deg",
    RISES: "",
}


def behaviour(values: FloatArray, *, whole: bool) -> str:
    """Return what finite numbers (`whole`: integers) do, of `BEHAVIOURS`; else empty."""
    steps, span = np.diff(values), float(np.ptp(values))
    if not span:
        return ""
    if abs(values[-1] - values[0]) > _MONOTONIC_SHARE * float(np.abs(steps).sum()):
        return RISES
    for turn, words in _TURNS.items():
        jumps = np.abs(steps) > _JUMP * turn
        steady = np.abs(steps[~jumps]).max(initial=0.0) < 0.5 * turn
        if _JUMP * turn < span <= ONE_TURN * turn and jumps.any() and steady:
            return words
    # what moves goes on: a counter's steps are alike, but where it starts again
    away = np.abs(values[1:] - values[0]) > _RETURN_SHARE * span
    turns = steps[away & (steps != 0)]
    level = abs(values[-1] - values[0]) < 0.1 * _RETURN_SHARE * span and away.mean() > 0.5
    level = level and len(turns) > 1 and float(np.mean(turns[1:] * turns[:-1] < 0)) > _RETURN_SHARE
    steps = steps[np.abs(steps) < _JUMP * span]
    alike = float(np.sum(steps[1:] * steps[:-1])) / max(float(np.sum(steps * steps)), 1.0)
    return "increments, a count a sample" if whole and (level or alike < _MIN_STEP_CORRELATION) else ""


_JACKKNIFE_BLOCKS: Final = 12
_MAX_GRID_POINTS: Final = 40_000
#: the grid's step over the wheels' (the golden section): in step with neither stream
_GRID_RATIO: Final = 0.6180339887498949
_SPEED_WINDOW_S: Final = 0.2
_LEAST_SPEED_CHANGE: Final = 0.02
#: largest lags, and least correlation that tells one: of computers, of clocks (GPS time is 18 s ahead of UTC)
_LAGS_S: Final = ((2.0, 0.5), (20.0, 0.8))


@dataclass(frozen=True, slots=True)
class Lag:
    """By how much a stream lags behind another."""

    #: positive where the second stream's clock is late
    lag_s: float
    #: each twelfth of the recording omitted in turn
    ci95_s: tuple[float, float]


def estimate_lag(
    time_s: FloatArray, travelled: FloatArray, other_time_s: FloatArray, other_travelled: FloatArray
) -> Lag | None:
    """Estimate by how much the second stream lags behind the first.

    Peak of the correlation of both speeds, smoothed central differences; None where these hardly change or correlate.

    `travelled`: distance or heading at its own times, shape (n_samples,).
    """
    lags = (_lag_within(time_s, travelled, other_time_s, other_travelled, limits) for limits in _LAGS_S)
    return next((lag for lag in lags if lag), None)


def _lag_within(
    time_s: FloatArray,
    travelled: FloatArray,
    other_time_s: FloatArray,
    other_travelled: FloatArray,
    limits: tuple[float, float],
) -> Lag | None:
    """Estimate a lag within `limits`, see `estimate_lag`; none at their border."""
    from scipy.optimize import minimize_scalar
    from scipy.stats import t as student

    start, end = max(time_s[0], other_time_s[0]), min(time_s[-1], other_time_s[-1])
    own_step, other_step = float(np.median(np.diff(time_s))), float(np.median(np.diff(other_time_s)))
    step = max(own_step, other_step, 1e-3)
    if not end - start > 4 * _LAGS_S[0][0]:
        return None
    largest_s = min(limits[0], 0.25 * (end - start))
    # interpolated distances are less noisy: a grid in step with a stream prefers such a lag
    grid_step = max(_GRID_RATIO * own_step, (end - start) / _MAX_GRID_POINTS)
    grid = np.arange(start + largest_s, end - largest_s, grid_step)
    half_window = max(_SPEED_WINDOW_S, step)

    def speed(at: FloatArray, times: FloatArray, distance: FloatArray) -> FloatArray:
        late, early = (np.interp(at + sign * half_window, times, distance) for sign in (1.0, -1.0))
        return floats((late - early) / (2 * half_window))

    own = speed(grid, time_s, travelled)
    if not np.std(own) > _LEAST_SPEED_CHANGE * np.mean(np.abs(own)):
        return None

    def correlation(lag: float, keep: BoolArray) -> float:
        second, first = speed(grid[keep] + lag, other_time_s, other_travelled), own[keep]
        spread = float(np.std(first) * np.std(second))
        return float(np.mean((first - first.mean()) * (second - second.mean())) / spread) if spread > 0 else 0.0

    everything = np.ones(len(grid), dtype=np.bool_)
    # a peak is as wide as the window of a speed
    candidates = np.arange(-largest_s, largest_s + step, max(step, 0.01 * largest_s / _LAGS_S[0][0]))
    rough = max(candidates, key=lambda lag: correlation(lag, everything))
    bounds = (rough - max(0.05, 2.0 * step), rough + max(0.05, 2.0 * step))

    def peak(keep: BoolArray) -> float:
        return float(minimize_scalar(lambda lag: -correlation(lag, keep), bounds=bounds, options={"xatol": 1e-6}).x)

    lag = peak(everything)
    if correlation(lag, everything) < limits[1] or abs(rough) + 0.05 > largest_s:
        return None
    block = np.arange(len(grid)) * _JACKKNIFE_BLOCKS // len(grid)
    estimates = np.asarray([peak(block != number) for number in range(_JACKKNIFE_BLOCKS)])
    half = float(student.ppf(0.975, _JACKKNIFE_BLOCKS - 1) * np.std(estimates) * np.sqrt(_JACKKNIFE_BLOCKS - 1))
    return Lag(lag, (lag - half, lag + half))
