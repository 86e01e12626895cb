"""Design of the campaign: assumed settings, loads and sessions, replicates; what all checks share."""

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations, islice
from typing import Any, Final

import numpy as np

from calib.campaign.model import REFERENCE_POSE, Campaign, Note
from calib.campaign.wheels import logged_columns, odometry_source, on_one_axle
from calib.types import FloatArray, IntArray, StrArray, grouped

SIDES: Final = ("left", "right")
#: fewest runs that a finding on a whole column rests on
LEAST_RUNS: Final = 4
#: share of the runs beyond which a finding is on the column, not on each cell
MOST_OF_THE_RUNS: Final = 0.8
#: radius found over nominal -> what usually lies behind it
RADIUS_FACTORS: Final = (
    (4.0, "a quarter of the counts (single edges counted, counts_per_rev given with quadrature)"),
    (0.25, "four times too many counts (quadrature edges counted, counts_per_rev given without them)"),
    (2.0, "half the counts (one edge counted, or a diameter given as wheel_radius_m)"),
    (0.5, "twice too many counts (both edges counted, or a radius given as a diameter)"),
    (math.pi, "pi times too few counts (a circumference given for a diameter)"),
    (1 / math.pi, "pi times too many counts (a circumference given for a diameter)"),
    (2 * math.pi, "counts of a turn given for counts of a radian"),
    (1 / (2 * math.pi), "counts of a radian given for counts of a turn"),
    (1e3, "a distance in millimetres (name the column distance_mm), or counts a thousand times too few"),
    (1e2, "a distance in centimetres (name the column distance_cm)"),
    (1e-3, "a distance in kilometres, wheel_radius_m in millimetres, or counts a thousand times too many"),
    (1e-2, "wheel_radius_m in centimetres"),
    (3.28084, "a distance in feet"),
    (39.3701, "a distance in inches"),
    (0.3048, "wheel_radius_m in feet"),
    (0.0254, "wheel_radius_m in inches"),
    (1.09361, "a distance in yards, or a nominal radius that is not this wheel's"),
)
#: ratio of loads to those of the vehicle -> unit
LOAD_UNITS: Final = (
    (1e-3, "kN: name the columns load_left_kN, load_right_kN"),
    (1 / 9.80665, "kg: name the columns load_left_kgf, load_right_kgf"),
    (1 / 4.44822, "pounds-force"),
    (9.80665, "N times 9.81"),
    (1e3, "mN"),
    (0.5, "half the load"),
    (2.0, "the load of both wheels in each column"),
)

Run = int | np.signedinteger[Any]


def cell_note(campaign: Campaign, run: Run, column: str, text: str, code: str, level: str = "suspicious") -> Note:
    """Return a note on one cell of the run table, runs counted from 0; see `Note`."""
    where = f"runs, row {int(campaign.runs.line[run])}, column {column}"
    return Note.of(where, text, code, level, str(campaign.runs.run_id[run]))


def column_note(columns: str, text: str, code: str, level: str = "suspicious", of: str = "runs") -> Note:
    """Return a note on columns of the run table or the logs; see `cell_note`."""
    return Note.of(f"{of}, column{'s' if ', ' in columns or ' and ' in columns else ''} {columns}", text, code, level)


def setting_note(key: str, text: str, code: str, level: str = "suspicious") -> Note:
    """Return a note on a key of the settings."""
    return Note.of(f"campaign.toml, {key}", text, code, level)


implausible_column: Final = partial(column_note, code="implausible", level="wrong")
implausible_setting: Final = partial(setting_note, code="implausible", level="wrong")


def both_sides(campaign: Campaign, quantity: str) -> FloatArray:
    """Return ``counts_{}`` or ``load_{}_N`` of both wheels, shape (2, n_runs)."""
    return np.stack([campaign.runs.number(quantity.format(side)) for side in SIDES])


def logged_range(campaign: Campaign, name: str) -> FloatArray:
    """Return the least and the largest value of a log column in each run, shape (2, n_runs); NaN without it."""
    ends = np.full((2, len(campaign.runs)), np.nan)
    for run, log in campaign.logs.each(2, name):
        ends[:, run] = np.nanmin(log[name]), np.nanmax(log[name])
    return ends


