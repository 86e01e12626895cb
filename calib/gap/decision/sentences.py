"""The verdict in sentences, whether to apply the fix, and the paper's figures beside it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isinf
from typing import TYPE_CHECKING, Final

from calib.gap.decision.diagnosis import Cause, Diagnosis, VerdictKind
from calib.gap.decision.fix import LARGEST_GROUP, REPEAT
from calib.gap.decision.held_out import RERUN, ChannelClosure
from calib.gap.decision.kind import ON_FLOOR, fails
from calib.gap.effects.library import effect_class, title_of
from calib.gap.effects.radii import HIDES_IN
from calib.gap.inference import (
    CERTAIN_PROBABILITY,
    EVEN_PROBABILITY,
    HALF_CLOSURE,
    NOISE_LEVELS,
    REPORTED_GAP_PROBABILITY,
)
from calib.gap.localise import PlaceResult
from calib.gap.localise.locate import GapLocation
from calib.types import few_digits

if TYPE_CHECKING:
    from calib.odometry.simulation import Improvement as Reduction

#: channels and covariates of a sentence; the tables have all
MOST_CHANNELS: Final = 3
MOST_COVARIATES: Final = 2
#: a quotient below rounds to "1.0 times"
SMALLER: Final = 1.05
#: metres or radians of a gap no longer in thousandths
LARGE_GAP: Final = 1.0


def sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in words, after a noise level far above the stated sigmas.

    The cause leads, or that it cannot be identified, with what it is confounded with; then the channels above the noise
    level, with what they are judged against.
    """
    return f"{diagnosis.noise_level.finding} {_verdict(diagnosis)}".lstrip()


#: where runs end off by more than wheels and floor can
CHECK_UNITS: Final = (
    "Check units (metres, radians, newtons), axes of the reference (x ahead, y to the left, angles counter-clockwise) "
    "and its clock, swapped columns, counts per revolution, and wheels that this drive does not have."
)


def blunder_sentence(diagnosis: Diagnosis, off: float) -> str:
    """Return the verdict where runs end off by more of their length than any effect of a vehicle explains."""
    return (
        f"Against {diagnosis.against}, runs end off by {100 * off:.0f} % of their length on average, with any effect "
        f"of the library: wheels and floor cannot do that. {CHECK_UNITS}"
    )


def _verdict(diagnosis: Diagnosis) -> str:
    kind, lead = diagnosis.kind, _channels(diagnosis)
    if kind is VerdictKind.NO_GAP:
        return f"No gap: measured motion differs from {diagnosis.against} by no more than the noise level."
    if kind is VerdictKind.UNDECIDED:
        return f"These runs cannot show whether there is a gap: {_unsupported(diagnosis)}."
    before = ""
    if diagnosis.is_improbable:
        before = f"The probability of a gap is {diagnosis.gap_probability:.2f} only; if there is one"
    if kind is VerdictKind.UNKNOWN:
        cause = f"{before or 'There is a gap, but'} no effect of the library explains it{_located(diagnosis.where)}."
        open_noise = "" if diagnosis.noise_level.supported else f" {_capital(_unexplained(diagnosis))}."
        advice = " More repeats decide it." if before else " Add columns of suspected quantities to runs.csv."
        return f"{cause}{lead}{_nearest(diagnosis)}{open_noise or advice}"
    if kind is VerdictKind.PARTLY_EXPLAINED:
        causes = f"{_listed(diagnosis.causes)}{_alternatives(diagnosis)}"
        words = f"The gap is partly explained by {causes}; {_unexplained(diagnosis)}.{_implausible(diagnosis)}"
    else:
        doubt = ", of a doubtful size" if _implausible(diagnosis) else ""
        explained = f"The gap is explained by {_listed(diagnosis.causes)}{doubt}"
        words = _ambiguous(diagnosis) if kind is VerdictKind.AMBIGUOUS else explained
        words = f"{words}.{_recalibration(diagnosis)}{_implausible(diagnosis)}"
    return f"{before}: t{words[1:]}{lead}" if before else words + lead


