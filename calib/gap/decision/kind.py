"""The kind of verdict by gap probability, causes and closure, and the decision's thresholds."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.errors import CalibError
from calib.gap.decision import Trial, most_square, reach_of_noise
from calib.gap.decision.diagnosis import Cause, Diagnosis, Evidence, Unexplained, VerdictKind
from calib.gap.decision.held_out import RERUN, Closure, Improvement, end_rms_m
from calib.gap.effects import forms_on
from calib.gap.effects.encoder import BLUNDER_MISFIT, misfit
from calib.gap.effects.reference import ReferenceScale
from calib.gap.inference import (
    ADEQUATE_CLOSURE,
    CERTAIN_PROBABILITY,
    CONFIDENCE,
    FALSE_ALARM,
    FALSE_REJECTION,
    HALF_CLOSURE,
    HIDDEN_CLOSURE,
    NEGLIGIBLE_GROWTH,
    NOISE_LEVELS,
    REPORTED_GAP_PROBABILITY,
    SMALL_SHARE,
)
from calib.gap.inference.fit import hypothesis_path
from calib.gap.inference.noise import MAX_NOISE_EXCESS, STATED_EXCESS, Noise
from calib.gap.observations import Channel
from calib.gap.predict import Path, residuals
from calib.types import few_digits

if TYPE_CHECKING:
    from calib.kinematics.result import Geometry

#: share of the largest cause's that is a hundredth of its size: no law is known closer
NEGLIGIBLE_SHARE: Final = 1e-4
#: verdicts that name no cause
NO_GAP_SHOWN: Final = frozenset({VerdictKind.NO_GAP, VerdictKind.UNDECIDED})
NOTHING_NAMED: Final = NO_GAP_SHOWN | {VerdictKind.UNKNOWN}
#: beginning of an unexplained residual's place on the floor
ON_FLOOR: Final = "on the floor"


def fails(trial: Trial) -> bool:
    """Return whether there is a gap beyond chance where held out, and too much of it remains."""
    gap, residual = trial.before_square - trial.noise_square, trial.after_square - trial.noise_square
    beyond_chance = min(trial.before_square, trial.after_square) > trial.noise_limit
    return beyond_chance and residual > (1.0 - ADEQUATE_CLOSURE) * gap


def hides_causes(closure: Closure, unexplained_share: float | None) -> bool:
    """Return whether the closure cannot support causes: each then needs a high probability."""
    if unexplained_share is not None and (closure.fraction is None or closure.fraction < HIDDEN_CLOSURE):
        return True
    return closure.ci95 is not None and closure.ci95[1] < ADEQUATE_CLOSURE and closure.ci95[0] <= HIDDEN_CLOSURE


def is_shown(causes: Iterable[Cause], improvement: Improvement | None) -> bool:
    """Return whether certain causes take more than half of a gap off runs not fitted on: no noise, at any level."""
    certain = any(cause.probability >= CERTAIN_PROBABILITY for cause in causes)
    return certain and improvement is not None and improvement.closed_ci95[0] >= HALF_CLOSURE


def kind_of(
    gap_probability: float,
    causes: Sequence[Cause],
    closure: Closure,
    *,
    incomplete: bool = False,
    unexplained_share: float | None = None,
    tied: bool = False,
    supported: bool = True,
    misfit: float = 0.0,
) -> VerdictKind:
    """Return the verdict.

    Parameters
    ----------
    gap_probability, causes, closure
        Of any gap; what would be named; on held-out runs.
    incomplete, unexplained_share
        Whether the correction fails there, or a large cause differs between groups; what no cause explains.
    tied
        Whether a more than small cause is confounded with an effect of another family.
    supported
        Whether the runs support a noise level.
    misfit
        How far runs end off with the causes corrected, over their length, on average.
    """
    high = closure.ci95[1] if closure.ci95 else 1.0
    unexplained = unexplained_share is not None
    if not supported and misfit < BLUNDER_MISFIT:
        return VerdictKind.UNDECIDED
    if gap_probability < REPORTED_GAP_PROBABILITY and misfit < BLUNDER_MISFIT:
        return VerdictKind.NO_GAP
    if not causes or misfit >= BLUNDER_MISFIT or (unexplained and high < HALF_CLOSURE):
        return VerdictKind.UNKNOWN
    if hides_causes(closure, unexplained_share):
        certain = any(cause.probability >= CERTAIN_PROBABILITY for cause in causes)
        return VerdictKind.PARTLY_EXPLAINED if certain else VerdictKind.UNKNOWN
    if closure.leaves_part or incomplete or (unexplained_share or 0.0) > SMALL_SHARE:
        return VerdictKind.PARTLY_EXPLAINED
    return VerdictKind.AMBIGUOUS if tied else VerdictKind.EXPLAINED


def tells_more(windows: Diagnosis, ends: Diagnosis) -> bool:
    """Return whether windows of recordings show what ends do not, as a delay that does not add up along the way.

    A gap beyond chance that is mostly no noise where ends show none, or causes of all of one without likely ones there.
    """
    if ends.kind not in NO_GAP_SHOWN and not ends.is_improbable:
        return windows.kind is VerdictKind.EXPLAINED and windows.recommended
    large = any(line.before_rms > NOISE_LEVELS * line.floor_rms for line in windows.closure.channels)
    return large and windows.kind not in NO_GAP_SHOWN and (windows.gap_probability or 0.0) >= 1.0 - FALSE_ALARM


def kept_back(diagnosis: Diagnosis, nominal: Path, noise: Noise) -> Diagnosis:
    """Return a diagnosis, its fix not recommended where it takes other observations of the same runs further off.

    `nominal`, `noise`: of whole runs for a diagnosis by windows of the recordings, else of their windows.
    """
    from scipy.special import stdtrit

    if not diagnosis.recommended:
        return diagnosis
    fix, seen, effects = diagnosis.correction, nominal.s, diagnosis.arrays.effects
    offered = zip(forms_on(seen, effects, fix.forms), fix.theta, strict=True)
    acting = [(form, size) for form, size in offered if form is not None]
    forms, theta = [form for form, _ in acting], [size for _, size in acting]
    corrected = hypothesis_path(seen, fix.calibration, forms, theta, nominal)
    gaps = [residuals(path, nominal) for path in (nominal, corrected)]
    before, after = ((np.where(seen.usable, gap / noise.floor, 0.0) ** 2).sum(axis=1) for gap in gaps)
    grown, n = after - before, len(seen)
    # one chance in twenty; a delay does nothing at ends
    chance = float(stdtrit(max(n - 1, 1), CONFIDENCE)) * float(np.std(grown)) / sqrt(n)
    if grown.mean() <= max(chance, NEGLIGIBLE_GROWTH * float(seen.usable.sum(axis=1).mean())):
        return diagnosis
    sizes = [few_digits(1e3 * (end_rms_m(gap, seen) or 0.0)) for gap in gaps]
    ends = "windows of the recordings" if seen.windowed else "whole runs"
    why = f"{ends} end {sizes[1]} mm off with it, {sizes[0]} mm without; 'calib plan' names the runs that tell"
    return replace(diagnosis, fix=replace(diagnosis.fix, recommended=False, why=(why, *diagnosis.fix.why)))


#: columns of a reference along the path
OF_A_PATH: Final = frozenset(("ref_x_m", "ref_theta_rad"))
#: blunders that 'calib geometry' names and no effect says
OF_REFERENCE: Final = ("axis_scale", "heading_scale")


def beside_geometry(diagnosis: Diagnosis, campaign: Campaign) -> Diagnosis:
    """Return a diagnosis of recordings beside what `calib geometry` says of them.

    No fix is recommended beside unlike scales of the reference; radii and track that differ are noted.
    """
    scaled = any(ReferenceScale.id in group for group in diagnosis.groups)
    if not (diagnosis.recommended or scaled) or not OF_A_PATH.intersection(campaign.logs.columns):
        return diagnosis
    from calib.kinematics.estimate import estimate_geometry

    with suppress(CalibError):
        geometry = estimate_geometry(campaign)
        if geometry.passed:
            return replace(diagnosis, notes=(*diagnosis.notes, *_unlike(diagnosis, geometry)))
        if why := [fault.text for fault in geometry.faults if fault.code in OF_REFERENCE]:
            fix, first = (
                replace(diagnosis.fix, recommended=False, why=(*why, *diagnosis.fix.why)),
                [f"{text}." for text in why],
            )
            sentence = f"Correct this first: {' '.join(first)} Until then: {diagnosis.sentence}"
            return replace(diagnosis, fix=fix, correct_first=(*first, *diagnosis.correct_first), sentence=sentence)
    return diagnosis


def _unlike(diagnosis: Diagnosis, geometry: "Geometry") -> Iterator[str]:
    fix, model, parts = diagnosis.correction.at_end(), diagnosis.observations.model, list[str]()
    for number, name in enumerate(("radius_left_m", "radius_right_m", "track_m")):
        sd, relative = sqrt(float(fix.covariance[number, number])), float(fix.calibration[number])
        for own in (own for own in geometry.estimates if own.name == name):
            low, value, high = (size / getattr(model, name) - 1.0 for size in (own.ci95[0], own.value, own.ci95[1]))
            if not low - 2.0 * sd <= relative <= high + 2.0 * sd:
                off = f"{100 * value:+.2f} % ({100 * low:+.2f} to {100 * high:+.2f} %)"
                parts.append(f"{name} by {off}, not {100 * relative:+.2f} %")
    if parts:
        text = "on routes unlike these the two corrections differ: drive a straight and turns both ways"
        yield f"'calib geometry' of the same recordings corrects {', '.join(parts)}: {text}"


def with_left(diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis with what a partial explanation leaves on held-out runs, in numbers and as a note.

    Nothing is added where an unexplained residual is known, or where nothing is left.
    """
    closure, evidence = diagnosis.closure, diagnosis.evidence
    known = diagnosis.unexplained or diagnosis.left
    if known is not None or diagnosis.kind is not VerdictKind.PARTLY_EXPLAINED:
        return diagnosis
    left: list[tuple[float, str]] = []
    beyond = [line for line in closure.channels if line.after_rms > line.floor_rms > 0.0] if closure.leaves_part else []
    large = [line for line in beyond if line.after_rms > NOISE_LEVELS * line.floor_rms]
    for line in large or beyond:
        times = line.after_rms / line.floor_rms
        n = 1 if evidence is None else int(evidence.observations.usable[:, line.channel].sum())
        left.append((n * (times**2 - 1.0), f"{line.channel.label}: {few_digits(times, 2)} times its noise level"))
    failed = filter(fails, diagnosis.fix.transfer)
    left += [(each.after_square - each.noise_square, f"{each.left_out} {each.value}, held out") for each in failed]
    if not left:
        return diagnosis
    where = tuple(words for _, words in left)
    # of the whole gap: a small one may stay
    share, square = 1.0 - (closure.fraction or 0.0), max(left)[0]
    on = "run again with the fix" if closure.held_out == RERUN else "on held-out runs"
    note = f"left {on}: {'; '.join(where)}; repeats in another session tell noise from a further cause"
    unexplained = Unexplained(min(max(share, 0.0), 1.0), sqrt(square), where)
    return replace(diagnosis, left=unexplained, notes=(*diagnosis.notes, note))


