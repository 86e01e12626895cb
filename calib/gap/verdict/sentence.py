"""The verdict in a sentence or two of plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isinf, prod
from typing import Final

from calib.gap.effects.calibration import HIDES_IN
from calib.gap.effects.library import title_of, why_it_stays
from calib.gap.evidence.search import EVEN
from calib.gap.verdict.outcome import ChannelClosure
from calib.gap.verdict.result import ALIKE, SURE, Cause, Verdict, VerdictKind
from calib.gap.where.result import PlaceLine, Where

#: channels that the headline names
MOST_CHANNELS: Final = 3
#: metres or radians from which on nobody wants thousandths
LARGE: Final = 1.0
#: a group of more effects than this tells nothing of the cause
TELLING: Final = 6


def sentence(verdict: Verdict) -> str:
    """Return the verdict in words; a floor far above the stated sigmas is said first.

    Leads with the channels that moved, each against its own floor, and what they were judged against; then says what
    causes the gap or that this cannot be said, which causes cannot be told apart, and whether a plain recalibration
    would do or would hide the cause.
    """
    finding = verdict.noise.finding
    return f"{finding} {_sentence(verdict)}" if finding else _sentence(verdict)


def gross_sentence(verdict: Verdict, off: float) -> str:
    """Return the verdict where runs end off by a share of their length that no effect of a vehicle explains."""
    return (
        f"Against {verdict.against} runs end off by {100 * off:.0f} % of their length on average, whatever effect of "
        "the library is assumed: that is no matter of wheels and floor. Look for units (metres, radians, newtons), "
        "axes of the reference (x ahead, y to the left, angles counter-clockwise), columns that stand for one another, "
        "counts per revolution, and wheels that this drive does not have."
    )


def _sentence(verdict: Verdict) -> str:
    if verdict.kind is VerdictKind.NO_GAP:
        return (
            f"No gap: measured motion and that by {verdict.against} differ by no more than repeats of the same run do."
        )
    if verdict.kind is VerdictKind.UNDECIDED:
        return (
            f"These runs cannot show whether there is a gap: their noise floor rests on {verdict.noise.support}. "
            "Drive one route several times over, alike: repeats decide it."
        )
    doubt = _doubt(verdict.gap_probability)
    if verdict.kind is VerdictKind.UNKNOWN:
        cause = f"There is a gap, but no effect of the library explains it{_depends(verdict.where)}."
        return f"{_channels(verdict)}{doubt}{cause}{_nearest(verdict)}"
    return f"{_channels(verdict)}{doubt}{_explained(verdict)}"


def _doubt(gap: float | None) -> str:
    """Return what is said before a gap that is likelier not to be."""
    return "" if gap is None or gap >= EVEN else f"A gap at all has a probability of {gap:.2f}; if there is one: "


def _explained(verdict: Verdict) -> str:
    """Return what the causes are, or between which these runs cannot tell."""
    titles = {cause.effect: cause.title for cause in verdict.causes}
    if verdict.kind is VerdictKind.PARTLY_EXPLAINED:
        return (
            f"The gap is partly explained by {_listed(verdict.causes)}{_alternatives(verdict, titles)}; "
            f"{_left(verdict)}."
        )
    if verdict.kind is VerdictKind.AMBIGUOUS:
        words = _ambiguous(verdict, titles)
    else:
        words = f"The gap is explained by {_listed(verdict.causes)}"
    return f"{words}.{_hidden(verdict)}{_implausible(verdict)}"


def _nearest(verdict: Verdict) -> str:
    """Return what would be named if it did not leave more of the gap than it explains."""
    likely = [name for name, probability in verdict.probabilities.items() if probability >= EVEN and name != "unknown"]
    if not likely:
        return ""
    return (
        f" What comes nearest, {_joined([_named(name, {}) for name in likely], 'and')}, leaves more than it explains."
    )


def _left(verdict: Verdict) -> str:
    """Return what the named causes leave."""
    if verdict.rest is None:
        return "they do not carry over to all runs left out"
    return f"a rest of unknown cause remains{_depends(verdict.where.rest)}"


def advice(verdict: Verdict) -> str:
    """Return whether the fix is recommended, and if not why; empty without a cause."""
    if not verdict.causes:
        return ""
    if verdict.recommended and verdict.groups:
        tied = _joined([_joined(group.effects, "or") for group in verdict.groups], "and")
        return f"Recommended: whichever it is of {tied}, their corrections are alike; either way, apply this."
    if verdict.recommended:
        return "Recommended: the fix holds on runs it has not seen."
    if verdict.groups and (not _alike(verdict) or any(len(group.effects) > TELLING for group in verdict.groups)):
        return "Not recommended: other causes would explain these runs as well."
    if verdict.kind is VerdictKind.PARTLY_EXPLAINED:
        return "Not recommended: a rest of the gap is left, and its cause may be what the named one imitates."
    doubtful = _doubtful(verdict.causes)
    if doubtful:
        names = _joined([f"{cause.effect} ({cause.probability:.2f})" for cause in doubtful], "and")
        return f"Not recommended: too little speaks for {names}."
    further = _further(verdict)
    if further:
        names = _joined([f"{name} ({probability:.2f})" for name, probability in further], "or")
        return f"Not recommended: beside what is named {names} may be at work."
    concerned = {cause.effect for cause in verdict.causes}.union(*(group.effects for group in verdict.groups))
    reasons = sorted({why_it_stays(effect) for effect in concerned} - {""})
    if reasons:
        return f"Not recommended: {'; '.join(reasons)}."
    return "Not recommended: the fix is not shown to hold on runs that it has not seen."


def _alike(verdict: Verdict) -> bool:
    """Return whether it does not matter which of the causes it is that cannot be told apart."""
    agreement, floor = verdict.fix.agreement_m, verdict.closure.floor_rms_m
    return agreement is not None and agreement <= ALIKE * (floor or 0.0)


def _doubtful(causes: Sequence[Cause]) -> list[Cause]:
    """Return the least likely causes, without which all the others together would be sure."""
    rising = sorted(causes, key=lambda cause: cause.probability)
    # one that has no probability is not doubted for it
    count = next(n for n in range(len(rising) + 1) if not prod(cause.probability for cause in rising[n:]) < SURE)
    return rising[:count]


def _further(verdict: Verdict) -> list[tuple[str, float]]:
    """Return what may be at work beside what is named and what stands in for it, the likeliest first, three at most.

    Empty where it is sure enough that nothing is.
    """
    if not verdict.fix.nothing_else < SURE:
        return []
    held = {cause.effect for cause in verdict.causes}.union(*(group.effects for group in verdict.groups))
    return [(name, p) for name, p in verdict.probabilities.items() if name not in {*held, "unknown"}][:3]


def _listed(causes: Sequence[Cause]) -> str:
    # of a gross fault the label says what to do
    return _joined(
        [f"{cause.title} ({cause.effect}{f': {cause.form}' * isinf(cause.signal)})" for cause in causes], "and"
    )


def _joined(parts: Sequence[str], word: str) -> str:
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {word} {parts[-1]}"


def _named(effect: str, titles: Mapping[str, str]) -> str:
    return f"{titles.get(effect) or title_of(effect)} ({effect})"


def _ambiguous(verdict: Verdict, titles: Mapping[str, str]) -> str:
    """Return ``by A and by B or C, which these runs cannot tell apart``."""
    in_groups = {effect for group in verdict.groups for effect in group.effects}
    sure = [cause for cause in verdict.causes if cause.effect not in in_groups]
    groups = [_joined([_named(effect, titles) for effect in group.effects], "or") for group in verdict.groups]
    parts = ([_listed(sure)] if sure else []) + [
        f"either {group}" if sure or len(groups) > 1 else group for group in groups
    ]
    which = "which" if len(groups) == 1 else "which of each"
    if any(len(group.effects) > TELLING for group in verdict.groups):
        most = max(len(group.effects) for group in verdict.groups)
        return f"There is a gap, but of its cause these runs tell nothing: {most} effects would do as well"
    return f"The gap is explained by {_joined(parts, 'and by')}: these runs cannot tell {which}"


def _alternatives(verdict: Verdict, titles: Mapping[str, str]) -> str:
    named = {cause.effect for cause in verdict.causes}
    others = [
        _joined([_named(effect, titles) for effect in group.effects if effect not in named], "or")
        for group in verdict.groups
    ]
    others = [other for other in others if other]
    many = max((len(group.effects) for group in verdict.groups), default=0)
    if many > TELLING:
        return f", of whose cause these runs tell nothing (up to {many} effects would do as well)"
    return f", which these runs cannot tell from {_joined(others, 'and')}" if others else ""


def _depends(where: Where | None) -> str:
    """Return what a gap depends on and where it lies, as the end of a sentence."""
    if where is None:
        return ""
    lines, parts = where.significant, []
    if lines:
        names = _joined([line.name.replace("_", " ") for line in lines[:2]], "and")
        most = "" if lines[0].channel is None else f", most in {lines[0].channel.label}"
        parts.append(f"it goes with {names}{most}")
    if where.places:
        parts.append(f"it opens {_place(where.places[0])}")
    return "; " + ", and ".join(parts) if parts else ""


def _place(line: PlaceLine) -> str:
    if line.place is None:
        return {"turns": "in the turns", "stops": "at the stops"}.get(line.where, "on the way")
    low, high = line.place
    return f"between {low:.1f} and {high:.1f} m ({line.coordinate}, {line.route})"


def _channels(verdict: Verdict) -> str:
    """Return the gap of the channels that moved, without and with the causes, each against its own floor."""
    closure = verdict.closure
    lines = closure.moved or tuple(sorted(closure.channels, key=_ratio)[-1:])
    if not lines:
        return ""
    named = bool(verdict.causes)
    parts = [_channel(line, both=named) for line in lines[:MOST_CHANNELS]]
    return f"Against {verdict.against}{', on runs left out' if named else ''}: {'; '.join(parts)}. "


def _ratio(line: ChannelClosure) -> float:
    return line.before_rms / line.floor_rms if line.floor_rms > 0.0 else 0.0


def _channel(line: ChannelClosure, *, both: bool) -> str:
    """Return ``distance 6.1 -> 1.9 mm (floor 2.3)``, all in the unit in which the gap reads well."""
    unit = line.channel.unit
    factor, unit = (1.0, unit) if line.before_rms >= LARGE else (1e3, f"m{unit}")
    before, after, floor = (f"{factor * value:.3g}" for value in (line.before_rms, line.after_rms, line.floor_rms))
    return f"{line.channel.label} {before}{f' -> {after}' if both else ''} {unit} (floor {floor})"


def _hidden(verdict: Verdict) -> str:
    """Return that a recalibration alone would do, or that part of the cause hides in the calibration."""
    own = [cause.effect for cause in verdict.causes if cause.effect in HIDES_IN]
    others = [cause for cause in verdict.causes if cause.effect not in HIDES_IN]
    if own and not others and verdict.kind is VerdictKind.EXPLAINED:
        return f" A plain recalibration of {_joined([HIDES_IN[name] for name in own], 'and')} closes it."
    alike = {effect for group in verdict.groups for effect in group.effects} & HIDES_IN.keys()
    hidden = sorted(alike - set(own)) if others else []
    if hidden:
        return f" This hides in {_joined([HIDES_IN[name] for name in hidden], 'and')}."
    return ""


def _implausible(verdict: Verdict) -> str:
    doubtful = [cause for cause in verdict.causes if not cause.plausible and cause.remark]
    return "".join(f" The size of {cause.effect} is doubtful: {cause.remark}." for cause in doubtful)