def nothing_to_apply(diagnosis: Diagnosis) -> str:
    """Return why there is no fix where no cause is named, in figures, and which runs would settle it."""
    reason = f"the probability of a gap is {diagnosis.gap_probability or 0.0:.2f}"
    if diagnosis.kind is VerdictKind.NO_GAP:
        reason += f", below the {REPORTED_GAP_PROBABILITY:g} from which one is reported"
        runs = "'undetectable' has the size that would show; other loads, speeds and routes show smaller ones"
    elif diagnosis.noise_level.supported:
        reason = f"no effect of the library is probable enough to be named, and {reason}"
        columns = "add columns of suspected quantities to runs.csv, and repeat the routes with the largest gap"
        runs = REPEAT if diagnosis.is_improbable else columns
    else:
        reason, runs = f"{reason} by a noise level that rests on {diagnosis.noise_level.support}", REPEAT
    sizes = _channels(diagnosis).strip(" .").replace("; ", ", ")
    return f"{reason}; {sizes[:1].lower()}{sizes[1:]}{sizes and '; '}{runs}"


def _unsupported(diagnosis: Diagnosis) -> str:
    return f"their noise level rests on {diagnosis.noise_level.support}. {_capital(REPEAT)}"


def _nearest(diagnosis: Diagnosis) -> str:
    probable = [name for name, p in diagnosis.probabilities.items() if p >= EVEN_PROBABILITY and name != "unknown"]
    names = joined((_named(name, diagnosis) for name in probable), "and")
    low, high = diagnosis.closure.ci95 or (0.0, 1.0)
    left = "not certain to close half of the gap"
    if diagnosis.noise_level.supported and high < HALF_CLOSURE:
        left = "more than half of the gap remains"
    elif diagnosis.noise_level.supported and low >= HALF_CLOSURE:
        left = f"closes {100 * low:.0f} to {100 * high:.0f} % of the gap on held-out runs, but is not certain"
    return f" Closest: {names}; {left}." if probable else ""


def _unexplained(diagnosis: Diagnosis) -> str:
    if not diagnosis.noise_level.supported:
        return f"these runs cannot show how much of what is left is noise: {_unsupported(diagnosis)}"
    if diagnosis.closure.held_out == RERUN and diagnosis.closure.leaves_part:
        return f"run again it leaves up to {diagnosis.closure.largest_residual:.3g} times the noise"
    if diagnosis.unexplained is None:
        if any(map(fails, diagnosis.fix.transfer)):
            return "the correction does not carry over to all held-out runs"
        if (left := diagnosis.closure.largest_residual) > NOISE_LEVELS:
            return f"{left:g} times the noise is left on held-out runs"
        if diagnosis.closure.leaves_part:
            return "part of the gap remains on held-out runs"
        if diagnosis.closure.rests_on_few:
            return "few of the conditions driven show it"
        return "part of it may have another cause"
    placed = next((place for place in diagnosis.unexplained.where if place.startswith(ON_FLOOR)), "")
    return "an unexplained residual remains" + (_located(diagnosis.where.rest) or (placed and f", most {placed}"))


def advice(diagnosis: Diagnosis) -> str:
    """Return whether the fix is recommended, why not, and what it changes unnamed; empty without a cause."""
    return f"{_advised(diagnosis)}{_moves(diagnosis)}" if diagnosis.causes else ""


def _moves(diagnosis: Diagnosis) -> str:
    moved = dict[str, str]()
    for name, size in diagnosis.fix.moves.items():
        value, low, high = (f"{100 * each:+.2g}" for each in (size.value, *size.ci95))
        if low[0] == high[0]:
            moved[name] = f"{HIDES_IN[name]} by {value} % ({low} to {high} %)"
    kinds = ((cause.effect, effect_class(cause.effect)) for cause in diagnosis.causes)
    like = joined((name for name, kind in kinds if not kind.zero_known and moved.keys() & kind.shifts), "or")
    why = f": these runs do not tell that from another zero point of {like}" if like else ""
    return f" The fix changes {joined(moved.values(), 'and')}, too{why}." if moved else ""


