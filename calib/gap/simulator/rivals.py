"""Which sets of a simulator's parameters leave no more than noise when it is run with them, and which do so alike."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice
from math import exp, log, sqrt
from typing import Final

import numpy as np

from calib.gap.decision.confounding import LOG_EVIDENCE_WINDOW
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.decision.trials import most_square
from calib.gap.effects.simulator import in_end_frame
from calib.gap.inference.fit import whitened_rows
from calib.gap.simulator.fix import SimulatorFix, named_parameters, run_alone, scaled_signatures, square_left
from calib.gap.simulator.runner import Differences, difference
from calib.gap.simulator.settings import Declared

#: of a set's squares and Schwarz's penalty over the best one's, beyond which it is ten times less probable
WINDOW: Final = 2.0 * LOG_EVIDENCE_WINDOW
#: what a parameter not run may bend: as those run did, and of the gap, by a step of another size or side
BENT_SHARE: Final = 0.05
#: squares over noise's that a run's signatures may promise before it is given up: twice the noise level
PROMISED: Final = 4.0
#: parameters tried together, and sets of them weighed: all of thirty parameters
MOST_ALONE: Final = 3
MOST_SETS: Final = 5000
#: share by which a size moves where another parameter beside it takes a part
MOVED: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Causes that explain the gap by themselves: parameters that were run, or the first verdict's."""

    names: frozenset[str]
    score: float  #: squares left, and log n a parameter (Schwarz, Annals of Statistics 6, 1978)
    named: Mapping[str, Declared]
    fix: SimulatorFix | None  #: None of a verdict with effects of the library


def rivals_of(diagnosis: Diagnosis, differences: Differences, found: SimulatorFix | None) -> list[Rival]:
    """Return what explains the gap to the noise, the most probable first; empty where no parameters alone do.

    Run are the named parameters, those most able, and variants of the best set. `found`: the fix by those named.
    """
    n_rows, named = int(diagnosis.nominal.s.usable.sum()), named_parameters(diagnosis, differences)
    limit, verdict = most_square(n_rows, diagnosis.noise.dof), frozenset(cause.effect for cause in diagnosis.causes)

    def rival(some: Mapping[str, Declared], fix: SimulatorFix) -> Rival:
        return Rival(frozenset(some), fix.square + len(some) * log(n_rows), some, fix)

    pure = found is not None and len(named) == len(verdict)
    run = [rival(named, found)] if found is not None and pure and found.square <= limit else []
    # of a simulator that scatters more than noise may be its own
    if not run and (not pure or differences.repeats == 1):
        able = [some for some in _most_able(diagnosis, differences) if some.keys() != named.keys()]
        sets = [*able, named] if named and not pure else able
        fixes = [(some, run_alone(diagnosis, differences, some)) for some in sets]
        run = sorted((rival(some, fix) for some, fix in fixes if fix.square <= limit), key=_score)[:1]
    for some in _neighbours(diagnosis, differences, run[0], limit) if run else ():
        fix = run_alone(diagnosis, differences, some, limit=PROMISED * limit)
        if fix.square > limit:
            continue
        run.append(rival(some, fix))
        if added := some.keys() - run[0].named.keys():
            whole = {**run[0].named, **{name: some[name] for name in added}}
            run.append(rival(whole, run_alone(diagnosis, differences, whole, limit=PROMISED * limit)))
    if run and len(named) < len(verdict):
        n_sizes = sum(len(size) for _, size, _ in diagnosis.fitted.each())
        run.append(Rival(verdict, diagnosis.fitted.chi_square + n_sizes * log(n_rows), named, None))
    run.sort(key=_score)
    kept: list[Rival] = []
    for each in run:
        if each.score <= run[0].score + WINDOW and not any(better.names <= each.names for better in kept):
            kept.append(each)
    return kept


def _score(each: Rival) -> float:
    return each.score


