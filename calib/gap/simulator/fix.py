"""The fix of a simulator: what to set in it, by running it again, and the closure that it shows."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.errors import RefusedError
from calib.gap.decision import Trial, trials
from calib.gap.decision.causes import limited_to_even
from calib.gap.decision.diagnosis import Cause, Diagnosis, Quantity, VerdictKind
from calib.gap.decision.fix import harm, opened
from calib.gap.decision.held_out import Closure, closure_of
from calib.gap.decision.kind import NO_GAP_SHOWN, with_left
from calib.gap.decision.sentences import joined, sentence
from calib.gap.effects import Form
from calib.gap.effects.simulator import SIMULATOR_PREFIX, in_end_frame
from calib.gap.inference import ADEQUATE_CLOSURE, HALF_CLOSURE
from calib.gap.inference.fit import Fitted, hypothesis_path, signature_columns, whitened_rows
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.inference.noise import Noise
from calib.gap.predict import Path, residuals
from calib.gap.simulator import Declared
from calib.gap.simulator.runner import NOT_NOTHING, Differences, Job, averaged, difference
from calib.types import FloatArray, IntArray, few_digits

#: most runs with a fix, a secant step each
MOST_RERUNS: Final = 8
#: standard uncertainties below which a correction is worth no run; then where the gap is at the noise, and of a noisy
#: simulator
CONVERGED: Final = (0.3, 0.5, 1.0)
#: factor within which squares of a noisy simulator are alike
ALIKE: Final = 1.3
#: of the deviation, below which a step tells no slope beside rounding, or scatter
SECANT_SHARE: Final = (0.01, 0.05)
#: what settles a fix that the simulator does not confirm
FAR: Final = "set the nominal parameters nearer to what closes it, and diagnose again"
#: most of the gap's squares that parameters alone may leave
ALONE_SHARE: Final = 0.5
#: squares over the noise's that settle a fix
LACKING: Final = 1.5
#: prior standard deviation of a correction in typical sizes: a finite solution
CORRECTION_SD: Final = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulatorFix:
    """Deviations from nominal of named parameters, and what the simulator does there."""

    deviation: Mapping[str, float]
    table: FloatArray  #: shape (n_runs, 4)
    derivative: Mapping[str, FloatArray]  #: shape (n_runs, 4)
    wider: Mapping[str, float]  #: interval over that by the nominal derivative
    short: Mapping[str, float]  #: what the last run asked further
    settled: bool  #: whether that is within uncertainty, or noise was left
    square: float  #: of the whitened gap left


def named_parameters(diagnosis: Diagnosis, differences: Differences) -> dict[str, Declared]:
    """Return the simulator's parameters that a diagnosis names, by cause."""
    declared = differences.by_cause
    return {cause.effect: declared[cause.effect] for cause in diagnosis.causes if cause.effect in declared}