def _advised(diagnosis: Diagnosis) -> str:
    holds = "helps" if any(map(fails, diagnosis.fix.transfer)) else "holds"
    if diagnosis.recommended and diagnosis.fix.parameters:
        return f"Recommended: set {joined(diagnosis.fix.parameters, 'and')}; your simulator ran again with it."
    if diagnosis.recommended and diagnosis.fix.corrects is not None:
        part = joined((cause.effect for cause in diagnosis.corrected_causes), "and")
        left = "".join(f" {_capital(text)}." for text in diagnosis.fix.leaves)
        only = "" if _moves(diagnosis) else " alone"
        return f"Recommended: the correction of {part}{only}, which {holds} on held-out runs.{left}"
    if diagnosis.recommended and diagnosis.groups:
        groups = joined((joined(group, "or") for group in diagnosis.groups), "and")
        return f"Recommended: the corrections for {groups} agree; apply the fix in either case."
    if diagnosis.recommended:
        return f"Recommended: the fix {holds} on held-out runs."
    return f"Not recommended: {'. '.join(map(_capital, diagnosis.fix.why))}."


def _capital(text: str) -> str:
    return text if "_" in text.partition(" ")[0] else f"{text[:1].upper()}{text[1:]}"


def _effects(diagnosis: Diagnosis) -> set[str]:
    return {cause.effect for cause in diagnosis.causes}


def _unidentified(diagnosis: Diagnosis) -> int:
    named = _effects(diagnosis)
    sizes = [len(group) for group in diagnosis.groups if named.issubset(group)]
    return max((size for size in sizes if size > LARGEST_GROUP), default=0)


def _listed(causes: Sequence[Cause]) -> str:
    def label(cause: Cause) -> str:
        open_forms = cause.forms_open if cause.probability < CERTAIN_PROBABILITY else ()
        return f"{cause.effect}: {cause.form}" if isinf(cause.signal) else joined([cause.effect, *open_forms], "or")

    return joined((f"{cause.title} ({label(cause)})" for cause in causes), "and")


def joined(parts: Iterable[str], word: str) -> str:
    """Return ``a, b and c``; empty where there are none."""
    *most, last = list(parts) or [""]
    return f"{', '.join(most)} {word} {last}" if most else last


def _named(effect: str, diagnosis: Diagnosis) -> str:
    titles = {cause.effect: cause.title for cause in diagnosis.causes}
    return f"{titles.get(effect) or title_of(effect)} ({effect})"


def _ambiguous(diagnosis: Diagnosis) -> str:
    if most := _unidentified(diagnosis):
        return f"There is a gap, but these runs do not identify its cause: {most} effects explain it equally well"
    confounded = set().union(*diagnosis.groups)
    sure = [cause for cause in diagnosis.causes if cause.effect not in confounded]
    groups = [joined(_choices(group, diagnosis), "or") for group in diagnosis.groups]
    several = bool(sure) or len(groups) > 1
    parts = ([_listed(sure)] if sure else []) + [f"either {group}" if several else group for group in groups]
    which = "which" if len(groups) == 1 else "which of each"
    return f"The gap is explained by {joined(parts, 'and by')}: these runs cannot tell {which}"


def _choices(effects: Sequence[str], diagnosis: Diagnosis) -> list[str]:
    causes = _effects(diagnosis)
    together = joined((_named(effect, diagnosis) for effect in effects if effect in causes), "with")
    return [*filter(None, [together]), *_others(effects, diagnosis)]


def _others(effects: Sequence[str], diagnosis: Diagnosis) -> list[str]:
    causes = _effects(diagnosis)
    others = [_named(effect, diagnosis) for effect in effects if effect not in causes]
    return others if len(effects) <= LARGEST_GROUP else [f"{len(others)} other effects"]


def _alternatives(diagnosis: Diagnosis) -> str:
    if most := _unidentified(diagnosis):
        return f", whose cause these runs do not identify (up to {most} effects explain it equally well)"
    named = _effects(diagnosis)
    pairs = [
        f"{joined((effect for effect in group if effect in named), 'and')} from {others}"
        for group in diagnosis.groups
        if (others := joined(_others(group, diagnosis), "or"))
    ]
    return f"; these runs cannot tell {', nor '.join(pairs)}" if pairs else ""


def _located(where: GapLocation | None) -> str:
    if where is None:
        return ""
    lines, parts = where.significant, []
    if lines:
        names = joined((line.name.replace("_", " ") for line in lines[:MOST_COVARIATES]), "and")
        most = "" if lines[0].channel is None else f", most in {lines[0].channel.label}"
        parts.append(f"it correlates with {names}{most}")
    if where.places:
        parts.append(f"it arises {_place(where.places[0])}")
    return "; " + ", and ".join(parts) if parts else ""


