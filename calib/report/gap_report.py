"""A report of the diagnosis alone, for campaigns whose runs allow no radius law."""

from __future__ import annotations

from calib import __version__
from calib.campaign.checks.assumed import stand_ins
from calib.campaign.model import Campaign
from calib.files import to_json
from calib.report.blocks import Items, Notice, Section
from calib.report.content import Attachment, Report, head_of, number_of
from calib.report.gap_findings import GapFindings
from calib.report.numbers import prose
from calib.report.pages.diagnosis import gap_section
from calib.report.stated import logo_of, signatures_of, stated_of
from calib.report.statements.assumed import assumed_text


def diagnosis_report(campaign: Campaign, gap: GapFindings, *, issued: str, why: str) -> Report:
    """Return the report on what a diagnosis found, without a law.

    `campaign`: for example loops alone, from which no effective radius follows; `issued`: date of issue, YYYY-MM-DD;
    `why`: why there is no law, a sentence without its full stop. The verdict is attached as ``diagnosis.json``.
    """
    content = {"inputs": dict(campaign.hashes), "campaign": campaign.name, "version": __version__, "gap": gap.to_dict()}
    number = number_of("CR", to_json(content))
    stated = stated_of(campaign)
    limits = Section(
        "What this report does not cover",
        (
            Items(
                (
                    "No radius, slope or uncertainty of a wheel is stated, and no coefficient file is attached.",
                    "The verdict holds for the vehicle, routes, loads and conditions of these runs.",
                )
            ),
            assumed_text(stand_ins(campaign)),
        ),
    )
    reason = Section("Radius law", (Notice("note", "These runs give no radius law", prose(why.rstrip(".")) + "."),))
    return Report(
        report_id=number,
        title="Gap between measured and simulated motion",
        name=campaign.name,
        issued=issued,
        simulated=campaign.simulated,
        passed=True,
        author=stated.get("laboratory", ""),
        head=head_of(number, issued, stated),
        signatures=signatures_of(stated),
        logo=logo_of(campaign),
        sections=(reason, gap_section(gap), limits),
        attachments=(
            Attachment(
                name="diagnosis.json",
                data=to_json(gap.to_dict()).encode("utf-8"),
                mime="application/json",
                description="The verdict of the diagnosis with everything that it rests on",
            ),
        ),
    )
