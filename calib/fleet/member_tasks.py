"""Tasks that take a whole vehicle: check, geometry, diagnosis; each ends in a record, never in an exception."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from calib.campaign.model import Campaign
from calib.errors import CalibError, RefusedError
from calib.fleet.members import Member
from calib.fleet.part_sums import campaign_of

if TYPE_CHECKING:
    from calib.gap.verdict.result import Cause


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
        "causes": [
            {"effect": cause.effect, "probability": cause.probability}
            | ({"x_m": cause.settings["x_m"], "size_m": cause.settings["size_m"]} if _has_place(cause) else {})
            for cause in verdict.causes
        ],
    }


def _has_place(cause: Cause) -> bool:
    """Return whether a cause lies at a place on the floor."""
    return {"x_m", "size_m"} <= set(cause.settings)


def _geometry(member: Member) -> dict[str, Any]:
    from calib.geometry.estimate import estimate_geometry

    geometry = estimate_geometry(_campaign(member))
    return {
        "passed": geometry.passed,
        "using": geometry.using,
        "estimates": {estimate.name: estimate.to_dict() for estimate in geometry.estimates},
        "undetermined": list(geometry.undetermined),
        "wrong": [fault.code for fault in geometry.faults],
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


def geometry_members(members: Sequence[Member]) -> list[MemberRecord]:
    """Estimate radii, track and sensor of vehicles."""
    return _run(_geometry, members)


def diagnose_members(members: Sequence[Member]) -> list[MemberRecord]:
    """Diagnose vehicles: verdict and causes of each."""
    return _run(_diagnose, members)


#: task -> function of some members; a new task is a function and a line here
MEMBER_TASKS: Final[dict[str, Callable[[Sequence[Member]], list[MemberRecord]]]] = {
    "check": check_members,
    "geometry": geometry_members,
    "diagnose": diagnose_members,
}
