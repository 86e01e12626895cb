"""What a simulator does at its nominal parameters and a step off each; the fix: what to set, by running it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.errors import RefusedError
from calib.gap.decision.diagnosis import Cause, Diagnosis, Quantity, VerdictKind
from calib.gap.decision.held_out import ADEQUATE_CLOSURE, closure_of
from calib.gap.decision.sentences import sentence
from calib.gap.effects.simulator import SIMULATOR_PREFIX, SimulatorParameter, carried_by_wheels, in_end_frame
from calib.gap.inference.fit import hypothesis_path, signature_columns, whitened_rows
from calib.gap.observations.arrays import Observations
from calib.gap.predict import Path, residuals
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

    def effects(self, settings: SimulatorSettings, nominal: Path) -> list[SimulatorParameter]:
        """Return the parameters as effects on the runs of a path, the model alone."""
        rows, effects = self.rows(nominal.s), []
        noise = self.scatter * np.sqrt(2.0 / self.repeats)
        for each in settings.parameters:
            size = self.size[each.name]
            carried = carried_by_wheels(nominal, self.change[each.name][rows] * size, size, noise)
            effects.append(SimulatorParameter(each.parameter, carried, each.family))
        return effects

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
        return replace(self, change={**self.change, **moved}, size={**self.size, **sizes})

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
    """Run a simulator at its nominal parameters, twice, and with each of them a step off.

    Where the two nominal runs differ by more than `NOISE_SHARE` of the stated uncertainties `sigma` (4,), every set of
    parameters is run `REPEATS` times and averaged, a step that the scatter hides at a longer one.
    """
    settings = runner.settings
    steps = [each.step for each in settings.parameters]
    points = _points(settings, steps)
    jobs = [Job(parameters, what) for what, parameters in points]
    again, *tables = runner.run([Job(jobs[0].parameters, jobs[0].what, 1), *jobs])
    scatter = np.sqrt(0.5 * np.mean(difference(again, tables[0]) ** 2, axis=0))
    repeats, sets = 1, [[table] for table in tables]
    if (scatter > NOISE_SHARE * sigma).any():
        repeats = REPEATS
        changes = [difference(table, tables[0]) for table in tables[1:]]
        clear = [_clear_step(each, change, scatter) for each, change in zip(settings.parameters, changes, strict=True)]
        kept = [[table] if step == now else [] for table, step, now in zip(tables[1:], steps, clear, strict=True)]
        steps, sets = clear, [[tables[0], again], *kept]
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
    change = {
        name: difference(table, means[0]) / step for (name, step), table in zip(size.items(), means[1:], strict=True)
    }
    return Differences(tuple(runner.run_ids), means[0], change, size, scatter, repeats, _distance_axis(means))


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


#: runs of the simulator with a fix, at most, a secant step each: one where it is linear, seven where its slope triples
MOST_RERUNS: Final = 8
#: a correction of the fix below this share of its standard uncertainties is not worth another run, below the second
#: one where the gap is at the noise already
CONVERGED: Final = (0.3, 1.0)
#: a step shorter than this share of the whole deviation tells the slope less well than the simulator's rounding allows
SECANT_SHARE: Final = 0.05
#: prior standard deviation of a correction in typical sizes; wide, it only keeps the solution finite
CORRECTION_SD: Final = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorFix:
    """Deviations from the nominal parameters, and the simulator's table there."""

    deviation: Mapping[str, float]  #: by parameter, of the named ones
    table: FloatArray  #: shape (n_runs, 4)


def named_parameters(diagnosis: Diagnosis, runner: SimulatorRunner) -> dict[str, Declared]:
    """Return the parameters of the simulator that a diagnosis names, by the id of the cause."""
    declared = {SIMULATOR_PREFIX + each.name: each for each in runner.settings.parameters}
    return {cause.effect: declared[cause.effect] for cause in diagnosis.causes if cause.effect in declared}