def _place(line: PlaceResult) -> str:
    if line.place is None:
        return {"turns": "in turns", "stops": "at stops"}.get(line.where, "along the route")
    low, high = line.place
    return f"between {low:.1f} and {high:.1f} m ({', '.join(filter(None, (line.coordinate, line.route)))})"


def _channels(diagnosis: Diagnosis) -> str:
    closure, named = diagnosis.closure, bool(diagnosis.causes)

    def moved(line: ChannelClosure) -> float:
        left = line.after_rms**2 if named else 0.0
        return (line.before_rms**2 - left) / line.floor_rms**2 if line.floor_rms > 0.0 else 0.0

    lines = closure.moved or sorted(closure.channels, key=moved)[-1:]
    parts = [_channel(line, both=named) for line in lines[:MOST_CHANNELS]]
    where = "" if not named else ", which ran again with the fix" if closure.held_out == RERUN else ", on held-out runs"
    return f" Against {diagnosis.against}{where}: {'; '.join(parts)}." if parts else ""


def _channel(line: ChannelClosure, *, both: bool) -> str:
    unit = line.channel.unit
    factor, unit = (1.0, unit) if line.before_rms >= LARGE_GAP else (1e3, f"m{unit}")
    before, after, floor = (few_digits(factor * value) for value in (line.before_rms, line.after_rms, line.floor_rms))
    return f"{line.channel.label} {before}{f' -> {after}' if both else ''} {unit} (noise level {floor})"


def _recalibration(diagnosis: Diagnosis) -> str:
    own = [cause.effect for cause in diagnosis.causes if cause.effect in HIDES_IN]
    others = [cause for cause in diagnosis.causes if cause.effect not in HIDES_IN]
    if own and not others and diagnosis.kind is VerdictKind.EXPLAINED and not diagnosis.fix.why:
        return f" A plain recalibration of {joined((HIDES_IN[name] for name in own), 'and')} closes it."
    confounded = set().union(*diagnosis.groups) & HIDES_IN.keys()
    hidden = sorted(confounded - set(own)) if others else []
    names = joined((HIDES_IN[name] for name in hidden), "and")
    return f" These runs cannot tell it from an error of {names}." if hidden else ""


def _implausible(diagnosis: Diagnosis) -> str:
    doubtful = [cause for cause in diagnosis.causes if not cause.plausible and cause.remark]
    return "".join(f" The size of {cause.effect} is doubtful: {cause.remark}." for cause in doubtful)


@dataclass(frozen=True, slots=True)
class PaperHeadline:
    """What the load correction achieves, here and in the paper."""

    effect: str
    sole_candidate: bool  #: whether the runs separate it from others
    paper: "Reduction"
    campaign: "Reduction"  #: root mean squares over held-out runs
    sentence: str


def headline(diagnosis: Diagnosis) -> PaperHeadline | None:
    """Return the paper's headline beside a diagnosis'; None where load is not the cause."""
    effect = next((cause.effect for cause in diagnosis.causes if effect_class(cause.effect).is_load_law), None)
    before, after = diagnosis.closure.before_rms_m, diagnosis.closure.after_rms_m
    if effect is None or before is None or after is None:
        return None
    from calib.odometry.simulation import Improvement, paper_headline

    sole = not any(effect in group for group in diagnosis.groups)
    campaign = Improvement(float(before), float(after), before / after if after > 0.0 else None)
    figures = f"this campaign: {_metres(before)} m to {_metres(after)} m"
    if campaign.ratio is not None:
        figures += f", {campaign.ratio:.3g} times smaller" if campaign.ratio >= SMALLER else ", hardly smaller"
    beside = ", ".join(cause.effect for cause in diagnosis.causes if cause.effect != effect)
    figures += f", with {beside}" if beside else ""
    figures += "" if sole else ", if the load is the cause"
    printed = paper_headline()
    text = (
        f"Correction for the load; the paper: {printed.before_m:g} m to {printed.after_m:g} m as printed, about "
        f"{printed.ratio:.0f} times smaller before rounding; {figures}. The figures are end errors, each on its own "
        "route and loads."
    )
    return PaperHeadline(effect, sole, printed, campaign, text)


def _metres(value: float) -> str:
    return f"{value:.2f}" if value >= 0.995 else f"{value:.2g}"