def on_axle(campaign: Campaign) -> Campaign:
    """Return the campaign with counts of two wheels on an axle; of mecanum wheels, only where l + w is known."""
    unknown = odometry_source(campaign) == "wheels" and campaign.vehicle.half_length_plus_half_width_m is None
    return campaign if unknown else on_one_axle(campaign)


def wheel_columns(campaign: Campaign) -> str:
    """Return the columns that the turns of the odometry come from."""
    return ", ".join(logged_columns(odometry_source(campaign)))


def rolled_m(campaign: Campaign, side: str, counts: FloatArray | None = None) -> FloatArray:
    """Return what a wheel of nominal radius rolls in `counts`, by default in each run."""
    counts = campaign.runs.number(f"counts_{side}") if counts is None else counts
    return 2 * np.pi * campaign.vehicle.wheel_radius_m * counts / campaign.encoder.per_rev(side)


def turned_rad(campaign: Campaign, left: FloatArray | None = None, right: FloatArray | None = None) -> FloatArray:
    """Return how far the nominal vehicle turns in these counts, by default in each run."""
    return (rolled_m(campaign, "right", right) - rolled_m(campaign, "left", left)) / campaign.vehicle.track_m


#: headings of wheels and reference that differ by less, beside whole turns, agree
_NEAR_TURN_RAD: Final = 1.0


def logged_turns(campaign: Campaign) -> FloatArray:
    """Return how far the reference of each log turned, in rad, shape (n_runs,); NaN where that is not known."""
    measured = np.full(len(campaign.runs), np.nan)
    for run, log in campaign.logs.each():
        if len(heading := log.get("ref_theta_rad", measured[:0])):
            steps = np.diff(np.unwrap(heading[np.isfinite(heading)]))
            # with steps above 1 rad the number of turns is ambiguous
            measured[run] = steps.sum() if np.abs(steps).max(initial=0.0) < 1.0 else np.nan
    return measured


def reference_turns(campaign: Campaign) -> tuple[FloatArray, FloatArray]:
    """Return how far the reference turned in each run, and the wheels' difference in turns; infinite if not whole.

    Headings all within half a turn are unwrapped; those on a map come from the logs.
    """
    measured, turned = campaign.runs.number("ref_theta_rad"), turned_rad(campaign)
    if campaign.reference.frame == "map":
        return logged_turns(campaign), np.nan * turned
    turns = np.round((turned - measured) / (2 * np.pi))
    near = np.abs(turned - measured - 2 * np.pi * turns) < _NEAR_TURN_RAD
    if (np.abs(measured[near]) <= np.pi + 0.05).all():
        # wheels may be 20 % off: below 2.5 rad nothing wraps
        measured = measured + 2 * np.pi * np.where(near & (np.abs(turned) > 2.5), turns, 0.0)
        turns = 0.0 * turns
    return measured, np.where(near, turns, turns + math.inf)


def raw_radius_ratio(campaign: Campaign, side: str) -> FloatArray:
    """Return distance / (2 pi turns) over the nominal radius, shape (n_runs,); NaN where not measured."""
    distance = campaign.runs.number("distance_m")
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(distance > 0, distance, np.nan) / rolled_m(campaign, side)
    return np.where(np.isfinite(ratio), ratio, np.nan)


def robust_spread(values: FloatArray) -> float:
    """Return 1.4826 times the median absolute deviation; 0 without values."""
    values = values[np.isfinite(values)]
    return float(1.4826 * np.median(np.abs(values - np.median(values)))) if len(values) else 0.0


#: fewest runs for a line, and most points that are paired for its slope
MIN_LINE_RUNS: Final = 8
_MAX_LINE_POINTS: Final = 400


