"""What the correction does where it was not fitted: kinds, speeds, loads, directions and sessions left out in turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, StrArray
from calib.gap.data.observations import Observations
from calib.gap.evidence.left_out import LeftOut
from calib.gap.verdict.closure import end_rms_m
from calib.gap.verdict.outcome import Transfer

#: values of a quantity that are left out one by one; more are joined into so many groups
MOST_VALUES: Final = 8
#: a value with fewer units says nothing
FEWEST_UNITS: Final = 2
#: how often noise alone, of the floor's own uncertainty, may be beyond chance in any one of a campaign's trials
CHANCE: Final = 0.01
#: share of a gap beyond chance that a correction has to close where it was not fitted
CARRIES: Final = 0.6
#: leaving out more than this share of the units asks too much of the others
MOST_OF_ALL: Final = 0.6
#: a gap that grows by more than so many standard deviations of noise and rest grows by more than its scatter
SCATTER_SIGMA: Final = 2.5


@dataclass(frozen=True, slots=True)
class Trial:
    """The correction on one value that was left out.

    Parameters
    ----------
    left_out, value : str
        What was left out, and which of its values.
    before_rms_m, after_rms_m : float or None
        Root mean square of the end positions (else distances) without and with the correction.
    before, after, floor, chance : float
        Whitened squares of the model alone and with the correction fitted on the others, how many of them noise alone
        would leave, and from how many on they are beyond chance.
    growth : float
        By how many standard deviations of chance, rest included, the gap grew; negative where it shrank.
    """

    left_out: str
    value: str
    before_rms_m: float | None
    after_rms_m: float | None
    before: float
    after: float
    floor: float
    chance: float
    growth: float

    @property
    def harms(self) -> bool:
        """Whether the gap grew there by more than its scatter."""
        return self.growth > SCATTER_SIGMA

    @property
    def fails(self) -> bool:
        """Whether there is a gap beyond chance, and what the correction leaves of it is beyond chance and too much."""
        gap, rest = self.before - self.floor, self.after - self.floor
        return min(self.before, self.after) > self.chance and rest > (1.0 - CARRIES) * gap

    @property
    def transfer(self) -> Transfer:
        """The trial as the verdict shows it."""
        return Transfer(self.left_out, self.value, self.before_rms_m, self.after_rms_m)


def trials(left_out: LeftOut, before: FloatArray, dof: float) -> tuple[Trial, ...]:
    """Leave out what varies, value by value, and try the correction there.

    Parameters
    ----------
    left_out : LeftOut
        Leaves runs out of the fit.
    before : array of float, shape (n_units, n_channels)
        Residuals of the model alone.
    dof : float
        Degrees of freedom of the floor.
    """
    from scipy.special import fdtri

    observations = left_out.observations
    wanted = []
    for name, values in _quantities(observations).items():
        for value in _names(values):
            units = values == value
            if FEWEST_UNITS <= units.sum() <= MOST_OF_ALL * len(units) and left_out.foretells(units):
                wanted.append((name, value, units))
    floors = [float(observations.usable[units].sum()) for _, _, units in wanted]
    # the ratio of squares to a floor that is estimated itself; as many chances as there are trials
    chances = [floor * float(fdtri(floor, max(dof, 3.0), 1.0 - CHANCE / len(wanted))) for floor in floors]
    return tuple(_trial(left_out, before, *each, chance) for each, chance in zip(wanted, chances, strict=True))


def _trial(left_out: LeftOut, before: FloatArray, name: str, value: str, units: BoolArray, chance: float) -> Trial:
    observations = left_out.observations
    after = left_out.after(units)
    squares = left_out.squares(before)[units].sum(), left_out.squares(after)[units].sum()
    scatter = 2.0 * left_out.spread(after - before, units)
    return Trial(
        left_out=name,
        value=value,
        before_rms_m=end_rms_m(before, observations, units),
        after_rms_m=end_rms_m(after, observations, units),
        before=float(squares[0]),
        after=float(squares[1]),
        floor=float(observations.usable[units].sum()),
        chance=chance,
        growth=float((squares[1] - squares[0]) / max(scatter, 1e-9)),
    )


def _quantities(observations: Observations) -> dict[str, StrArray]:
    """Return what varies from unit to unit, as names shape (n_units,), each with two values or more."""
    rolled = 0.5 * (np.abs(observations.travel_left_m) + np.abs(observations.travel_right_m))
    with np.errstate(divide="ignore", invalid="ignore"):
        # of the wheels, so that a turn on the spot has one too; as a mean over their way, as effects feel it
        speed = np.nan_to_num(
            observations.total(rolled * rolled / observations.duration_s) / observations.total(rolled)
        )
    load = np.nan_to_num(observations.number("load_left_N") + observations.number("load_right_N"))
    quantities = {
        "kind": _routes(observations),
        "speed": _binned(speed, 0.1 * max(float(speed.max()), 1e-3), "{:.2f} m/s"),
        "load": _binned(load, 0.1 * max(float(load.max()), 1.0), "{:.0f} N"),
        "direction": observations.labels["direction"],
        "session": observations.labels["session"],
    }
    return {name: _joined(values) for name, values in quantities.items() if len(np.unique(values)) > 1}


def _routes(observations: Observations) -> StrArray:
    """Name the route of each unit: by its label where all have one, else by what was driven."""
    kinds = observations.labels["kind"]
    return kinds if np.all(kinds != "") else np.array([f"route {number + 1}" for number in observations.kind])


def _binned(values: FloatArray, width: float, words: str) -> StrArray:
    """Name values by the mean of their neighbours: sorted, a step beyond `width` begins another."""
    order = np.argsort(values)
    group = np.zeros(len(values), dtype=np.int64)
    group[order] = np.cumsum(np.concatenate(([0], np.diff(values[order]) > width)))
    means = np.bincount(group, values) / np.bincount(group)
    return np.array([words.format(mean) for mean in means])[group]


def _names(values: StrArray) -> list[str]:
    return [str(value) for value in np.unique(values)]


def _joined(values: StrArray) -> StrArray:
    """Join values into `MOST_VALUES` groups where there are more."""
    names, first, index = np.unique(values, return_index=True, return_inverse=True)
    if len(names) <= MOST_VALUES:
        return values
    # in the order driven, so that neighbours in time are left out together
    rank = np.argsort(np.argsort(first))[index]
    group = rank * MOST_VALUES // len(names)
    ends = [values[group == k] for k in range(MOST_VALUES)]
    return np.array([part[0] if part[0] == part[-1] else f"{part[0]} to {part[-1]}" for part in ends])[group]
