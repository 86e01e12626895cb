"""Trials of a correction: each route, speed, load, direction and session held out in turn."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calib.gap.decision.held_out import end_rms_m
from calib.gap.inference import FALSE_ALARM, NEGLIGIBLE_GROWTH
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.inference.marginal_likelihood import FLOOR_DOF
from calib.gap.observations import Observations
from calib.types import BoolArray, FloatArray, StrArray

#: values held out one by one; more are joined into so many groups
MOST_VALUES: Final = 8
#: a single observation shows nothing
FEWEST_UNITS: Final = 2
#: largest share that others can replace
MOST_HELD_OUT: Final = 0.6
#: name of groups by time
ORDER: Final = "order"
#: speeds and loads within this share of the largest are one value
SAME_VALUE: Final = 0.1


def reach_of_noise(dof: float | FloatArray, n_readings: int) -> FloatArray:
    """Return how many noise levels the furthest of so many readings is off by, at `FALSE_ALARM`."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(np.maximum(dof, 1.0), 1.0 - 0.5 * FALSE_ALARM / max(n_readings, 1)))


def most_square(n_readings: int, dof: float = 0.0) -> float:
    """Return the squares of so many readings that noise alone leaves, at `FALSE_ALARM`; `dof`: 0 for a stated level."""
    from scipy.special import fdtri

    known = max(dof, 3.0) if dof > 0.0 else FLOOR_DOF
    return n_readings * float(fdtri(max(n_readings, 1), known, 1.0 - FALSE_ALARM))


def chance_of_order(values: FloatArray) -> tuple[float, bool]:
    """Return the chance that values (n,) follow their order so closely, and whether they rise.

    Kendall's rank correlation (Biometrika 30, 1938); fewer than two values follow none.
    """
    from scipy.stats import kendalltau

    if len(values) < 2:
        return 1.0, False
    rank = kendalltau(np.arange(len(values)), values)
    return float(rank.pvalue), bool(rank.statistic > 0.0)


@dataclass(frozen=True, slots=True)
class Trial:
    """The correction on one value held out: a route, speed, load, direction or session."""

    left_out: str
    value: str
    before_rms_m: float | None  #: root mean square of end positions (else distances) without it
    after_rms_m: float | None
    #: whitened squares of the model alone, with the others' correction, and as noise alone leaves
    before_square: float = field(default=0.0, metadata={"json": False})
    after_square: float = field(default=0.0, metadata={"json": False})
    noise_square: float = field(default=0.0, metadata={"json": False})
    #: whitened squares that noise alone does not exceed
    noise_limit: float = field(default=np.inf, metadata={"json": False})
    #: growth of the gap beyond an uncertain prediction's, in standard deviations
    growth_sd: float = field(default=0.0, metadata={"json": False})


def trials(left_out: HeldOutFit, before: FloatArray, rerun: FloatArray | None = None) -> tuple[Trial, ...]:
    """Hold out each value of what varies, and try the others' correction there.

    `before`: (n_units, n_channels), of the model alone; `rerun`: of a simulator run again with its fix, in place of
    predictions.
    """
    from scipy.special import fdtri

    observations = left_out.observations
    conditions = [each for each in _values(observations) if rerun is not None or left_out.is_predictive(each[2])]
    squares_before = left_out.squares(before)
    results = []
    for name, value, units in conditions:
        after = left_out.after(units) if rerun is None else rerun
        square, corrected = squares_before[units].sum(), left_out.squares(after)[units].sum()
        expected = float(observations.usable[units].sum())
        # squares over an estimated noise level follow F; Bonferroni
        limit = expected * float(fdtri(expected, max(left_out.noise.dof, 3.0), 1.0 - FALSE_ALARM / len(conditions)))
        added, added_variance = left_out.prediction_variance(units) if rerun is None else (0.0, 0.0)
        scatter = np.sqrt((2.0 * left_out.spread(after - before, units)) ** 2 + 2.0 * added_variance)
        results.append(
            Trial(
                left_out=name,
                value=value,
                before_rms_m=end_rms_m(before, observations, units),
                after_rms_m=end_rms_m(after, observations, units),
                before_square=float(square),
                after_square=float(corrected),
                noise_square=expected,
                noise_limit=limit,
                growth_sd=float((corrected - square - added - NEGLIGIBLE_GROWTH * expected) / max(scatter, 1e-9)),
            )
        )
    return tuple(results)


def _values(observations: Observations) -> Iterator[tuple[str, str, BoolArray]]:
    for name, labels in groupings(observations).items():
        for value in np.unique(labels):
            units = labels == value
            if FEWEST_UNITS <= units.sum() <= MOST_HELD_OUT * len(units):
                yield name, str(value), units


def groupings(observations: Observations, *, by_balance: bool = False) -> dict[str, StrArray]:
    """Return groups of what varies, a label for each observation, (n_units,).

    `by_balance`: also by difference of the wheel loads and by halves of the time: what is set anew or drifts has no
    size.
    """

    def mean_speed(part: Observations) -> FloatArray:
        rolled = 0.5 * (np.abs(part.travel_left_m) + np.abs(part.travel_right_m))
        with np.errstate(divide="ignore", invalid="ignore"):
            # of the wheels, for turns on the spot; weighed by distance, as effects act
            return np.nan_to_num(part.total(rolled**2 / part.duration_s) / part.total(rolled))

    speed = observations.of_parts(mean_speed)
    left, right = (observations.number(f"load_{side}_N") for side in ("left", "right"))
    load = np.nan_to_num(left + right)
    load_width = SAME_VALUE * max(float(load.max()), 1.0)
    kinds = observations.labels["kind"]
    if not np.all(kinds != ""):
        kinds = np.array([f"route {number + 1}" for number in observations.kind])
    quantities = {
        "kind": kinds,
        "speed": _binned(speed, SAME_VALUE * max(float(speed.max()), 1e-3), "{:.2f} m/s"),
        "load": _binned(load, load_width, "{:.0f} N"),
        "direction": observations.labels["direction"],
        "session": observations.labels["session"],
    }
    if by_balance:
        quantities["balance"] = _binned(np.nan_to_num(left - right), load_width, "{:+.0f} N left over right")
        halves = np.array(["the first half of the runs", "the second half of the runs"])
        quantities[ORDER] = halves[2 * np.arange(len(load)) // len(load)]
    stated = {name: np.where(values == "", "not stated", values) for name, values in quantities.items()}
    return {name: _joined(values) for name, values in stated.items() if len(np.unique(values)) > 1}


def _binned(values: FloatArray, width: float, words: str) -> StrArray:
    order = np.argsort(values)
    group = np.zeros(len(values), dtype=np.int64)
    group[order] = np.cumsum(np.concatenate(([0], np.diff(values[order]) > width)))
    means = np.bincount(group, values) / np.bincount(group)
    return np.array([words.format(mean) for mean in means])[group]


def _joined(values: StrArray) -> StrArray:
    names, first, index = np.unique(values, return_index=True, return_inverse=True)
    if len(names) <= MOST_VALUES:
        return values
    group = np.argsort(np.argsort(first))[index] * MOST_VALUES // len(names)
    ends = [values[group == k] for k in range(MOST_VALUES)]
    return np.array([part[0] if part[0] == part[-1] else f"{part[0]} to {part[-1]}" for part in ends])[group]
