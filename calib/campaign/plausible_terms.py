"""What the parts of the plausibility of a campaign share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from calib.campaign.model import Campaign, Note

CODE: Final = "implausible"
SIDES: Final = ("left", "right")
#: runs that must agree before a column as a whole is spoken of
LEAST_RUNS: Final = 4


def note(where: str, text: str) -> Note:
    """Return a finding: where it stands, and what was found, expected and is likely."""
    return Note("wrong", where, text, CODE)


def meaning(ratio: float, factors: Sequence[tuple[float, str]], tolerance: float) -> str:
    """Return what lies behind the factor that a ratio is within a relative `tolerance` of; empty where none does."""
    return next((text for factor, text in factors if abs(ratio / factor - 1) < tolerance), "")


def stated(campaign: Campaign, key: str) -> bool:
    """Return whether a setting was given, rather than assumed by a program."""
    return key not in campaign.assumed and key.partition(".")[0] not in campaign.assumed
