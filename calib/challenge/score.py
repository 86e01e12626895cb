"""The score of a set: truth opened, its hash checked, every verdict judged."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.challenge import TRUTH_FORMAT, read_public, truth_path
from calib.challenge.cases import Truth
from calib.challenge.judge import Judged, judge
from calib.documents import plain_fields
from calib.errors import BadFileError
from calib.io import sha256_file
from calib.types import grouped


def _interval95(hits: int, total: int, method: str) -> tuple[float, float]:
    from statsmodels.stats.proportion import proportion_confint

    if total == 0:
        return 0.0, 1.0
    low, high = proportion_confint(hits, total, alpha=0.05, method=method)
    return float(low), float(high)


#: Wilson's score interval of hits / total, and the exact one; (0, 1) where there is nothing
wilson: Final = partial(_interval95, method="wilson")
clopper_pearson: Final = partial(_interval95, method="beta")


@dataclass(frozen=True, slots=True)
class Share:
    """A share of cases with its intervals."""

    hits: int
    total: int

    @property
    def rate(self) -> float | None:
        """Hits over total; None where there is nothing."""
        return self.hits / self.total if self.total else None

    @property
    def wilson95(self) -> tuple[float, float]:
        """Its interval by `wilson`."""
        return wilson(self.hits, self.total)

    @property
    def exact95(self) -> tuple[float, float]:
        """Its interval by `clopper_pearson`."""
        return clopper_pearson(self.hits, self.total)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, rate=self.rate, wilson95=self.wilson95, clopper_pearson95=self.exact95)


def share(values: list[bool]) -> Share:
    """Return the share of True."""
    return Share(sum(values), len(values))


_BINS: Final = 10
_EDGES: Final = [number / _BINS for number in range(_BINS + 1)]


@dataclass(frozen=True, slots=True)
class Bin:
    """Probabilities within a tenth: their mean, and the share that is true."""

    low: float
    high: float
    stated: float
    true: Share


#: line of the board -> (what it must reach, whether at least or at most)
TARGETS: Final[dict[str, tuple[float, str]]] = {
    "first at signal >= 10": (0.95, "at least"),
    "decided, where no other effect is nearer than 3 sigma": (0.80, "at least"),
    "first or its group at signal >= 10": (0.99, "at least"),
    "first at signal 5": (0.60, "at least"),
    "95 % set holds it at signal 5": (0.95, "at least"),
    "false alarms": (0.05, "at most"),
    "outside effects left open": (0.90, "at least"),
    "false unknowns at signal 25": (0.05, "at most"),
    "both of a pair": (0.90, "at least"),
    "crowded: effects at signal >= 20 named": (0.90, "at least"),
    "exact aliases named": (1.0, "at least"),
    "wrong fixes": (0.01, "at most"),
}


@dataclass(frozen=True, slots=True)
class Score:
    """The score."""

    purpose: str
    truth_sha256: str
    board: Mapping[str, Share]
    by_signal: Mapping[str, Mapping[str, Share]]  #: target signal -> ``first``, ``in_group``, ``covered``, ``detected``
    #: target signal -> ``free`` and ``gated`` ceiling, ``hits_over_gated``, the same with ``own`` of the true effect
    ceilings: Mapping[str, Mapping[str, float | None]]
    reliability: tuple[Bin, ...]  #: stated probability against how often it was true
    confusion: Mapping[str, Mapping[str, int]]  #: truth -> what was named first (or the verdict) -> cases
    summary: Mapping[str, Any]
    cases: tuple[Judged, ...]

    @property
    def misses(self) -> tuple[Judged, ...]:
        """The cases not answered right."""
        return tuple(case for case in self.cases if not case.right)

    @staticmethod
    def target(line: str) -> tuple[float, str] | None:
        """Return the line's target of `TARGETS`; None for most."""
        return TARGETS.get(line)

    def meets(self, line: str) -> bool | None:
        """Return whether a line of the board reaches its target; None where it has none or no case."""
        target, rate = self.target(line), self.board[line].rate
        if target is None or rate is None:
            return None
        wanted, sense = target
        return rate >= wanted if sense == "at least" else rate <= wanted

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        targets = {name: {"value": value, "sense": sense} for name, (value, sense) in TARGETS.items()}
        board = {
            name: {**line.to_dict(), "target": targets.get(name), "met": self.meets(name)}
            for name, line in self.board.items()
        }
        return {"format": "calib-challenge-score/1"} | plain_fields(self, board=board, misses=self.misses)


