"""Tasks that take a whole vehicle: check, geometry, diagnosis; each ends in a record, never in an exception."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from calib.campaign.model import Campaign
from calib.errors import CalibError, RefusedError
from calib.fleet.members import Member
from calib.fleet.part_sums import campaign_of

__all__ = ["MEMBER_TASKS", "MemberRecord", "key_of"]


@dataclass(frozen=True, slots=True)
class MemberRecord:
    """What a task came to for one vehicle.

    Parameters
    ----------
    name : str
        Its id.
    key : str
        By which its files are known again.
    values : mapping
        Plain JSON values of the result.
    why : str
        One line; empty where the task could be done.
    """

    name: str
    key: str
    values: Mapping[str, Any] = field(default_factory=dict)
    why: str = ""

    @property
    def status(self) -> str:
        """``done`` or ``failed``."""
        return "failed" if self.why else "done"

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {"name": self.name, "key": self.key, "values": dict(self.values), "why": self.why}

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> MemberRecord:
        """Return what `to_dict` wrote."""
        return MemberRecord(str(value["name"]), str(value["key"]), dict(value["values"]), str(value["why"]))


def key_of(member: Member) -> str:
    """Return the keys of a vehicle's files, by which they are known again."""
    return "|".join(f"{part.name}:{part.key}" for part in member.parts)


def _campaign(member: Member) -> Campaign:
    if len(member.parts) != 1:
        raise RefusedError(
            f"{member.vehicle}: found {len(member.parts)} files of journeys; expected one for this task; "
            "put a vehicle's journeys into one campaign folder"
        )
    return campaign_of(member.parts[0])


def _check(member: Member) -> dict[str, Any]:
    from calib.campaign.check import check_campaign
    from calib.campaign.read import read_campaign

    part = member.parts[0] if len(member.parts) == 1 else None
    own_folder = part is not None and part.path.parent == part.settings
    campaign = read_campaign(part.settings, lenient=True) if part is not None and own_folder else _campaign(member)
    report = check_campaign(campaign)
    return {
        "sound": report.sound,
        "wrong": [note.code for note in report.wrong],
        "suspicious": [note.code for note in report.suspicious],
    }


def _diagnose(member: Member) -> dict[str, Any]:
    from calib.gap.diagnose import diagnose_in_full

    verdict = diagnose_in_full(_campaign(member), plan=False).verdict
    return {
        "verdict": str(verdict.kind),
        "sentence": verdict.sentence,
        "causes": [{"effect": cause.effect, "probability": cause.probability} for cause in verdict.causes],
    }


def _run(task: Callable[[Member], dict[str, Any]], members: Sequence[Member]) -> list[MemberRecord]:
    records = []
    for member in members:
        key = ""
        try:
            key = key_of(member)
            records.append(MemberRecord(member.vehicle, key, task(member)))
        except (CalibError, OSError) as error:
            records.append(MemberRecord(member.vehicle, key, why=" ".join(str(error).split())))
    return records


def check_members(members: Sequence[Member]) -> list[MemberRecord]:
    """Check vehicles: what is wrong and what is suspicious in each."""
    return _run(_check, members)


def diagnose_members(members: Sequence[Member]) -> list[MemberRecord]:
    """Diagnose vehicles: verdict and causes of each."""
    return _run(_diagnose, members)


#: task -> function of some members; a new task is a function and a line here
MEMBER_TASKS: Final[dict[str, Callable[[Sequence[Member]], list[MemberRecord]]]] = {
    "check": check_members,
    "diagnose": diagnose_members,
}
