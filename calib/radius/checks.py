"""What an expert would check after a fit: a statistic, and a sentence that says what it means and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any, Final

OK: Final = "ok"
NOTE: Final = "note"
FAILED: Final = "failed"
#: name of the check that holds a fit against its nominal vehicle and physical bounds
PLAUSIBLE: Final = "plausible"


@dataclass(frozen=True, slots=True)
class Check:
    """One check of a fit."""

    #: stable name: ``design``, ``lack_of_fit``, ``curvature``, ``equal_scatter``, ``influence``, ``session``,
    #: ``normality``, ``direction``, ``temperature``, ``range``, ``plausible``
    name: str
    #: ``ok``; ``note`` where the reader has to know something but the result stands; ``failed`` where the law should
    #: not be used as it is
    level: str
    #: what it means for the user and what to do
    sentence: str
    #: value of the test statistic; None where the check has none or could not be made
    statistic: float | None = None
    #: what the statistic is, for example ``F(3, 55)``
    statistic_name: str = ""
    #: probability of a statistic at least as extreme where nothing is wrong
    p_value: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the result can be used as it is (``ok`` and ``note``)."""
        return self.level != FAILED

    def to_dict(self) -> dict[str, Any]:
        """Return the check as plain values."""
        return {
            "name": self.name,
            "level": self.level,
            "passed": self.passed,
            "statistic": _finite(self.statistic),
            "statistic_name": self.statistic_name,
            "p_value": _finite(self.p_value),
            "sentence": self.sentence,
        }


def _finite(value: float | None) -> float | None:
    """Return `value` as JSON can hold it: an infinite statistic, of data without any scatter, is not a number there."""
    return float(value) if value is not None and isfinite(value) else None