def open_truth(folder: Path, truth_file: Path | None = None) -> tuple[dict[str, Truth], str]:
    """Open the sealed truth of a set."""
    public = read_public(folder)
    path = truth_file or truth_path(folder)
    if not path.is_file():
        raise BadFileError(path, "no such file", "the sealed truth", "give truth_file, or make the set anew")
    digest = sha256_file(path)
    if digest != public["truth_sha256"]:
        remedy = "the truth was changed after sealing: make the set anew and run it again"
        raise BadFileError(path, f"SHA-256 {digest}", f"{public['truth_sha256']}, as sealed", remedy)
    data = json.loads(path.read_text(encoding="utf-8"))
    if data.get("format") != TRUTH_FORMAT:
        raise BadFileError(path, found=repr(data.get("format")), expected=TRUTH_FORMAT, remedy="make the set anew")
    return {case: Truth.from_dict(entry) for case, entry in data["cases"].items()}, digest


def score(folder: Path, *, truth_file: Path | None = None) -> Score:
    """Score the verdicts of a set."""
    truths, digest = open_truth(folder, truth_file)
    judged = []
    for case in read_public(folder)["cases"]:
        path = folder / "verdicts" / f"{case}.json"
        verdict = None
        if path.is_file():
            try:
                verdict = json.loads(path.read_text(encoding="utf-8"))
            except ValueError as error:
                raise BadFileError(path, str(error), "a verdict as JSON", "delete it and run again") from error
        judged.append(judge(truths[case], verdict))
    return score_of(judged, purpose=str(read_public(folder).get("purpose", "")), truth_sha256=digest)


def score_of(cases: list[Judged], *, purpose: str = "", truth_sha256: str = "") -> Score:
    """Return the score of judged cases."""
    singles = _of(cases, "single")
    strong = [case for case in singles if case.signal is not None and case.signal >= 10]
    apart = [case for case in strong if case.separable]
    five = [case for case in singles if case.signal == 5]
    top = [case for case in singles if case.signal == 25 and case.separable is not False]
    board = {
        "first at signal >= 10": share([case.first for case in strong]),
        "first at signal >= 10, where no other effect is nearer than 3 sigma": share([case.first for case in apart]),
        "decided, where no other effect is nearer than 3 sigma": share([case.decided for case in apart]),
        "first or its group at signal >= 10": share([case.first or case.in_group for case in strong]),
        "first at signal 5": share([case.first for case in five]),
        "95 % set holds it at signal 5": share([bool(case.covered) for case in five]),
        "95 % set holds it, all single": share([bool(case.covered) for case in singles]),
        "false alarms": share([not case.right for case in _of(cases, "empty")]),
        "calibration named first": share([case.first for case in _of(cases, "calibration")]),
        "natural size named first": share([case.first for case in _of(cases, "natural")]),
        "outside effects left open": share([case.right for case in _of(cases, "outside")]),
        "deleted effects left open or aliased": share([case.right for case in _of(cases, "deleted")]),
        "false unknowns at signal 25": share([case.verdict == "unknown" for case in top]),
        "both of a pair": share([case.right for case in _of(cases, "pair")]),
        "both of a pair, or its group": share([case.in_group for case in _of(cases, "pair")]),
        "crowded: effects at signal >= 20 named": share([hit for case in cases for hit in case.strong]),
        "crowded: named causes that are true": share([true for c in _of(cases, "crowded") for _, true in c.statements]),
        "exact aliases named": share([case.right for case in _of(cases, "alias")]),
        "wrong fixes": share([case.wrong_fix for case in cases]),
        "fixes that made the fresh campaign worse": share([case.harmful for case in cases if case.harmful is not None]),
        "ended in an error or missing": share([case.verdict in ("error", "missing") for case in cases]),
    }
    by_signal: dict[str, dict[str, Share]] = {}
    for signal in sorted({case.signal for case in singles if case.signal is not None}):
        of_signal = [case for case in singles if case.signal == signal]
        by_signal[f"{signal:g}"] = {
            "detected": share([case.verdict not in ("no_gap", "error", "missing") for case in of_signal]),
            "first": share([case.first for case in of_signal]),
            "in_group": share([case.first or case.in_group for case in of_signal]),
            "covered": share([bool(case.covered) for case in of_signal]),
        }
    return Score(
        purpose=purpose,
        truth_sha256=truth_sha256,
        cases=tuple(cases),
        board=board,
        by_signal=by_signal,
        ceilings={signal: _ceilings(singles, float(signal)) for signal in by_signal},
        reliability=_reliability([statement for case in cases for statement in case.statements]),
        confusion=_confusion(cases),
        summary=_summary(cases),
    )