def scatters_alone(evidence: Evidence) -> str:
    """Return how much runs, too few of them driven twice, scatter beyond the stated noise; empty if not beyond it.

    Beyond any level as uncertain as `log_marginal` takes the stated one; what follows no covariate nor takes runs far
    off may be all noise.
    """
    n_rows, square = int(evidence.observations.usable.sum()), evidence.fitted.chi_square
    shown = evidence.where.significant or misfit_of(evidence) >= BLUNDER_MISFIT
    if evidence.noise.dof > 0.0 or not evidence.noise.supported or shown or square <= most_square(n_rows):
        return ""
    times = sqrt(square / n_rows)
    return f"nothing: runs, too few of them driven twice, scatter {times:.2g} times as much as the stated sigmas"


def no_mere_noise(evidence: Evidence) -> str:
    """Return in which channel repeats scatter far more than stated and follow a covariate, or beyond all measure."""
    excess = np.nan_to_num(evidence.noise.excess)
    by_channel = {line.channel: line for line in evidence.where.significant if line.channel is not None}
    odd = [channel for channel in by_channel if excess[channel] > STATED_EXCESS]
    channel = max(odd, key=lambda each: excess[each], default=Channel(int(np.argmax(excess))))
    if not odd and excess[channel] <= MAX_NOISE_EXCESS:
        return ""
    names = ", ".join(line.name for line in evidence.where.significant if line.channel is channel)
    follow = f"and follow {names}" if odd else "which single runs may make: look at those with the largest gap"
    return (
        f"repeats that scatter {few_digits(excess[channel], 2)} times as much in {channel.label} as the stated sigmas "
        f"and typical wheels would, {follow}"
    )


