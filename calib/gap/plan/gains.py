"""What further runs tell apart: confounded effects, or else the whole library."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.gap.plan.confounded import Hypothesis
from calib.gap.plan.identifiability import SEPARATION_SD, Signatures
from calib.types import FloatArray, IntArray

#: effects or pairs named for a run: one line
MOST_NAMED: Final = 3
#: twice the separation needed: a margin for other sizes
ENOUGH_SD: Final = 2.0 * SEPARATION_SD
#: separation worth no further run
CAP_SD: Final = 4.0 * SEPARATION_SD
#: smallest gain worth naming, in standard deviations
NOTEWORTHY_SD: Final = 0.05
#: candidates weighed at once
AT_ONCE: Final = 16


class Task:
    """How far effects are apart with some of the runs, by number, beside those driven (-1)."""

    def distances(self, chosen: Sequence[int]) -> FloatArray:
        """Return the distances with some runs, shape (n,)."""
        raise NotImplementedError

    def distances_with(self, chosen: Sequence[int], more: Sequence[int]) -> dict[int, FloatArray]:
        """Return the distances with each further run."""
        return {number: self.distances([*chosen, number]) for number in more}

    def told(self, chosen: Sequence[int]) -> tuple[int, int]:
        """Return how many are told apart, and how many surely."""
        distances = self.distances(chosen)
        return int((distances >= SEPARATION_SD).sum()), int((distances >= ENOUGH_SD).sum())

    def done(self, distances: FloatArray) -> bool:
        """Return whether no further run is worth it."""
        return bool((distances >= ENOUGH_SD).all())

    def score(self, distances: FloatArray) -> tuple[float, float]:
        """Return what is to be large."""
        raise NotImplementedError

    def why(self, before: FloatArray, after: FloatArray, told: FloatArray) -> str:
        """Return what a run is for, in words; `told`: the distances with all runs."""
        raise NotImplementedError

    def gains(self, before: FloatArray, after: FloatArray) -> list[int]:
        """Return what gains most."""
        order = np.argsort(-(np.minimum(after, CAP_SD) - np.minimum(before, CAP_SD)))[:MOST_NAMED]
        return [int(k) for k in order if after[k] > before[k] + NOTEWORTHY_SD]


class Tied(Task):
    """Each named cause and what it is confounded with."""

    def __init__(
        self, hypothesis: Hypothesis, number: IntArray, counts: IntArray, ties: Sequence[Sequence[str]]
    ) -> None:
        self.hypothesis, self.number, self.counts = hypothesis, number, counts
        groups = [([n for n in tie if n in hypothesis.named], tie) for tie in ties]
        self.pairs = [(tuple(own), other) for own, tie in groups if own for other in tie if other not in own]
        self.beyond = np.zeros(len(self.pairs))
        driven = self.distances(())
        # grouped by their odds: what tells them has to come on top
        self.beyond = np.where(driven >= SEPARATION_SD, driven, 0.0) ** 2

    def distances(self, chosen: Sequence[int]) -> FloatArray:
        """Return the distance of each named cause from what it is confounded with."""
        times = np.where(self.number < 0, 1.0, self.counts[self.number] * np.isin(self.number, chosen))
        found = self.hypothesis.distances(np.inf, times)
        apart = [
            min((near[alias] for own, near in found if alias in near and set(own) & {*names}), default=CAP_SD)
            for names, alias in self.pairs
        ]
        return np.sqrt(np.maximum(np.square(apart) - self.beyond, 0.0))

    def score(self, distances: FloatArray) -> tuple[float, float]:
        """Return the least distance, and all together."""
        capped = np.minimum(distances, CAP_SD)
        return round(float(capped.min()), 6), float(capped.sum())

    def why(self, before: FloatArray, after: FloatArray, told: FloatArray) -> str:
        """Return what a run tells apart, or begins to where the next go on."""
        parts = []
        for k in (k for k in self.gains(before, after) if told[k] >= SEPARATION_SD):
            names, alias = self.pairs[k]
            pair = f"{' and '.join(names)} from {alias}"
            if after[k] < SEPARATION_SD:
                parts.append(f"begins to tell {pair} ({after[k]:.1f} of {SEPARATION_SD:g} standard deviations)")
            else:
                parts.append(f"tells {pair}{' more surely' if before[k] >= SEPARATION_SD else ''}")
        return ", ".join(parts)


class Untied(Task):
    """Every effect of the library, where none are confounded."""

    def __init__(self, signatures: Signatures, number: IntArray, counts: IntArray) -> None:
        self.signatures = signatures
        self.grams = {n: signatures.gram(number == n) * (counts[n] if n >= 0 else 1) for n in set(number.tolist())}

    def distances(self, chosen: Sequence[int]) -> FloatArray:
        """Return the distance of each effect from zero and from its nearest neighbour."""
        return self._of(self._gram(chosen))

    def _gram(self, chosen: Sequence[int]) -> FloatArray:
        return np.asarray(sum(self.grams[n] for n in (-1, *chosen) if n in self.grams))

    def _of(self, gram: FloatArray) -> FloatArray:
        signal, distance = self.signatures.distances(gram)
        return np.asarray(np.minimum(signal, distance.min(axis=-1, initial=np.inf)))

    def distances_with(self, chosen: Sequence[int], more: Sequence[int]) -> dict[int, FloatArray]:
        """Return the distances with each further run."""
        gram, after = self._gram(chosen), dict[int, FloatArray]()
        for some in (more[first : first + AT_ONCE] for first in range(0, len(more), AT_ONCE)):
            after |= zip(some, self._of(gram + np.stack([self.grams[n] for n in some])), strict=True)
        return after

    def score(self, distances: FloatArray) -> tuple[float, float]:
        """Return how many are separated, and all distances together."""
        separated = float(np.minimum(distances / SEPARATION_SD, 1.0).sum())
        return separated, float(np.minimum(distances, CAP_SD).sum())

    def why(self, before: FloatArray, after: FloatArray, told: FloatArray) -> str:
        """Return what a run shows."""
        names, gains = self.signatures.names, self.gains(before, after)
        clear = [names[k] for k in gains if after[k] >= SEPARATION_SD]
        shown = f"shows {', '.join(clear or [names[k] for k in gains])}" + ("" if clear else " better")
        return shown if gains and len(told) else ""