def _ceilings(singles: list[Judged], signal: float) -> dict[str, float | None]:
    ceilings: dict[str, float | None] = {}
    for own in ("", "own_"):
        of_cases = [(getattr(case, f"{own}ceiling"), case.first) for case in singles if case.signal == signal]
        known = [(*ceiling, first) for ceiling, first in of_cases if ceiling is not None]
        free, gated, first = np.mean(known, axis=0).tolist() if known else (None, None, None)
        ceilings |= {f"{own}free": free, f"{own}gated": gated}
        ceilings[f"hits_over_{own}gated"] = first / gated if gated else None
    return ceilings


def _of(cases: list[Judged], group: str) -> list[Judged]:
    return [case for case in cases if case.group == group]


def _reliability(statements: list[tuple[float, bool]]) -> tuple[Bin, ...]:
    numbers = np.minimum(np.searchsorted(_EDGES, [p for p, _ in statements], side="right") - 1, _BINS - 1)
    bins: dict[int, list[tuple[float, bool]]] = grouped(zip(numbers.tolist(), statements, strict=True))
    return tuple(
        Bin(_EDGES[k], _EDGES[k + 1], float(np.mean([p for p, _ in inside])), share([hit for _, hit in inside]))
        for k, inside in sorted(bins.items())
    )


def _confusion(cases: list[Judged]) -> dict[str, dict[str, int]]:
    of_one = [case for case in cases if case.group not in ("pair", "crowded")]
    truths = [f"{'deleted: ' if case.deleted else ''}{case.truth[0] if case.truth else 'nothing'}" for case in of_one]
    rows = grouped(zip(truths, ((*case.named, case.verdict)[0] for case in of_one), strict=True))
    return {truth: dict(Counter(rows[truth]).most_common()) for truth in sorted(rows)}


def _summary(cases: list[Judged]) -> dict[str, object]:
    def median(values: list[float]) -> float | None:
        return float(np.median(values)) if values else None

    intervals = [interval for case in cases for interval in case.intervals]
    hits = grouped((name, low <= truth <= high) for name, truth, low, high in intervals)
    both = [(one.predicted, one.achieved) for one in cases if one.predicted is not None and one.achieved is not None]
    explained = [case.predicted for case in cases if case.verdict == "explained" and case.predicted is not None]
    crowded = [statement for case in _of(cases, "crowded") for statement in case.statements]
    return {
        "cases": len(cases),
        "crowded_stated_minus_true": float(np.mean([p - hit for p, hit in crowded])) if crowded else None,
        "median_set_size": median([float(case.set_size) for case in cases if case.set_size]),
        "interval_coverage": share([low <= truth <= high for _, truth, low, high in intervals]).to_dict(),
        "interval_coverage_by_parameter": {name: share(covered).to_dict() for name, covered in sorted(hits.items())},
        "closure_predicted_minus_achieved_median": median([abs(p - a) for p, a in both]),
        "closure_compared": len(both),
        "closure_of_explained_median": median(explained),
        "closure_of_explained_0.9": share([value >= 0.9 for value in explained]).to_dict(),
        "seconds_median": median([case.seconds for case in cases if case.seconds is not None]),
    }