def _neighbours(
    diagnosis: Diagnosis, differences: Differences, best: Rival, limit: float
) -> Iterator[dict[str, Declared]]:
    # what signatures about nominal leave too much of, though it bent as far as may be, is no rival
    assert best.fix is not None
    forms, sign, columns, gap = scaled_signatures(diagnosis)
    names = [form.effect for form in forms]
    inside = [names.index(name) for name in best.named]
    bent = max(_bend(diagnosis, differences, best.fix), BENT_SHARE * float(np.linalg.norm(gap)))
    most = (sqrt(limit) + bent) ** 2
    for number in inside:
        others = [each for each in inside if each != number]
        for instead in ([], *([each] for each in range(len(names)) if each not in inside)):
            some = [*others, *instead]
            if some and square_left(columns[:, some], gap, sign[some]) <= most:
                yield {names[each]: differences.by_cause[names[each]] for each in some}


def _most_able(diagnosis: Diagnosis, differences: Differences) -> Iterator[dict[str, Declared]]:
    # radii off alike show in the two together alone: of each number the best set, not the best after the best
    forms, sign, columns, gap = scaled_signatures(diagnosis)
    for size in range(1, min(MOST_ALONE, len(forms)) + 1):
        sets = islice(combinations(range(len(forms)), size), MOST_SETS)
        square, best = min((square_left(columns[:, [*some]], gap, sign[[*some]]), some) for some in sets)
        if square < np.inf:
            yield {forms[number].effect: differences.by_cause[forms[number].effect] for number in best}


def _bend(diagnosis: Diagnosis, differences: Differences, fix: SimulatorFix) -> float:
    # whitened, of a fix's run off its parameters' changes about nominal
    change = difference(fix.table, differences.nominal)
    straight = sum((differences.change[name] * size for name, size in fix.deviation.items()), np.zeros_like(change))
    nominal = diagnosis.nominal
    missed = in_end_frame(nominal, (change - straight)[differences.rows(nominal.s)])
    return float(np.linalg.norm(whitened_rows(nominal, diagnosis.noise, missed[:, :, None])))


def as_rivals(diagnosis: Diagnosis, rivals: Sequence[Rival]) -> Diagnosis:
    """Return the diagnosis of the first rival's causes with the odds of all, and what they are confounded with."""
    best = next(each for each in rivals if each.fix is not None)
    weights = [exp(0.5 * (rivals[0].score - each.score)) for each in rivals]
    groups = {group[0]: tuple(group) for group in diagnosis.groups}
    for other in rivals:
        # what stands in the place of a cause, or takes a part of it; one omitted alone is less probable
        for name in sorted(name for name in best.names if name not in other.names or _moves(name, best, other)):
            if instead := sorted(other.names - best.names):
                groups[name] = tuple(dict.fromkeys((*groups.get(name, (name,)), *instead)))
    shares = {
        name: sum(weight for each, weight in zip(rivals, weights, strict=True) if name in each.names) / sum(weights)
        for name in best.names
    }
    causes = tuple(replace(c, probability=c.probability * shares.get(c.effect, 1.0)) for c in diagnosis.causes)
    tied = len(groups) > len(diagnosis.groups) and diagnosis.kind is VerdictKind.EXPLAINED
    return replace(
        diagnosis,
        causes=causes,
        groups=tuple(groups.values()),
        kind=VerdictKind.AMBIGUOUS if tied else diagnosis.kind,
        credible_sets=tuple(dict.fromkeys((*(tuple(sorted(each.names)) for each in rivals), *diagnosis.credible_sets))),
        probabilities={**diagnosis.probabilities, **{cause.effect: cause.probability for cause in causes}},
    )


def _moves(name: str, best: Rival, other: Rival) -> bool:
    if best.fix is None or other.fix is None:
        return False
    parameter = best.named[name].name
    size = best.fix.deviation[parameter]
    return abs(other.fix.deviation[parameter] - size) > MOVED * abs(size)