def fixed(
    diagnosis: Diagnosis,
    runner: SimulatorRunner,
    differences: Differences,
    found: SimulatorFix,
    rng: np.random.Generator,
) -> Diagnosis:
    """Return the diagnosis with what to set and the closure that the simulator shows with it.

    Parameters
    ----------
    diagnosis : Diagnosis
        In the simulator's parameters and the library's effects.
    runner : SimulatorRunner
        Runs the simulator.
    differences : Differences
        The simulator about its nominal parameters.
    found : SimulatorFix
        Of `iterated`.
    rng : numpy.random.Generator
        For the bootstrap.
    """
    named = named_parameters(diagnosis, runner)
    values = {each.name: each.nominal + found.deviation[each.name] for each in named.values()}
    # the gap of the simulator as it is and with the fix set, on all runs
    nominal = diagnosis.nominal
    before = residuals(nominal, nominal)
    change = difference(found.table, differences.nominal)[differences.rows(nominal.s)]
    after = np.where(nominal.s.usable, before - in_end_frame(nominal, change), 0.0)
    held_out = closure_of(nominal, diagnosis.noise, before, after, rng)
    closure = held_out.closure
    assert diagnosis.evidence is not None
    closes = closure.fraction is not None and closure.fraction >= ADEQUATE_CLOSURE
    diagnosis = replace(
        diagnosis,
        causes=tuple(_moved(cause, named, values) for cause in diagnosis.causes),
        closure=closure,
        evidence=replace(diagnosis.evidence, held_out=held_out),
        fix=replace(diagnosis.fix, parameters=values, recommended=diagnosis.fix.recommended and closes),
    )
    beside = _of_library(diagnosis)
    lacking = f" No parameter of your simulator does what {beside} of the library does." if beside else ""
    return replace(diagnosis, sentence=f"{sentence(diagnosis)} {_what_to_set(named, values)}{lacking}")


def parameters_to_set(diagnosis: Diagnosis) -> dict[str, float]:
    """Return what to set in the simulator, by parameter; RefusedError where none of its parameters is named."""
    if not diagnosis.fix.parameters:
        raise RefusedError(
            f"{diagnosis.campaign}: the verdict names no parameter of the simulator, so there is none to set; "
            "leave the simulator as it is, or add a parameter for the named effect"
        )
    return dict(diagnosis.fix.parameters)


def iterated(diagnosis: Diagnosis, runner: SimulatorRunner, differences: Differences) -> SimulatorFix:
    """Run the simulator with the fix, and correct it by secant steps until the runs ask for no more.

    The derivative is that of the finite differences, brought into line with every further run (Broyden 1965).
    """
    named = named_parameters(diagnosis, runner)
    fitted, noise = diagnosis.fitted, diagnosis.noise
    path, nominal = fitted.path, diagnosis.nominal
    derivative = np.stack([differences.change[each.name] for each in named.values()], axis=2)
    sizes = {form.effect: float(theta[0]) for form, theta in zip(fitted.forms, fitted.theta, strict=True)}
    deviation = np.array([sizes[name] for name in named])
    typical = np.array([each.parameter.typical for each in named.values()])
    # what the fit left, and what it took the parameters to change
    theta = [
        np.zeros_like(t) if form.effect in named else t for form, t in zip(fitted.forms, fitted.theta, strict=True)
    ]
    without = hypothesis_path(path.s, fitted.calibration, fitted.forms, theta, path)
    left = fitted.left + in_end_frame(path, (path.reading - without.reading)[:, :4])
    best, least = None, np.inf
    change = np.zeros_like(differences.nominal)
    last = np.zeros_like(deviation)
    for _ in range(MOST_RERUNS):
        table = _run(runner, differences, named, deviation)
        now = difference(table, differences.nominal)
        step = deviation - last
        if np.linalg.norm(step / typical) > SECANT_SHARE * np.linalg.norm(deviation / typical):
            scaled = step / typical
            miss = now - change - derivative @ step
            derivative = derivative + miss[:, :, None] * (scaled / typical) / (scaled @ scaled)
        change, last = now, deviation
        gap = left - _channels(diagnosis, differences, change)
        white = whitened_rows(path, noise, np.where(nominal.s.usable, gap, 0.0)[:, :, None])[:, 0]
        if white @ white < least:
            names = (each.name for each in named.values())
            best = SimulatorFix(dict(zip(names, map(float, deviation), strict=True)), table)
            least = float(white @ white)
        columns = np.stack(
            [_channels(diagnosis, differences, derivative[:, :, k]) * typical[k] for k in range(len(typical))], axis=2
        )
        whole = whitened_rows(path, noise, columns)
        normal = whole.T @ whole + np.eye(len(typical)) / CORRECTION_SD**2
        correction = np.linalg.solve(normal, whole.T @ white)
        at_noise = white @ white <= len(white)
        if np.abs(correction * np.sqrt(np.diag(normal))).max() < CONVERGED[int(at_noise)]:
            break
        deviation = deviation + correction * typical
    assert best is not None
    return best


