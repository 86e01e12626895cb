"""What the parts of the plausibility of a campaign share."""

from __future__ import annotations

from typing import Final

from calib.campaign.model import Campaign, Note

CODE: Final = "implausible"
SIDES: Final = ("left", "right")
#: runs that must agree before a column as a whole is spoken of
LEAST_RUNS: Final = 4


def note(where: str, text: str) -> Note:
    """Return a finding: where it stands, and what was found, expected and is likely."""
    return Note("wrong", where, text, CODE)


def stated(campaign: Campaign, key: str) -> bool:
    """Return whether a setting was given, rather than assumed by a program."""
    return key not in campaign.assumed and key.partition(".")[0] not in campaign.assumed
