"""The fix of a simulator: what to set in it, by running it again, and the closure that it shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.errors import RefusedError
from calib.gap.decision.diagnosis import Cause, Diagnosis, Quantity, VerdictKind
from calib.gap.decision.held_out import ADEQUATE_CLOSURE, closure_of
from calib.gap.decision.sentences import sentence
from calib.gap.effects.simulator import SIMULATOR_PREFIX, in_end_frame
from calib.gap.inference.fit import hypothesis_path, signature_columns, whitened_rows
from calib.gap.predict import residuals
from calib.gap.simulator.differences import Differences, averaged, difference
from calib.gap.simulator.runner import Job, SimulatorRunner
from calib.gap.simulator.settings import Declared
from calib.types import FloatArray

#: runs of the simulator with a fix, at most, a secant step each: one where it is linear, seven where its slope triples
MOST_RERUNS: Final = 8
#: a correction of the fix below this share of its standard uncertainties is not worth another run, below the second
#: one where the gap is at the noise already; below the third not of a simulator that does not repeat itself
CONVERGED: Final = (0.3, 0.5, 1.0)
#: a step shorter than this share of the whole deviation tells the slope less well than the simulator's rounding allows,
#: the second one than its scatter, where it does not repeat itself
SECANT_SHARE: Final = (0.01, 0.05)
#: what settles a fix that the simulator does not confirm
FAR: Final = "set the nominal parameters nearer to what closes it, and diagnose again"
#: prior standard deviation of a correction in typical sizes; wide, it only keeps the solution finite
CORRECTION_SD: Final = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorFix:
    """Deviations from the nominal parameters, by name of the named ones, and what the simulator does there."""

    deviation: Mapping[str, float]
    table: FloatArray  #: shape (n_runs, 4)
    derivative: Mapping[str, FloatArray]  #: shape (n_runs, 4)
    wider: Mapping[str, float]  #: half width of the interval over that with the derivative about the nominal parameters
    settled: bool  #: whether the last run asked for no more


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
    kind, why = diagnosis.kind, diagnosis.fix.why
    recommended = diagnosis.fix.recommended and closes and found.settled
    if not closes:
        kind = VerdictKind.PARTLY_EXPLAINED if kind is VerdictKind.EXPLAINED else kind
        closed = 100.0 * max(closure.fraction or 0.0, 0.0)
        why = (*why, f"your simulator, run again with it, closes {closed:.0f} % of the gap; {FAR}")
    elif not found.settled:
        why = (*why, f"after {MOST_RERUNS} runs with it your simulator still asks for another value; {FAR}")
    diagnosis = replace(
        diagnosis,
        kind=kind,
        causes=tuple(_moved(cause, named, found) for cause in diagnosis.causes),
        closure=closure,
        evidence=replace(diagnosis.evidence, held_out=held_out),
        fix=replace(diagnosis.fix, parameters=values, recommended=recommended, why=why),
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


def iterated(
    diagnosis: Diagnosis, runner: SimulatorRunner, differences: Differences, start: SimulatorFix | None = None
) -> SimulatorFix:
    """Run the simulator with the fix, and correct it by secant steps until the runs ask for no more.

    The derivative is that of the finite differences, brought into line with every further run (Broyden 1965); a step
    that leads further from what was measured is halved. `start`: a fix that it was run with; by default the first run
    is where the diagnosis puts the parameters.
    """
    named = named_parameters(diagnosis, runner)
    names = [each.name for each in named.values()]
    typical = np.array([each.parameter.typical for each in named.values()])
    sizes = {
        form.effect: float(theta[0]) for form, theta in zip(diagnosis.fitted.forms, diagnosis.fitted.theta, strict=True)
    }
    left = _without(diagnosis, named)
    about = np.stack([differences.change[name] for name in names], axis=2)
    if start is None:
        at, table, slope = np.zeros(len(names)), differences.nominal, about
        trial = np.array([sizes[effect] for effect in named])
    else:
        at, table = np.array([start.deviation[name] for name in names]), start.table
        slope = np.stack([start.derivative[name] for name in names], axis=2)
    now = _asked(diagnosis, differences, left, table, slope, typical)
    if start is not None:
        trial = at + now.correction
    for number in range(MOST_RERUNS):
        if now.converged and (number or start is not None):
            break
        new = _run(runner, differences, named, trial)
        scaled, steeper = (trial - at) / typical, slope
        if np.linalg.norm(scaled) > SECANT_SHARE[differences.repeats > 1] * np.linalg.norm(trial / typical):
            miss = difference(new, table) - slope @ (trial - at)
            steeper = slope + miss[:, :, None] * (scaled / typical) / (scaled @ scaled)
        then = _asked(diagnosis, differences, left, new, steeper, typical)
        if then.square < now.square:
            at, table, slope, now = trial, new, steeper, then
            trial = at + now.correction
        elif then.converged:
            break
        else:
            trial = 0.5 * (at + trial)
    nominal = _asked(diagnosis, differences, left, table, about, typical)
    return SimulatorFix(
        dict(zip(names, map(float, at), strict=True)),
        table,
        dict(zip(names, np.moveaxis(slope, 2, 0), strict=True)),
        dict(zip(names, map(float, now.sd / nominal.sd), strict=True)),
        now.off < CONVERGED[2],
    )


def _without(diagnosis: Diagnosis, named: Mapping[str, Declared]) -> FloatArray:
    """Return the gap beside the other causes, (n_obs, n_channels): what the fit left and took the named to change."""
    fitted = diagnosis.fitted
    path, pairs = fitted.path, zip(fitted.forms, fitted.theta, strict=True)
    theta = [np.zeros_like(size) if form.effect in named else size for form, size in pairs]
    without = hypothesis_path(path.s, fitted.calibration, fitted.forms, theta, path)
    return fitted.left + in_end_frame(path, (path.reading - without.reading)[:, :4])


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """What of the gap a run of the simulator leaves, and the correction of the deviations that it asks for."""

    square: float  #: of the whitened gap
    correction: FloatArray  #: shape (n_named,)
    sd: FloatArray  #: standard uncertainty of each deviation, shape (n_named,)
    off: float  #: largest correction in standard uncertainties
    converged: bool


def _asked(
    diagnosis: Diagnosis,
    differences: Differences,
    left: FloatArray,
    table: FloatArray,
    derivative: FloatArray,
    typical: FloatArray,
) -> _Asked:
    """Return what a table of the simulator (n_runs, 4) leaves of a gap (n_obs, n_channels), and what corrects it.

    `derivative`: by the named parameters, (n_runs, 4, n_named), whose typical sizes are (n_named,).
    """
    path, rows = diagnosis.fitted.path, differences.rows(diagnosis.fitted.path.s)
    gap = left - in_end_frame(path, difference(table, differences.nominal)[rows])
    columns = [
        in_end_frame(path, each * size) for each, size in zip(np.moveaxis(derivative[rows], 2, 0), typical, strict=True)
    ]
    whole = whitened_rows(path, diagnosis.noise, np.stack([*columns, gap], axis=2))
    a, white = whole[:, :-1], whole[:, -1]
    normal = a.T @ a + np.eye(len(typical)) / CORRECTION_SD**2
    correction, square = np.linalg.solve(normal, a.T @ white), float(white @ white)
    off = float(np.abs(correction * np.sqrt(np.diag(normal))).max())
    return _Asked(
        square,
        correction * typical,
        np.sqrt(np.diag(np.linalg.inv(normal))) * typical,
        off,
        off < CONVERGED[0 if square > len(white) else 1 + (differences.repeats > 1)],
    )


def _run(
    runner: SimulatorRunner, differences: Differences, named: Mapping[str, Declared], deviation: FloatArray
) -> FloatArray:
    values = {each.name: each.nominal + float(d) for each, d in zip(named.values(), deviation, strict=True)}
    what = "the fix " + ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
    jobs = [Job(runner.settings.nominal | values, what, repeat) for repeat in range(differences.repeats)]
    return averaged(runner.run(jobs))


def _moved(cause: Cause, named: Mapping[str, Declared], found: SimulatorFix) -> Cause:
    """Return a cause with its size where the reruns put it, its interval as wide as the derivative there makes it."""
    if cause.effect not in named:
        return cause
    each = named[cause.effect]
    quantity = cause.parameters[each.name]
    value, wider = found.deviation[each.name], found.wider[each.name]
    low, high = (value + wider * (end - quantity.value) for end in quantity.ci95)
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