def fixed(
    diagnosis: Diagnosis, differences: Differences, fix: SimulatorFix, rng: np.random.Generator, unnamed: str = ""
) -> Diagnosis:
    """Return the diagnosis with what to set and the closure that the simulator shows with it; see `iterated`.

    `unnamed`: what is said of other parameters that close the gap, too.
    """
    named = named_parameters(diagnosis, differences)
    values = {each.name: each.nominal + fix.deviation[each.name] for each in named.values()}
    nominal = diagnosis.nominal
    before = residuals(nominal, nominal)
    change = difference(fix.table, differences.nominal)[differences.rows(nominal.s)]
    after = np.where(nominal.s.usable, before - in_end_frame(nominal, change), 0.0)
    held_out = closure_of(nominal, diagnosis.noise, before, after, rng)
    closure = held_out.closure
    assert diagnosis.evidence is not None
    # the parameters need not close what causes of the library take
    theirs = _without(diagnosis.fitted, named)
    own = closure_of(nominal, diagnosis.noise, theirs, theirs - (before - after), rng).closure
    closes, fits = (each.ci95 is not None and each.ci95[0] > ADEQUATE_CLOSURE for each in (closure, own))
    # what no run confirms may be the simulator's error
    denied = named if own.ci95 is None or own.ci95[1] < HALF_CLOSURE else ()
    causes = limited_to_even([_moved(cause, named, fix) for cause in diagnosis.causes], denied)
    kind = diagnosis.kind if closes and not closure.leaves_part else VerdictKind.PARTLY_EXPLAINED
    ran = trials(HeldOutFit(diagnosis.fitted, nominal, diagnosis.noise), before, after)
    opens = opened(nominal.s.usable, diagnosis.noise, before, after)
    worse = tuple(text.replace("held out", "run again with it", 1) for text in (*harm(ran), *opens)) or tuple(
        _farther(ran, closure)
    )
    recommended = diagnosis.fix.recommended and fits and fix.settled and not worse
    why = (*diagnosis.fix.why, *worse)
    if not fits:
        low, high = (100.0 * max(share, 0.0) for share in own.ci95 or (0.0, 0.0))
        wanted = f"where {100 * ADEQUATE_CLOSURE:.0f} % are to be certain"
        why = (*why, f"your simulator, run again with it, closes {low:.0f} to {high:.0f} % of the gap, {wanted}; {FAR}")
        why += tuple(
            f"{each.name} of your simulator stands at its largest: raise that where more is possible"
            for each in named.values()
            if abs(fix.deviation[each.name]) >= each.largest
        )
    elif not fix.settled:
        why = (*why, f"after {MOST_RERUNS} runs with it your simulator still asks for another value; {FAR}")
    diagnosis = replace(
        diagnosis,
        kind=kind,
        causes=tuple(causes),
        probabilities={**diagnosis.probabilities, **{cause.effect: cause.probability for cause in causes}},
        closure=closure,
        evidence=replace(diagnosis.evidence, held_out=held_out),
        fix=replace(diagnosis.fix, parameters=values, recommended=recommended, why=why, transfer=ran),
    )
    beside = _of_library(diagnosis)
    lacking = f" No parameter of your simulator does what {beside} of the library does." if beside else ""
    summary = f"{sentence(diagnosis)} {_what_to_set(named, values)}{unnamed or lacking}"
    return with_left(replace(diagnosis, sentence=summary))


def _farther(ran: Iterable[Trial], closure: Closure) -> Iterator[str]:
    # opposite errors keep ends near: headings weigh more
    for trial in ran:
        before_m, after_m = trial.before_rms_m or 0.0, trial.after_rms_m or 0.0
        if after_m**2 > before_m**2 + (closure.floor_rms_m or 0.0) ** 2:
            where = f"run again with it, {trial.left_out} {trial.value} ends {few_digits(1e3 * after_m)} mm off"
            yield f"{where}, {few_digits(1e3 * before_m)} mm without: another parameter is off, too; {FAR}"


def parameters_to_set(diagnosis: Diagnosis) -> dict[str, float]:
    """Return what to set in the simulator, by parameter; RefusedError if none is named."""
    if not diagnosis.fix.parameters:
        raise RefusedError(
            f"{diagnosis.campaign}: the verdict names no parameter of the simulator, so there is none to set; "
            "leave the simulator as it is, or add a parameter for the named effect"
        )
    before_m, after_m = diagnosis.closure.before_rms_m or 0.0, diagnosis.closure.after_rms_m or 0.0
    if after_m**2 > before_m**2 + (diagnosis.closure.floor_rms_m or 0.0) ** 2:
        raise RefusedError(
            f"{diagnosis.campaign}: with it the simulator ends {few_digits(1e3 * after_m)} mm off, "
            f"{few_digits(1e3 * before_m)} mm without; leave it as it is"
        )
    return dict(diagnosis.fix.parameters)


