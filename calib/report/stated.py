"""What the ``[report]`` section of campaign.toml states: laboratory, customer, item, signatures, logo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from calib.campaign.model import Campaign
from calib.errors import BadFileError
from calib.files import inside

#: keys of the campaign's ``[report]`` section, and what a reader is told where one is missing
STATED: Final[Mapping[str, str]] = {
    "laboratory": "name and address of the laboratory",
    "customer": "name and contact of the customer",
    "item": "description of the vehicle",
    "item_id": "serial number of the vehicle",
    "item_condition": "condition of the wheels",
    "place": "where the runs were driven",
    "floor": "floor of the corridor",
    "received": "date of receipt of the vehicle",
    "measured": "dates of the measurement",
    "instruments": "instruments and their calibration certificates",
    "deviations": "deviations from the method",
    "prepared": "who prepared the report",
    "authorised": "who authorises the report",
    "method": "identifier of the method",
    "replaces": "report that this one replaces",
    "logo": "picture of the laboratory, a file of the campaign",
    "remarks": "remarks",
}
#: keys whose absence a reader need not be told
OPTIONAL: Final = frozenset({"remarks", "deviations", "prepared", "method", "replaces", "logo"})
#: kinds of pictures that a page can carry, by the suffix of the file
_PICTURES: Final = (".svg", ".png", ".jpg", ".jpeg")
#: a logo of more bytes is a photograph by mistake
_LARGEST: Final = 2_000_000


@dataclass(frozen=True, slots=True)
class Logo:
    """A laboratory's picture: suffix with its point, and the file's bytes."""

    suffix: str
    data: bytes


def stated_of(campaign: Campaign) -> dict[str, str]:
    """Return what the ``[report]`` section of a campaign states, by the keys of `STATED`."""
    where = "campaign.toml" if campaign.root is None else campaign.root / "campaign.toml"
    return texts_of(campaign.extra.get("report"), where)


def texts_of(section: Any, where: Path | str) -> dict[str, str]:
    """Return the texts of a ``[report]`` section; a list of texts is joined.

    Raises BadFileError where it is no section, a key is unknown, or a value is no text.
    """
    if section is None:
        return {}
    remedy = f"write text under these keys: {', '.join(STATED)}"
    if not isinstance(section, Mapping):
        raise BadFileError(where, column="report", found=type(section).__name__, expected="a section", remedy=remedy)
    stated = {}
    for key, value in section.items():
        texts = value if isinstance(value, (list, tuple)) else [value]
        if key not in STATED or not all(isinstance(text, (str, int, float)) or _is_date(text) for text in texts):
            raise BadFileError(
                where,
                column=f"report.{key}",
                found="an unknown key" if key not in STATED else f"a {type(value).__name__}",
                expected="text",
                remedy=remedy,
            )
        joined = "; ".join(str(text).strip() for text in texts if str(text).strip())
        if joined:
            stated[str(key)] = joined
    return stated


def _is_date(value: Any) -> bool:
    return hasattr(value, "isoformat")


def logo_of(campaign: Campaign) -> Logo | None:
    """Return the logo that a campaign states, None where it states none.

    Raises BadFileError where the file leads out of the campaign, is missing, too large, or of a kind that no page can
    carry.
    """
    name = stated_of(campaign).get("logo")
    if name is None or campaign.root is None:
        return None
    where = campaign.root / "campaign.toml"
    path = inside(campaign.root, name, named_in=where, column="report.logo")
    remedy = "give an SVG, PNG or JPEG of at most 2 MB inside the campaign's folder"
    if path.suffix.lower() not in _PICTURES or not path.is_file() or path.stat().st_size > _LARGEST:
        raise BadFileError(where, column="report.logo", found=repr(name), expected="a small picture", remedy=remedy)
    return Logo(path.suffix.lower(), path.read_bytes())


def signatures_of(stated: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Return the lines to be signed, (role, name); the name is empty where nobody is stated."""
    return (("Prepared by", stated.get("prepared", "")), ("Authorised by", stated.get("authorised", "")))