def pair_slopes(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the slopes between all pairs of points."""
    step = 1 + len(x) // _MAX_LINE_POINTS
    run, rise = (np.subtract.outer(values[::step], values[::step]) for values in (x, y))
    return rise[run > 0.0] / run[run > 0.0]


def line_residuals(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return residuals of `y` about its Theil-Sen line in `x`; of few runs, about the median."""
    known = np.isfinite(x + y)
    slopes = pair_slopes(x[known], y[known]) if known.sum() >= MIN_LINE_RUNS else np.zeros(0)
    line = np.median(slopes) * np.where(np.isnan(x), np.median(x[known]), x) if len(slopes) else np.zeros(len(x))
    return y - line - (np.median((y - line)[known]) if known.any() else 0.0)


def partial_slope(y: FloatArray, x: FloatArray, nuisance: FloatArray, least: float = 0.0) -> tuple[float, float, float]:
    """Return the partial slope of `y` on `x` beside nuisance columns, its standard error and dof.

    Slope 0, error infinite where the root mean square of `x` beside them is at most `least`.
    """
    regressors = nuisance / np.maximum(np.abs(nuisance).max(axis=0), 1e-300)
    both = np.column_stack([x, y])
    explained, _, rank, _ = np.linalg.lstsq(regressors, both, rcond=1e-9)
    x, y = (both - regressors @ explained).T
    dof, square = len(y) - int(rank) - 1, float(x @ x)
    if dof < 1 or square <= least**2 * len(x):
        return 0.0, math.inf, 1.0
    slope = float(x @ y) / square
    residual = y - slope * x
    return slope, math.sqrt(float(residual @ residual) / dof / square), float(dof)


def load_label(campaign: Campaign) -> StrArray:
    """Return a label of each run's load, shape (n_runs,): the payload and its place, else the loads to 5 N."""
    runs = campaign.runs
    parts = [name for name in ("payload_kg", "payload_x_m", "payload_y_m") if name in runs.numbers]
    if "payload_kg" in parts and not np.isnan(runs.number("payload_kg")).all():
        columns = np.round([runs.number(name) for name in parts], 3)
        columns[1:, columns[0] == 0] = 0.0
    else:
        columns = np.round(both_sides(campaign, "load_{}_N") / 5.0)
    return np.asarray(["/".join(f"{value:g}" for value in row) for row in zip(*columns, strict=True)], dtype=np.str_)


def runs_by_label(labels: StrArray) -> Iterator[tuple[str, IntArray]]:
    """Yield each label with the indices of its runs."""
    runs = grouped((label, run) for run, label in enumerate(labels.tolist()))
    return ((name, np.array(runs[name])) for name in sorted(runs))


def listed(names: StrArray | list[str], limit: int = 6) -> str:
    """Return names as text, shortened beyond `limit`."""
    shown = ", ".join(str(name) for name in names[:limit])
    return shown + (f" and {len(names) - limit} more" if len(names) > limit else "")


def meaning(ratio: float, factors: Sequence[tuple[float, str]] = RADIUS_FACTORS, tolerance: float = 0.07) -> str:
    """Return the cause of the factor nearest to a ratio; empty where none is within a relative `tolerance`."""
    factor, text = min(factors, key=lambda entry: abs(ratio / entry[0] - 1))
    return text if abs(ratio / factor - 1) < tolerance else ""


def stated(campaign: Campaign, key: str) -> bool:
    """Return whether a setting was given, rather than assumed by a program."""
    return not {key, key.partition(".")[0]} & set(campaign.assumed)


#: keys that scale every radius or path
WEIGHTY: Final = ("vehicle.track_m", "vehicle.wheel_radius_m", "encoder.counts_per_rev")
#: section -> columns of the run table or of logs that make its values matter
_NEEDED_BY: Final = {"rangefinder": ("distance_m",), "reference": REFERENCE_POSE}


def assumed_settings(campaign: Campaign) -> dict[str, str]:
    """Return the assumed keys that matter, each with its value."""
    columns = {*campaign.runs.numbers, *campaign.logs.columns}
    settings: dict[str, str] = {}
    for key in campaign.assumed:
        section, _, name = key.partition(".")
        front_alone = campaign.encoder.counts_per_rev_front and "counts_left" not in columns
        if key == "encoder.counts_per_rev" and front_alone and "counts_front" in columns:
            continue
        if section in _NEEDED_BY and not columns.intersection(_NEEDED_BY[section]):
            continue
        name = "counts_per_rev_left" if name == "counts_per_rev" else name
        value = getattr(getattr(campaign, section, None), name, None)
        settings[key] = f"{value:.6g}" if isinstance(value, int | float) else ""
    return settings


def assumed_values(campaign: Campaign) -> Iterator[Note]:
    """Name the settings that were not stated, with the values used."""
    if keys := assumed_settings(campaign):
        values = ", ".join(f"{key} = {value}" for key, value in keys.items())
        text = f"assumed, since nobody stated: {values}; give your own and take them out of 'assumed'"
        yield Note("suspicious" if set(WEIGHTY) & set(keys) else "info", "campaign.toml", text, "assumed")


#: squared correlation with the load beyond which a covariate moves the slope beyond its interval
MAX_LOAD_R2: Final = 0.5
#: fewest runs for a law
FEWEST_OF_A_LAW: Final = 3


def sessions_of_loads(campaign: Campaign) -> list[str]:
    """Return the sessions that have two loads or more."""
    label = load_label(campaign)
    return [
        str(name) for name, runs in runs_by_label(campaign.runs.label("session")) if len(np.unique(label[runs])) > 1
    ]


def load_and_session(campaign: Campaign) -> Iterator[Note]:
    """Say where loads change with the session, or in a rising or falling order."""
    label, sessions = load_label(campaign), np.unique(campaign.runs.label("session"))
    if len(np.unique(label)) < 2:
        return
    if len(sessions) >= 2 and not sessions_of_loads(campaign):
        text = f"""each of the {len(sessions)} sessions has one load only, so that a drift between sessions and the
            effect of the load cannot be told apart; drive at least two loads in each session"""
        yield column_note("session and load", text, "confounded_load")
        return
    if len(sessions) < 2 and np.isfinite(campaign.runs.number("distance_m")).sum() >= FEWEST_OF_A_LAW:
        text = """all runs are of one session, so that what shifts from session to session cannot be told: 'calib fit'
            holds such a law doubtful; drive two loads or more in another session"""
        yield column_note("session", text, "one_session")
    session, loads = campaign.runs.label("session"), both_sides(campaign, "load_{}_N")
    for name, values, cause, remedy in (
        ("order", np.arange(float(len(label))), "warming up", "loads in mixed order"),
        ("direction", direction_sign(campaign.runs.label("direction")), "drag one way", "each load both ways"),
    ):
        if any(covariate_against_load(load, values, session)[0] ** 2 > MAX_LOAD_R2 for load in loads):
            text = f"""the loads go with the {name} driven, so that {cause} and the effect of the load cannot be told
                apart; drive {remedy}"""
            yield column_note(f"{name} and load", text, "ordered_load")


def direction_sign(direction: StrArray) -> FloatArray:
    """Return 1 for runs out, -1 for runs back, NaN for others."""
    name = np.char.lower(direction)
    return np.where(name == "out", 1.0, np.where(name == "back", -1.0, np.nan))


def covariate_against_load(load_N: FloatArray, values: FloatArray, session: StrArray) -> tuple[float, float]:
    """Return a covariate's correlation with the load within sessions, and its change per newton."""
    known = np.isfinite(load_N + values)
    columns = np.stack((load_N, values))[:, known]
    for _, of in runs_by_label(session[known]) if known.any() else ():
        columns[:, of] -= columns[:, of].mean(axis=1, keepdims=True)
    (of_load, product), (_, of_values) = (columns @ columns.T).tolist()
    both = of_load * of_values
    return (product / math.sqrt(both), product / of_load) if both > 0.0 else (0.0, 0.0)


#: squared correlation of collinear columns: their effects' intervals are five times as wide
_COLLINEAR_R2: Final = 0.96
#: column -> smallest range that a diagnosis explains runs by: a hall changes by 1 K a day
_MIN_CHANGE: Final = {"load": 20.0, "speed": 0.02, "temperature": 2.0, "order of the sessions": 0.5, "direction": 0.5}


def columns_as_one(campaign: Campaign) -> Iterator[Note]:
    """Say which of load, speed, temperature, session order and direction are collinear."""
    runs = campaign.runs
    _, first, session = np.unique(runs.label("session"), return_index=True, return_inverse=True)
    values = (
        both_sides(campaign, "load_{}_N").sum(axis=0),
        np.abs(runs.number("speed_mps")),
        runs.number("temperature_C"),
        np.argsort(np.argsort(first))[session].astype(float),
        direction_sign(runs.label("direction")),
    )
    for (one, a), (other, b) in combinations(zip(_MIN_CHANGE, values, strict=True), 2):
        known = np.isfinite(a + b)
        if known.sum() < LEAST_RUNS or (one, other) == ("load", "order of the sessions"):
            continue
        if np.ptp(a[known]) <= _MIN_CHANGE[one] or np.ptp(b[known]) <= _MIN_CHANGE[other]:
            continue
        within = runs.label("kind") if other == "direction" else np.full(len(a), "")
        if covariate_against_load(a, b, within)[0] ** 2 > _COLLINEAR_R2:
            text = f"""{one} and {other} change together, so that no diagnosis tells apart what they do; drive some runs
                that change one alone"""
            yield column_note(f"{one} and {other}", text, "columns_as_one")


#: loads driven -> what they leave open
_FEW_LOADS: Final = {
    1: "one load only: a radius can be had, its change with load cannot",
    2: "two loads only: a slope can be had, whether the law is straight cannot",
}


def few_loads(campaign: Campaign) -> Iterator[Note]:
    """Say where runs or loads are too few for a law."""
    distance = np.isfinite(campaign.runs.number("distance_m"))
    for side in SIDES:
        load = campaign.runs.number(f"load_{side}_N")
        if 0 < (n := int((np.isfinite(load) & distance).sum())) < FEWEST_OF_A_LAW:
            text = f"{n} run(s) with load and distance; expected {FEWEST_OF_A_LAW} or more for 'calib fit'"
            yield column_note(f"load_{side}_N", f"{text}; drive three loads or more, each twice", "few_runs")
            continue
        number = len(np.unique(np.round(load[np.isfinite(load)] / 5.0)))
        if number in _FEW_LOADS:
            yield column_note(f"load_{side}_N", f"{_FEW_LOADS[number]}; drive three loads or more", "few_loads")


#: share of the uncertainty within which pasted values agree, and no two measurements in all
_SAME_VALUE: Final = 0.01


def pasted_rows(campaign: Campaign) -> Iterator[Note]:
    """Find runs that repeat an earlier one: counts and distance, or counts over time and end pose.

    Few counts, or a stepping motor's, repeat honestly.
    """
    reference, names, seen = campaign.reference, ("distance_m", *REFERENCE_POSE), defaultdict[Any, list[Any]](list)
    sigmas = campaign.rangefinder.sigma_m, reference.sigma_xy_m, reference.sigma_xy_m, reference.sigma_theta_rad
    table = np.stack([campaign.runs.number(name) for name in names], axis=1)
    for run, counts in enumerate(both_sides(campaign, "counts_{}").T):
        log, counted = campaign.logs.of(run), counts.prod()
        measured = abs(counted * table[run, 0]) > 0.0
        if counted == 0.0 or not (measured or log or abs(counted * table[run, 1]) > 0.0):
            continue
        wheels = [log[name] for name in log if name.startswith(("t_s", "counts_")) and not measured]
        values = np.stack((table[run], [log.get(name, (np.nan,))[-1] for name in names])) / sigmas
        earlier = seen[hash(b"".join(column.tobytes() for column in (counts, *wheels)))]
        same = (first for first, of in earlier if np.allclose(values, of, rtol=0.0, atol=_SAME_VALUE, equal_nan=True))
        for first in islice(same, 1):
            text = f"""counts and measured values are those of run {campaign.runs.run_id[first]}: one measurement, which
                counts twice; was it pasted, or recorded under two names? Exclude one of the two"""
            yield cell_note(campaign, run, "counts_left, counts_right", text, "pasted_row")
        earlier.append((run, values))