def iterated(diagnosis: Diagnosis, differences: Differences, start: SimulatorFix | None = None) -> SimulatorFix:
    """Run the simulator with the fix, and correct it by secant steps (Broyden 1965) until runs ask for no more.

    A step that leads away is halved. `start`: a fix already run, by default the diagnosis' parameters.
    """
    fitted = diagnosis.fitted
    sizes = {form.effect: float(theta[0]) for form, theta, _ in fitted.each()}
    named = named_parameters(diagnosis, differences)
    trial = None if start is not None else np.array([sizes[effect] for effect in named])
    return _followed(diagnosis, fitted, differences, named, start, trial)


def run_alone(
    diagnosis: Diagnosis, differences: Differences, named: Mapping[str, Declared], limit: float = np.inf
) -> SimulatorFix:
    """Return the fix by parameters alone; given up where it promises to leave `limit`, or half of the gap's squares."""
    assert diagnosis.evidence is not None
    base = diagnosis.evidence.search.base
    most = min(limit, ALONE_SHARE * base.chi_square)
    return _followed(diagnosis, base, differences, named, None, limit=most)


def _followed(
    diagnosis: Diagnosis,
    fitted: Fitted,
    differences: Differences,
    named: Mapping[str, Declared],
    start: SimulatorFix | None,
    trial: FloatArray | None = None,
    limit: float = np.inf,
) -> SimulatorFix:
    names = [each.name for each in named.values()]
    typical = np.array([each.parameter.typical for each in named.values()])
    left = _without(fitted, named)
    about = np.stack([differences.change[name] for name in names], axis=2)
    if start is None:
        at, table, slope = np.zeros(len(names)), differences.nominal, about
    else:
        at, table = np.array([start.deviation[name] for name in names]), start.table
        slope = np.stack([start.derivative[name] for name in names], axis=2)

    def asked(table: FloatArray, slope: FloatArray) -> _Asked:
        return _Asked(diagnosis.noise, fitted.path, differences, left, table, slope, typical)

    now = asked(table, slope)
    trial = _within(named, at + now.correction if trial is None else trial)
    for number in range(MOST_RERUNS):
        # one run from nominal shows what a step there does not
        if (now.converged or now.promised >= limit) and (number or start is not None):
            break
        new = _run(differences, named, trial)
        scaled, steeper = (trial - at) / typical, slope
        if np.linalg.norm(scaled) > SECANT_SHARE[differences.repeats > 1] * np.linalg.norm(trial / typical):
            miss = difference(new, table) - slope @ (trial - at)
            steeper = slope + miss[:, :, None] * (scaled / typical) / (scaled @ scaled)
        then = asked(new, steeper)
        if then.square < (ALIKE if then.converged and differences.repeats > 1 else 1.0) * now.square:
            at, table, slope, now = trial, new, steeper, then
            trial = _within(named, at + now.correction)
        elif then.converged:
            break
        elif len(names) == 1:
            trial = _within(named, 0.5 * (at + trial))
        else:
            # half as far at most, where what that run showed sends it
            slope, reach = steeper, 0.5 * float(np.linalg.norm(scaled))
            now = asked(table, slope)
            step = _within(named, at + now.correction) - at
            trial = at + step * min(1.0, reach / max(float(np.linalg.norm(step / typical)), 1e-12))
    return SimulatorFix(
        dict(zip(names, map(float, at), strict=True)),
        table,
        dict(zip(names, np.moveaxis(slope, 2, 0), strict=True)),
        dict(zip(names, map(float, now.sd / asked(table, about).sd), strict=True)),
        dict(zip(names, map(float, np.abs(now.correction)), strict=True)),
        now.off < CONVERGED[2] or now.square < LACKING * int(fitted.path.s.usable.sum()),
        now.square,
    )


def _within(named: Mapping[str, Declared], deviation: FloatArray) -> FloatArray:
    # none implausible, nor a length of 0: a simulator may fail there
    nominal, far = np.array([(each.nominal, each.largest) for each in named.values()]).T
    inside: FloatArray = np.clip(deviation, -far, far)
    return np.where(inside == -nominal, NOT_NOTHING * inside, inside)