def _channels(diagnosis: Diagnosis, differences: Differences, change: FloatArray) -> FloatArray:
    """Turn a change of the simulator's table (n_runs, 4) into that of the channels, (n_obs, n_channels)."""
    path = diagnosis.fitted.path
    return in_end_frame(path, change[differences.rows(path.s)])


def _run(
    runner: SimulatorRunner, differences: Differences, named: Mapping[str, Declared], deviation: FloatArray
) -> FloatArray:
    values = {each.name: each.nominal + float(d) for each, d in zip(named.values(), deviation, strict=True)}
    what = "the fix " + ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
    jobs = [Job(runner.settings.nominal | values, what, repeat) for repeat in range(differences.repeats)]
    return averaged(runner.run(jobs))


def _moved(cause: Cause, named: Mapping[str, Declared], values: Mapping[str, float]) -> Cause:
    """Return a cause with its size where the reruns put it; the width of its interval stays."""
    if cause.effect not in named:
        return cause
    each = named[cause.effect]
    quantity = cause.parameters[each.name]
    value = values[each.name] - each.nominal
    low, high = (end - quantity.value + value for end in quantity.ci95)
    return replace(cause, parameters={each.name: Quantity(value, (low, high), quantity.unit)})


def _what_to_set(named: Mapping[str, Declared], values: Mapping[str, float]) -> str:
    parts = []
    for each in named.values():
        value, unit = values[each.name], "" if each.unit in ("", "1") else f" {each.unit}"
        off = each.nominal - value
        way = "large" if off > 0.0 else "small"
        size = f"{100 * abs(off / each.nominal):.2g} %" if each.nominal else f"{abs(off):.3g}{unit}"
        parts.append(f"{each.name} of your simulator is {size} too {way}: set it to {value:.6g}{unit}")
    return f"{'; '.join(parts)}."


def without_parameter(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis that names no parameter of the simulator, and says so; its closure is on held-out runs."""
    if diagnosis.kind in {VerdictKind.NO_GAP, VerdictKind.UNDECIDED} or any(
        name.startswith(SIMULATOR_PREFIX) for group in diagnosis.groups for name in group.effects
    ):
        return diagnosis
    named = _of_library(diagnosis)
    if _share_together(diagnosis) > ADEQUATE_CLOSURE:
        beside = f", as {named} can" if diagnosis.causes else ""
        why = f"No single parameter of your simulator can do this; several together can{beside}."
    else:
        able = "can in part" if diagnosis.kind is VerdictKind.PARTLY_EXPLAINED else "can"
        can = f"; {named} of the library {able}" if diagnosis.causes else ""
        why = f"No parameter of your simulator can do this{can}."
    return replace(diagnosis, sentence=f"{diagnosis.sentence} {why}")


def _share_together(diagnosis: Diagnosis) -> float:
    """Return the share of the gap's squares that plausible deviations of all parameters together explain."""
    nominal, own = diagnosis.nominal, [e for e in diagnosis.effects if e.id.startswith(SIMULATOR_PREFIX)]
    forms = [form for effect in own for form in effect.forms(nominal.s)]
    gap = residuals(nominal, nominal)
    if not forms or not gap.any():
        return 0.0
    largest = np.array([parameter.largest / parameter.typical for form in forms for parameter in form.parameters])
    columns = np.concatenate(signature_columns(nominal, forms), axis=2) * largest
    whole = whitened_rows(nominal, diagnosis.noise, np.concatenate([columns, gap[:, :, None]], axis=2))
    a, r = whole[:, :-1], whole[:, -1]
    left = r - a @ np.linalg.solve(a.T @ a + np.eye(a.shape[1]), a.T @ r)
    return 1.0 - float(left @ left) / float(r @ r)


def _of_library(diagnosis: Diagnosis) -> str:
    """Return the named effects of the library, as a list in words; empty where there is none."""
    *most, last = [c.effect for c in diagnosis.causes if not c.effect.startswith(SIMULATOR_PREFIX)] or [""]
    return f"{', '.join(most)} and {last}" if most else last
