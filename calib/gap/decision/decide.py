"""From evidence to diagnosis: what is named, which verdict that gives, and what the fix is worth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import prod
from typing import Final

import numpy as np

from calib.campaign.check import implausible, notes_for_results, swapped_sessions
from calib.campaign.checks import columns_as_one, listed
from calib.campaign.checks.measurements import loads_against_payload
from calib.campaign.model import Note
from calib.gap.decision import causes as naming
from calib.gap.decision import confounding, reach_of_noise, sentences
from calib.gap.decision.constancy import SizeDifference, size_differences, unchecked, without_refuted
from calib.gap.decision.diagnosis import Cause, Diagnosis, Evidence, Fix, NoiseSummary, Situation, VerdictKind
from calib.gap.decision.fix import (
    beyond_vehicles,
    fix_of,
    noise_bounded,
    parting,
    ranked,
    shown_by_many,
    without_length,
)
from calib.gap.decision.held_out import Closure
from calib.gap.decision.kind import (
    NO_GAP_SHOWN,
    NOTHING_NAMED,
    fails,
    hides_causes,
    is_shown,
    kind_of,
    misfit_of,
    no_mere_noise,
    scatters_alone,
    stands_off,
)
from calib.gap.decision.part import as_delivered, is_named_beside, moved, sure_part
from calib.gap.effects import Family, Form
from calib.gap.effects.encoder import BAD_RUN_RATIO, BLUNDER_MISFIT
from calib.gap.effects.radii import NAMES
from calib.gap.inference import (
    CERTAIN_PROBABILITY,
    CONFIDENCE,
    EVEN_PROBABILITY,
    FALSE_ALARM,
    LOG_EVIDENCE_WINDOW,
    NAMED_PROBABILITY,
    SMALL_SHARE,
)
from calib.gap.inference.marginal_likelihood import Nuisance
from calib.gap.localise.locate import by_run

#: families of unlike corrections
OWN_CORRECTIONS: Final = frozenset({Family.SIMULATOR, Family.CALIBRATION})


#: what to write where places mean nothing
FRAME: Final = 'write reference.frame = "start" where each begins anywhere'
#: remarks before a verdict: more push it off the screen
MOST_SAID: Final = 3


def decide(evidence: Evidence) -> Diagnosis:
    """Return the diagnosis with its sentence; the caller adds detection limits and runs to drive next."""
    confounded = without_refuted(evidence, confounding.groups_of(evidence))
    groups, forms_open = _by_family(evidence, confounded)
    unexplained, situation = naming.unexplained_of(evidence), evidence.situation
    stated = confounding.effect_probabilities(evidence, confounded)
    certain = confounding.with_alternatives(evidence, confounded)
    probable = {name for name, probability in certain.items() if probability >= NAMED_PROBABILITY}
    differing = size_differences(evidence, probable)
    causes = naming.limited_beside(naming.causes_of(evidence, stated, certain, forms_open), unexplained)
    causes = naming.limited_to_even(causes, {group[0] for group in groups if parting(group)}.union(differing))
    small = _small(evidence, causes, probable, certain)
    causes = [cause for cause in causes if cause.effect in probable.difference(small)]
    # probable by an alias, hardly in the 95 % set
    likely = [cause for cause in causes if cause.probability > 1.0 - CONFIDENCE]
    placed, unexplained = naming.places_as_unexplained(evidence, likely, unexplained)
    doubted, causes = len(likely) < len(causes), [cause for cause in likely if cause not in placed]
    causes = naming.limited_beside(causes, unexplained, naming.left_held_out(evidence))
    shared = {cause.effect for cause, _ in naming.Finding(causes, certain, differing=differing).parts()}
    causes = naming.limited_to_even(causes, shared.union(open_sizes := unchecked(evidence, causes)))
    stated |= {cause.effect: cause.probability for cause in causes if cause.effect in stated}
    stated |= {cause.effect: min(cause.probability, EVEN_PROBABILITY) for cause in placed}
    stated["unknown"] = max([stated["unknown"], *(cause.probability for cause in placed)])
    closure, gap_probability = evidence.held_out.closure, confounding.gap_probability(evidence)
    share = 1.0 if evidence.denied else None if unexplained is None else unexplained.share
    doubtful = doubted or bool(open_sizes) or _rather_not(causes, certain)
    kind = _kind(evidence, gap_probability, causes, share, groups, differing, doubtful)
    kind, gap_probability, noise_level = _as_shown(evidence, kind, gap_probability)
    if kind in NOTHING_NAMED:
        causes = []
    elif hides_causes(closure, share) or not evidence.noise.supported:
        causes = [cause for cause in causes if cause.probability >= CERTAIN_PROBABILITY]
    tied = tied_with(causes, groups)
    finding = naming.Finding(causes, certain, unexplained, differing, tied, open_sizes)
    fix = as_delivered(evidence, finding, fix_of(evidence, finding, confounded, small))
    if (causes or situation.faults) and not fix.recommended and evidence.noise.supported:
        fix = sure_part(evidence, finding, fix)
        causes = [cause for cause in causes if is_named_beside(cause, fix, finding)]
    causes, closure = ranked(naming.as_corrected(evidence, causes, fix)), fix.closure or closure
    fix = shown_by_many(fix, closure)
    kind = _as_delivered(kind, fix, closure)
    diagnosis = Diagnosis(
        kind=_beside_blunder(kind) if situation.faults else kind,
        sentence="",
        causes=(*map(naming.blunder_cause, situation.faults), *causes),
        credible_sets=confounding.credible_sets(evidence, () if kind in NOTHING_NAMED else confounded),
        groups=tuple(map(tuple, tied_with(causes, tied))),
        where=evidence.where,
        closure=closure,
        unexplained=None if kind in NO_GAP_SHOWN and not situation.faults else unexplained,
        fix=replace(fix, moves=moved(evidence, fix, causes)) if causes else fix,
        notes=(*evidence.observations.notes, *situation.notes, *_on_causes(evidence, causes, small)),
        noise_level=noise_level,
        probabilities=dict(sorted(stated.items(), key=lambda item: -item[1])),
        judged_against=evidence.judged_against,
        campaign=situation.campaign.name,
        simulated=situation.campaign.simulated,
        gap_probability=1.0 if situation.faults else gap_probability,
        evidence=evidence,
    )
    return _in_words(*_of_sound_data(diagnosis, situation), evidence)


def _of_sound_data(diagnosis: Diagnosis, situation: Situation) -> tuple[Diagnosis, list[Note]]:
    fix, wrong = diagnosis.fix, [] if diagnosis.kind in NOTHING_NAMED else _wrong_data(situation, diagnosis)
    why = [f"sizes follow {note.where}, which cannot be as stated ({note.text}): correct this first" for note in wrong]
    fix = replace(fix, recommended=fix.recommended and not wrong, why=(*why, *fix.why))
    return replace(diagnosis, fix=fix), wrong


def _wrong_data(situation: Situation, diagnosis: Diagnosis) -> list[Note]:
    if situation.faults:
        return []
    # wrong loads spoil what follows the load, or hide it in the rest
    of_load = diagnosis.unexplained is not None or any("load" in cause.effect for cause in diagnosis.causes)
    runs, campaign = situation.campaign.runs, situation.campaign.included()
    # runs omitted may show what is wrong with their session
    every = replace(runs, excluded=runs.excluded & ~np.isin(runs.run_id, list(situation.omitted)))
    of_sessions = swapped_sessions(replace(situation.campaign, runs=every).included())
    notes, odd = (
        [*implausible(campaign), *of_sessions],
        [note.run_id for note in loads_against_payload(campaign) if note.run_id],
    )
    if 0 < 2 * len(odd) < len(campaign.runs) and not any("load" in note.where for note in notes):
        text = "vehicle and payload ask for other loads; check unit and weighing"
        notes.append(Note("wrong", f"runs {listed(odd)}, load_left_N, load_right_N", text))
    return [note for note in notes if of_load or "load" not in note.where]


def _as_shown(evidence: Evidence, kind: VerdictKind, gap_probability: float) -> tuple[VerdictKind, float, NoiseSummary]:
    noise_level = NoiseSummary.about(evidence.noise)
    words = scatters_alone(evidence) if kind in {VerdictKind.NO_GAP, VerdictKind.UNKNOWN} else ""
    if words := words or (kind is VerdictKind.NO_GAP and no_mere_noise(evidence)) or "":
        return VerdictKind.UNDECIDED, gap_probability, replace(noise_level, supported=False, support=words)
    if kind is VerdictKind.NO_GAP and stands_off(evidence):
        return VerdictKind.UNKNOWN, 1.0 - FALSE_ALARM, noise_level
    return kind, gap_probability, noise_level


def _as_delivered(kind: VerdictKind, fix: Fix, closure: Closure) -> VerdictKind:
    left = closure.leaves_part or closure.rests_on_few or (fix.recommended and any(map(fails, fix.transfer)))
    return VerdictKind.PARTLY_EXPLAINED if left and kind not in NOTHING_NAMED else kind


def tied_with(causes: Sequence[Cause], groups: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """Return the groups of the causes: what looks like an unnamed one says nothing of these."""
    return [group for group in groups if len(group) > 1 and group[0] in {cause.effect for cause in causes}]


def _in_words(diagnosis: Diagnosis, wrong: Sequence[Note], evidence: Evidence) -> Diagnosis:
    off = misfit_of(evidence)
    blunder = diagnosis.kind is VerdictKind.UNKNOWN and off >= BLUNDER_MISFIT
    sentence = sentences.blunder_sentence(diagnosis, off) if blunder else sentences.sentence(diagnosis)
    if diagnosis.kind in NOTHING_NAMED:
        first = _on_data(evidence.situation, blunder) or _single_runs(evidence) * (diagnosis.kind is VerdictKind.NO_GAP)
        if diagnosis.kind is VerdictKind.NO_GAP and evidence.situation.omitted:
            names = sentences.joined(evidence.situation.omitted, "and")
            first = (*first, f"{names} alone: look at reference, start, counts and steering, or exclude.")
    else:
        first = tuple(note.sentence for note in wrong)
        blunders = (cause for cause in diagnosis.causes if cause.signal == float("inf"))
        first += tuple(f"{cause.form}: {cause.remark}." for cause in blunders)
    lead = f"Correct this first: {' '.join(first)} Until then: " if first else ""
    text = lead + sentence + _on_scatter(evidence) + _on_omitted(evidence.situation.omitted)
    for note in columns_as_one(evidence.situation.campaign.included()):
        words = [word for cause in diagnosis.causes for word in (cause.family, cause.effect.partition("_")[0]) if word]
        if any(word in note.where for word in words):
            where = note.where.replace(", columns", ",")
            text += f" In these {where} change together: sizes hold if only one of the two acts."
    first = first or (sentences.CHECK_UNITS,) * blunder
    if not diagnosis.causes:
        why = (*first, *diagnosis.fix.why, sentences.nothing_to_apply(diagnosis))
        diagnosis = replace(diagnosis, fix=replace(diagnosis.fix, why=why))
    return replace(diagnosis, sentence=text, correct_first=first)


def _on_data(situation: Situation, off: bool) -> tuple[str, ...]:
    wrong = tuple(note.sentence for note in implausible(situation.campaign))
    # no load, nor what nobody stated, makes a run end off by so much of its length
    return wrong or (notes_for_results(situation.campaign, of_loads=False)[:MOST_SAID] if off else ())


def _single_runs(evidence: Evidence) -> tuple[str, ...]:
    seen, noise = evidence.observations, evidence.noise
    reach = float(reach_of_noise(noise.dof, int(seen.usable.sum())))
    runs = by_run(seen, noise.floor * np.sqrt(noise.weight)[:, None], evidence.held_out.before)
    far = enumerate(pairwise(abs(run.z) for run in runs), 1)
    number = max((k for k, (one, after) in far if one > max(reach, BAD_RUN_RATIO * after)), default=0)
    off = (f"{run.name} ({run.channel.label} {1e3 * run.value:+.3g} m{run.channel.unit})" for run in runs[:number])
    note = f"{sentences.joined(off, 'and')} alone: look at reference, start, counts and steering, or exclude."
    return (note,) * (number > 0)


def _rather_not(causes: Sequence[Cause], certain: Mapping[str, float]) -> bool:
    large = [cause for cause in causes if cause.share > SMALL_SHARE]
    together = prod(certain.get(cause.effect, cause.probability) for cause in large)
    return together < EVEN_PROBABILITY or bool(without_length(cause.effect for cause in large))


def _kind(
    evidence: Evidence,
    gap_probability: float,
    causes: Sequence[Cause],
    unexplained_share: float | None,
    groups: Sequence[Sequence[str]],
    differing: Mapping[str, SizeDifference],
    doubted: bool,
) -> VerdictKind:
    large = {cause.effect for cause in causes if cause.share > SMALL_SHARE}
    improvement = evidence.held_out.improvement
    if improvement is not None and improvement.improvement_ci95[1] < 0.0:
        causes = []
    off = misfit_of(evidence)
    if not evidence.noise.supported and off < BLUNDER_MISFIT:
        if is_shown(causes, evidence.held_out.improvement):
            return VerdictKind.PARTLY_EXPLAINED
        if noise_bounded(evidence) and gap_probability >= 1.0 - FALSE_ALARM:
            return VerdictKind.UNKNOWN
    kind = kind_of(
        gap_probability,
        causes,
        evidence.held_out.closure,
        incomplete=any(map(fails, evidence.trials))
        or not large.isdisjoint(differing)
        or doubted
        or any(True for cause in causes for _ in beyond_vehicles(cause)),
        unexplained_share=unexplained_share,
        tied=any(len(group) > 1 and large.intersection(group) for group in groups),
        supported=evidence.noise.supported,
        misfit=off,
    )
    unconfirmed = improvement is not None and improvement.improvement_ci95[0] <= 0.0
    return VerdictKind.PARTLY_EXPLAINED if unconfirmed and kind is VerdictKind.EXPLAINED else kind


def _small(
    evidence: Evidence, causes: Sequence[Cause], probable: set[str], certain: Mapping[str, float]
) -> tuple[str, ...]:
    own = {name: certain[name] for name in evidence.named if evidence.effects[name].family is Family.SIMULATOR}
    small = naming.negligible(causes, confounding.with_alternatives(evidence, _families(evidence)) | own)
    others = [cause for cause in causes if cause.effect in probable.difference(small)]
    return small + _form_errors(evidence, others)


def _form_errors(evidence: Evidence, causes: Sequence[Cause]) -> tuple[str, ...]:
    """Return the causes whose part a second form of a larger one explains: a play between two on offer leaves some.

    Not of its family, nor what acts the other way.
    """
    if len(causes) < 2:
        return ()
    errors: list[str] = []
    fitted, window = evidence.fitted, 2.0 * LOG_EVIDENCE_WINDOW
    fitted_labels = {(form.effect, form.label) for form in fitted.forms}
    least = confounding.refitted(evidence, fitted.forms, ())[0] + window
    families = {name: effect.family for name, effect in evidence.effects.items()}
    for cause in causes:
        larger = [other for other in causes if other.share > cause.share and other.signal > cause.signal]
        offered = [(form, other) for other in larger for form in evidence.search.forms.get(other.effect, ())]
        second = [
            form
            for form, other in offered
            if (form.effect, form.label) not in fitted_labels
            and (
                cause.share <= SMALL_SHARE * other.share
                or not (families[other.effect] == families[cause.effect] or _acts_opposite(evidence, form))
            )
        ]
        kept = [form for form in fitted.forms if form.effect != cause.effect]
        fixed = [NAMES.index(cause.effect)] if confounding.is_recalibrated(evidence, cause.effect) else []
        if any(
            confounding.refitted(evidence, [*kept, form], fixed)[0] + 2.0 * np.log(form.tries) < least
            for form in second
        ):
            errors.append(cause.effect)
    return tuple(errors)


def _acts_opposite(evidence: Evidence, form: Form) -> bool:
    fitted, system = evidence.fitted, evidence.system
    for own, theta, _ in fitted.each():
        if own.effect == form.effect and len(own.parameters) == len(form.parameters):
            acting = [(system.columns(each) @ (theta / own.typical))[:, None] for each in (own, form)]
            return float(Nuisance(system.calibration).scalar(*acting)[0, 0]) < 0.0
    return False


def _on_causes(evidence: Evidence, causes: Sequence[Cause], small: Sequence[str]) -> Iterator[str]:
    for effect in (evidence.effects[cause.effect] for cause in causes if cause.effect in evidence.effects):
        if assumption := effect.assumption(evidence.observations):
            yield f"{effect.id}: {assumption}"
        if effect.id.startswith("floor_") and evidence.situation.campaign.reference.frame is None:
            yield f"{effect.id}: runs labelled out and back are taken to lie on one floor; {FRAME}"
    if small and causes:
        what = f"too small beside the largest cause to be named: {', '.join(small)}"
        yield f"{what}; correct that first, then diagnose again"


def _on_scatter(evidence: Evidence) -> str:
    weighting = evidence.search.weighting
    size = sum(kind.relative for kind in weighting.system.kinds if kind.name == weighting.name) * weighting.scale
    if not size:
        return ""
    return (
        f" The wheels' radii scatter by about {100 * size:.1g} % from recording to recording: no correction takes that "
        "away, and all intervals hold it."
    )


def _on_omitted(omitted: Mapping[str, float]) -> str:
    if not omitted:
        return ""
    runs = sentences.joined((f"{run} ({100 * share:.0f} % of its length)" for run, share in omitted.items()), "and")
    return (
        f" Omitted, since no other ends off nearly as far: {runs}. Look for a counter that was reset or stood "
        "still, or a reference that is late, mistyped or another run's, with 'calib check'."
    )


def _beside_blunder(kind: VerdictKind) -> VerdictKind:
    if kind is VerdictKind.NO_GAP:
        return VerdictKind.EXPLAINED
    return VerdictKind.PARTLY_EXPLAINED if kind in NOTHING_NAMED else kind


def _families(evidence: Evidence) -> list[list[str]]:
    family = {name: effect.family for name, effect in evidence.effects.items()}
    return [
        [name, *(other for other in family if family[other] == family[name] and other not in evidence.named)]
        for name in evidence.named
        if family[name] not in OWN_CORRECTIONS
    ]


def _by_family(
    evidence: Evidence, confounded: Sequence[Sequence[str]]
) -> tuple[list[list[str]], dict[str, tuple[str, ...]]]:
    groups: list[list[str]] = []
    forms_open: dict[str, tuple[str, ...]] = {}
    for group in confounded:
        named = [name for name in group if name in evidence.named]
        families = {evidence.effects[name].family for name in named} - OWN_CORRECTIONS
        own = tuple(n for n in group if n not in named and evidence.effects[n].family in families)
        # session steps can follow any drift: their odds tell whether they do
        likely, apart = confounding.as_probable(evidence, [group]), parting([group[0], *own])[1:]
        if any(name in likely or not evidence.effects[name].per_session for name in apart):
            own = tuple(name for name in own if name not in apart)
        groups.append([name for name in group if name not in own])
        forms_open |= dict.fromkeys(named, own)
    return groups, forms_open