def _without(fitted: Fitted, named: Mapping[str, Declared]) -> FloatArray:
    path = fitted.path
    theta = [np.zeros_like(size) if form.effect in named else size for form, size, _ in fitted.each()]
    without = hypothesis_path(path.s, fitted.calibration, fitted.forms, theta, path)
    return fitted.left + in_end_frame(path, (path.reading - without.reading)[:, :4])


class _Asked:
    def __init__(
        self,
        noise: Noise,
        path: Path,
        differences: Differences,
        left: FloatArray,
        table: FloatArray,
        derivative: FloatArray,
        typical: FloatArray,
    ) -> None:
        rows = differences.rows(path.s)
        gap = left - in_end_frame(path, difference(table, differences.nominal)[rows])
        derivatives = zip(np.moveaxis(derivative[rows], 2, 0), typical, strict=True)
        columns = [in_end_frame(path, each * size) for each, size in derivatives]
        whole = whitened_rows(path, noise, np.stack([*columns, gap], axis=2))
        a, white = whole[:, :-1], whole[:, -1]
        normal = a.T @ a + np.eye(len(typical)) / CORRECTION_SD**2
        correction = np.linalg.solve(normal, a.T @ white)
        #: of the whitened gap; of what the correction leaves, if linear
        self.square = float(white @ white)
        self.promised = self.square - float(correction @ (a.T @ white))
        #: shape (n_named,): correction of each deviation, and its standard uncertainty
        self.correction, self.sd = correction * typical, np.sqrt(np.diag(np.linalg.inv(normal))) * typical
        #: largest correction in standard uncertainties
        self.off = float(np.abs(correction * np.sqrt(np.diag(normal))).max())
        self.converged = self.off < CONVERGED[0 if self.square > len(white) else 1 + (differences.repeats > 1)]


def _run(differences: Differences, named: Mapping[str, Declared], deviation: FloatArray) -> FloatArray:
    runner = differences.runner
    values = {each.name: each.nominal + float(d) for each, d in zip(named.values(), deviation, strict=True)}
    what = "the fix " + ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
    jobs = [Job(runner.settings.nominal | values, what, repeat) for repeat in range(differences.repeats)]
    return averaged(runner.run(jobs))


def _moved(cause: Cause, named: Mapping[str, Declared], fix: SimulatorFix) -> Cause:
    if cause.effect not in named:
        return cause
    each = named[cause.effect]
    quantity = cause.parameters[each.name]
    value, wider, short = fix.deviation[each.name], fix.wider[each.name], fix.short[each.name]
    low, high = (value + wider * (end - quantity.value) for end in quantity.ci95)
    low, high = low - short, high + short
    return replace(cause, parameters={each.name: Quantity(value, (low, high), quantity.unit)})


def _what_to_set(named: Mapping[str, Declared], values: Mapping[str, float]) -> str:
    parts = []
    for each in named.values():
        value, unit = values[each.name], "" if each.unit in ("", "1") else f" {each.unit}"
        off = each.nominal - value
        way = "large" if off > 0.0 else "small"
        in_percent = min(value, each.nominal) > 0.0 and abs(off) < 0.5 * value
        size = f"{100 * abs(off) / value:.2g} %" if in_percent else f"{abs(off):.3g}{unit}"
        parts.append(f"{each.name} of your simulator is {size} too {way}: set it to {value:.6g}{unit}")
    return f"{'; '.join(parts)}."


