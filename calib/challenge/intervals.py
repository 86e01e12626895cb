"""Intervals of a share: Wilson's, and the exact one of Clopper and Pearson."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["Share", "clopper_pearson", "share", "wilson"]


def wilson(hits: int, total: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Return Wilson's score interval of hits / total; (0, 1) where there is nothing."""
    if total == 0:
        return 0.0, 1.0
    rate = hits / total
    middle = (rate + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * float(np.sqrt(rate * (1 - rate) / total + z * z / (4 * total * total)))
    return max(0.0, middle - half), min(1.0, middle + half)


def clopper_pearson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the exact interval of hits / total; (0, 1) where there is nothing."""
    from scipy.special import betaincinv

    if total == 0:
        return 0.0, 1.0
    tail = 0.5 * (1 - level)
    low = 0.0 if hits == 0 else float(betaincinv(hits, total - hits + 1, tail))
    high = 1.0 if hits == total else float(betaincinv(hits + 1, total - hits, 1 - tail))
    return low, high


@dataclass(frozen=True, slots=True)
class Share:
    """A share of cases with its intervals."""

    hits: int
    total: int

    @property
    def rate(self) -> float | None:
        """Hits over total; None where there is nothing."""
        return self.hits / self.total if self.total else None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            "hits": self.hits,
            "total": self.total,
            "rate": self.rate,
            "wilson95": list(wilson(self.hits, self.total)),
            "clopper_pearson95": list(clopper_pearson(self.hits, self.total)),
        }


def share(values: list[bool]) -> Share:
    """Return the share of True."""
    return Share(sum(values), len(values))
