"""What a simulator does at its nominal parameters and a step off each: what every parameter changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from calib.gap.effects.effect import Perturbation
from calib.gap.effects.simulator import SimulatorParameter, WheelMotion
from calib.gap.observations.arrays import Observations
from calib.gap.predict import Path, predict
from calib.gap.simulator.runner import Job, SimulatorRunner
from calib.gap.simulator.settings import Declared, SimulatorSettings
from calib.types import FloatArray

#: a simulator that repeats itself within this share of an instrument's stated uncertainty is as good as deterministic
NOISE_SHARE: Final = 0.02
#: runs of a noisy simulator at each set of parameters: their mean has half the scatter of one
REPEATS: Final = 4
#: change by a step, in standard deviations of one run of a noisy simulator, that shows a parameter's signature within
#: some 0.7 %
CLEAR_CHANGE: Final = 100.0
_HEADING: Final = 3
#: a simulator's distance is that of its end point where they agree this well; laser and path length are further off
SAME_DISTANCE_M: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """A simulator about its nominal parameters; arrays are of (distance, x, y, heading)."""

    run_ids: tuple[str, ...]
    nominal: FloatArray  #: shape (n_runs, 4): NaN where it does not predict a channel
    change: Mapping[str, FloatArray]  #: by parameter, shape (n_runs, 4): change per unit, 0 where not predicted
    size: Mapping[str, float]  #: by parameter: the deviation from nominal over which the change was taken
    scatter: FloatArray  #: shape (4,): standard deviation of one run of the simulator; 0 where it repeats itself
    repeats: int  #: runs at each set of parameters that were averaged
    #: as what it writes distances: 1, along x; 2, from the start as the crow flies; None where it is neither
    axis: float | None = None
    met: Mapping[str, float] = field(default_factory=dict)  #: deviations of a run that the changes together meet

    def effects(self, settings: SimulatorSettings, nominal: Path) -> list[SimulatorParameter]:
        """Return the parameters as effects on the runs of a path, the model alone."""
        rows = self.rows(nominal.s)
        wheels = WheelMotion(nominal, self.scatter * np.sqrt(2.0 / self.repeats))
        carried = {
            each.name: wheels.carried(self.change[each.name][rows] * self.size[each.name], self.size[each.name])
            for each in settings.parameters
        }
        if len(self.met) > 1:
            # what wheels carry is no sum: together they would miss the run that the changes meet
            met = [(carried[name], size) for name, size in self.met.items()]
            pushes = [Perturbation(left=m.left * size, right=m.right * size, track=m.track * size) for m, size in met]
            moved = (predict(nominal.s, pushes).reading - nominal.reading)[:, :4]
            whole = sum(self.change[name][rows] * size for name, size in self.met.items())
            known = sum(carried[name].reading * size for name, size in self.met.items())
            (first, size), *_ = self.met.items()
            missed = np.where(wheels.on, whole - known - moved, 0.0)
            carried[first] = replace(carried[first], reading=carried[first].reading + missed / size)
        return [SimulatorParameter(each.parameter, carried[each.name], each.family) for each in settings.parameters]

    def through(self, deviation: Mapping[str, float], table: FloatArray, typical: Mapping[str, float]) -> Differences:
        """Return the differences brought into line with a run: linear in the deviations, they then meet its table.

        The least change of the derivatives that does so, sizes in typical ones (Broyden 1965).
        """
        change = difference(table, self.nominal)
        miss = change - sum((self.change[name] * size for name, size in deviation.items()), np.zeros_like(change))
        square = sum((size / typical[name]) ** 2 for name, size in deviation.items())
        if not square > 0.0:
            return self
        moved = {
            name: self.change[name] + miss * (size / typical[name] ** 2 / square) for name, size in deviation.items()
        }
        sizes = {name: size for name, size in deviation.items() if size != 0.0}
        return replace(self, change={**self.change, **moved}, size={**self.size, **sizes}, met=sizes)

    def rows(self, observations: Observations) -> list[int]:
        """Return the row of each observation in the tables."""
        number = {run_id: row for row, run_id in enumerate(self.run_ids)}
        return [number[str(run)] for run in observations.labels["run_id"]]


def difference(later: FloatArray, earlier: FloatArray) -> FloatArray:
    """Return the difference of two tables (n_runs, 4): headings within half a turn, 0 where not predicted."""
    apart = later - earlier
    apart[:, _HEADING] = (apart[:, _HEADING] + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(np.nan_to_num(apart))


def averaged(tables: list[FloatArray]) -> FloatArray:
    """Return the mean of tables (n_runs, 4) of the same parameters."""
    first = tables[0]
    return np.asarray(first + sum((difference(table, first) for table in tables), np.zeros_like(first)) / len(tables))


def differences_of(runner: SimulatorRunner, sigma: FloatArray) -> Differences:
    """Run a simulator at its nominal parameters, and with each of them a step off; twice where these do not tell all.

    Where two nominal runs differ by more than `NOISE_SHARE` of the stated uncertainties `sigma` (4,), every set of
    parameters is run `REPEATS` times and averaged, a step that the scatter hides at a longer one.
    """
    settings = runner.settings
    steps = [each.step for each in settings.parameters]
    jobs = [Job(parameters, what) for what, parameters in _points(settings, steps)]
    tables = runner.run(jobs)
    nominal = tables[0]
    again = nominal if _repeats(tables, sigma) else runner.run([Job(jobs[0].parameters, jobs[0].what, 1)])[0]
    scatter = np.sqrt(0.5 * np.mean(difference(again, nominal) ** 2, axis=0))
    repeats, sets = 1, [[table] for table in tables]
    if (scatter > NOISE_SHARE * sigma).any():
        repeats = REPEATS
        changes = [difference(table, nominal) for table in tables[1:]]
        clear = [_clear_step(each, change, scatter) for each, change in zip(settings.parameters, changes, strict=True)]
        kept = [[table] if step == now else [] for table, step, now in zip(tables[1:], steps, clear, strict=True)]
        steps, sets = clear, [[nominal, again], *kept]
        more = [
            Job(parameters, what, repeat)
            for (what, parameters), known in zip(_points(settings, steps), sets, strict=True)
            for repeat in range(len(known), REPEATS)
        ]
        results = iter(runner.run(more))
        for known in sets:
            known += [next(results) for _ in range(len(known), REPEATS)]
        within = [difference(table, averaged(tables)) for tables in sets for table in tables]
        scatter = np.sqrt(np.mean(np.stack(within) ** 2, axis=(0, 1)) * REPEATS / (REPEATS - 1))
    else:
        scatter = np.zeros(4)
    means = [averaged(tables) for tables in sets]
    size = {each.name: step for each, step in zip(settings.parameters, steps, strict=True)}
    change = {name: difference(one, means[0]) / step for (name, step), one in zip(size.items(), means[1:], strict=True)}
    return Differences(tuple(runner.run_ids), means[0], change, size, scatter, repeats, _distance_axis(means))


def _repeats(tables: Sequence[FloatArray], sigma: FloatArray) -> bool:
    """Return whether tables, the nominal one first, show that the simulator repeats itself.

    Every number is written again, exactly, with some parameter a step off that does not act on it, and digits
    are fine enough that a scatter would show.
    """
    whole = np.stack(tables)
    for written, limit in zip(np.moveaxis(whole, 2, 0), NOISE_SHARE * sigma, strict=True):
        if not np.isnan(written).all():
            coarse = np.array_equal(written, np.round(written, int(-np.log10(limit))))
            if coarse or not (written[1:] == written[0]).any(axis=0).all():
                return False
    return True


def _points(settings: SimulatorSettings, steps: Sequence[float]) -> list[tuple[str, dict[str, float]]]:
    """Return the sets of parameters to run, in words and by name: the nominal ones, and each a step off."""
    off = [(each.name, each.nominal + step) for each, step in zip(settings.parameters, steps, strict=True)]
    nominal = ("the nominal parameters", settings.nominal)
    return [nominal, *((f"{name} = {value:g}", settings.nominal | {name: value}) for name, value in off)]


def _clear_step(each: Declared, change: FloatArray, scatter: FloatArray) -> float:
    """Return the step at which a parameter changes some channel by `CLEAR_CHANGE` of the scatter, within its largest.

    The change (n_runs, 4) that its declared step showed has the scatter of two runs in it.
    """
    square = np.maximum(np.mean(change**2, axis=0) - 2.0 * scatter**2, 0.0)
    shown = float(np.max(np.sqrt(square / np.where(scatter > 0.0, scatter, np.inf) ** 2)))
    most = each.largest / abs(each.step)
    return each.step * min(max(CLEAR_CHANGE / shown, 1.0) if shown > 0.0 else most, most)


def _distance_axis(tables: list[FloatArray]) -> float | None:
    """Return `Differences.axis`; straight runs do not tell, those with a parameter a step off do."""
    distance, x, y, _ = np.concatenate(tables).T
    known = np.isfinite(distance + x + y)
    if not known.any():
        return None
    off = [float(np.abs(distance - one)[known].max()) for one in (x, np.hypot(x, y))]
    best = int(np.argmin(off))
    return best + 1.0 if off[best] < SAME_DISTANCE_M else None