def without_parameter(diagnosis: Diagnosis, unnamed: str) -> Diagnosis:
    """Return a diagnosis that names no parameter, and says so; closure on held-out runs. `unnamed`: see `fixed`."""
    if diagnosis.kind in NO_GAP_SHOWN or any(
        name.startswith(SIMULATOR_PREFIX) for group in diagnosis.groups for name in group
    ):
        return diagnosis
    if unnamed:
        return replace(diagnosis, sentence=f"{diagnosis.sentence}{unnamed}")
    named = _of_library(diagnosis)
    able = "can in part" if diagnosis.kind is VerdictKind.PARTLY_EXPLAINED else "can"
    can = f"; {named} of the library {able}" if diagnosis.causes else ""
    why = f"No parameter of your simulator can do this{can}.{_forbidden(diagnosis)}"
    return replace(diagnosis, sentence=f"{diagnosis.sentence} {why}")


def scaled_signatures(diagnosis: Diagnosis) -> tuple[list[Form], IntArray, FloatArray, FloatArray]:
    """Return the parameters' forms, signs and whitened signatures (n_rows, k) at the largest, and the gap (n_rows,)."""
    nominal, own = (
        diagnosis.nominal,
        [e for e in diagnosis.arrays.effects.values() if e.id.startswith(SIMULATOR_PREFIX)],
    )
    forms = [form for effect in own for form in effect.forms(nominal.s)]
    largest = np.array([parameter.largest / parameter.typical for form in forms for parameter in form.parameters])
    columns = [column * size for column, size in zip(signature_columns(nominal, forms), largest, strict=True)]
    gap = residuals(nominal, nominal)[:, :, None]
    whole = whitened_rows(nominal, diagnosis.noise, np.concatenate([*columns, gap], axis=2))
    sign = np.array([form.parameters[0].sign for form in forms])
    return forms, sign, whole[:, :-1], whole[:, -1]


def square_left(columns: FloatArray, gap: FloatArray, sign: IntArray) -> float:
    """Return the squares of a gap (n_rows,) that columns (n_rows, k) leave; infinite if implausible."""
    sizes = np.linalg.solve(columns.T @ columns + 1e-9 * np.eye(len(sign)), columns.T @ gap)
    possible = (np.abs(sizes) < 1.0).all() and (sizes * sign >= 0.0).all()
    return float(((gap - columns @ sizes) ** 2).sum()) if possible else np.inf


def left_by(columns: FloatArray, aim: FloatArray, sign: IntArray) -> FloatArray:
    """Return what columns (n_rows, k) of unit prior leave of an aim (n_rows,), (n_rows,).

    `sign`: (k,), 1 or -1 of sizes of that sign only, else 0.
    """
    from scipy.optimize import lsq_linear

    bounds = np.where(sign > 0, 0.0, -np.inf), np.where(sign < 0, 0.0, np.inf)
    ridged = np.concatenate([columns, np.eye(len(sign))]), np.concatenate([aim, np.zeros(len(sign))])
    return np.asarray(aim - columns @ lsq_linear(*ridged, bounds).x)


def bend(diagnosis: Diagnosis, differences: Differences, fix: SimulatorFix) -> float:
    """Return how far a fix's run is off its parameters' changes about nominal, whitened."""
    change = difference(fix.table, differences.nominal)
    straight = sum((differences.change[name] * size for name, size in fix.deviation.items()), np.zeros_like(change))
    nominal = diagnosis.nominal
    missed = in_end_frame(nominal, (change - straight)[differences.rows(nominal.s)])
    return float(np.linalg.norm(whitened_rows(nominal, diagnosis.noise, missed[:, :, None])))


def _forbidden(diagnosis: Diagnosis) -> str:
    forms, signs, a, r = scaled_signatures(diagnosis)
    for form, sign, column in zip(forms, signs, a.T, strict=True):
        left = left_by(column[:, None], r, np.array([-sign]))
        if sign and left @ left < (1.0 - ADEQUATE_CLOSURE) * float(r @ r):
            return f" {form.parameters[0].name} of your simulator would, but for the sign = {sign} that it is given."
    return ""


def _of_library(diagnosis: Diagnosis) -> str:
    return joined((c.effect for c in diagnosis.causes if not c.effect.startswith(SIMULATOR_PREFIX)), "and")