def stands_off(evidence: Evidence) -> bool:
    """Return whether runs that agree stand off on one side beyond the reach of noise.

    All runs of a condition, or one of a route and another beyond noise there. Of recordings also all together by what
    no single one is by noise, or any one where others were omitted; without repeats, all beyond any level as uncertain
    as `log_marginal` takes the stated one.
    """
    usable, noise = evidence.observations.usable, evidence.noise
    if noise.dof <= 0.0 and evidence.fitted.chi_square > most_square(int(usable.sum())):
        return True
    scaled = np.where(usable, evidence.fitted.left / noise.floor, 0.0)
    known = np.broadcast_to(noise.dof if noise.levels_dof is None else noise.levels_dof, usable.shape)
    reach = reach_of_noise(known, int(usable.sum()))
    if evidence.observations.windowed:
        together = ((scaled**2).sum(axis=0) > (reach**2 * usable).sum(axis=0)).any()
        if together or (evidence.situation.omitted and (abs(scaled) > reach).any()):
            return True
    _, condition, count = np.unique(evidence.observations.condition, return_inverse=True, return_counts=True)
    agree = [np.bincount(condition, beyond) == count for beyond in [*(reach < scaled).T, *(-reach > scaled).T]]
    recordings, _ = np.unique(np.stack([condition, evidence.observations.run]), axis=1)
    if (np.array(agree) & (np.bincount(recordings) > 1)).any():
        return True
    for route in () if evidence.observations.windowed else np.unique(evidence.observations.kind):
        mine = evidence.observations.kind == route
        second = reach_of_noise(known[mine], int(usable[mine].sum()))
        for side in (scaled[mine], -scaled[mine]):
            if ((side > reach[mine]).any(axis=0) & ((side > second).sum(axis=0) > 1)).any():
                return True
    return False


def misfit_of(evidence: Evidence) -> float:
    """Return by how much of their length runs end off with the causes corrected, on average."""
    return float(np.mean(misfit(evidence.fitted.path, evidence.nominal)))


#: effects beside a cause that is not sure that the next runs should exclude
MOST_RIVALS: Final = 3


def open_questions(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return the effects that the next runs should tell apart, named ones first.

    These are the confounded groups; beside a fix that is kept back else each cause that is not sure, and what the runs
    may show instead.
    """
    if diagnosis.groups or diagnosis.recommended:
        return [*diagnosis.groups]
    named = {cause.effect for cause in diagnosis.causes}
    rivals = [name for name, p in diagnosis.probabilities.items() if p >= FALSE_REJECTION and name != "unknown"]
    rivals = [name for name in rivals if name not in named][:MOST_RIVALS]
    doubtful = [cause.effect for cause in diagnosis.causes if cause.probability < CERTAIN_PROBABILITY]
    return [(effect, rival) for effect in doubtful for rival in rivals]
