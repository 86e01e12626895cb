"""Intervals of a share: Wilson's, and the exact one of Clopper and Pearson."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


def wilson(hits: int, total: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of hits / total; (0, 1) where there is nothing."""
    return _interval(hits, total, "wilson")


def clopper_pearson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the exact interval of hits / total; (0, 1) where there is nothing."""
    return _interval(hits, total, "beta", level)


def _interval(hits: int, total: int, method: str, level: float = 0.95) -> tuple[float, float]:
    from statsmodels.stats.proportion import proportion_confint

    if total == 0:
        return 0.0, 1.0
    low, high = proportion_confint(hits, total, alpha=1 - level, method=method)
    return float(low), float(high)


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
