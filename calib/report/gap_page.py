"""A diagnosis as one page that opens from disk: what it says as plain markup, and linked panels to look into it."""

from __future__ import annotations

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.data.channels import Channel
from calib.gap.diagnosis import Diagnosis
from calib.gap.verdict.result import Verdict
from calib.gap.where.traces import traces_of
from calib.report.blocks import Picture, Section
from calib.report.gap_findings import GapFindings
from calib.report.gap_source import findings_of
from calib.report.html import Page, page_html
from calib.report.interactive import interactive_panels
from calib.report.panel_data import CauseBar, PanelData
from calib.report.statements.diagnosis import diagnosis_content

#: effects named beside a cause that they cannot be told from
NAMED = 3
#: samples of a gap along a run that are drawn at most
WAY_POINTS = 120


def diagnosis_page(diagnosis: Diagnosis, campaign: Campaign) -> str:
    """Return a diagnosis as a self-contained HTML page.

    Raises MissingExtraError where Bokeh is not installed.
    """
    findings = findings_of(diagnosis)
    verdict = diagnosis.verdict
    # the panels take the figures' place, and keep the page light
    statements = tuple(block for block in diagnosis_content(findings) if not isinstance(block, Picture))
    page = Page(
        kind="Diagnosis",
        title="Gap between measured and simulated motion",
        name=verdict.campaign,
        simulated=verdict.simulated,
        head=(("Verdict", str(verdict.kind).replace("_", " ")), ("Judged against", verdict.judged_against)),
        sections=(Section("What was found", statements),),
        footer=f"Campaign {verdict.campaign}",
    )
    return page_html(page, linked_panels(diagnosis, campaign, findings))


def linked_panels(diagnosis: Diagnosis, campaign: Campaign, findings: GapFindings | None = None) -> str:
    """Return the linked panels of a diagnosis for a page's body; see `panels_of`."""
    return interactive_panels(panels_of(diagnosis, campaign, findings))


def panels_of(diagnosis: Diagnosis, campaign: Campaign, findings: GapFindings | None = None) -> PanelData:
    """Return what the panels show of a diagnosis."""
    gap = findings or findings_of(diagnosis)
    observations = diagnosis.observations
    labels = observations.labels
    n_units = len(observations)
    missing = np.full((n_units, len(Channel)), np.nan)
    along: list[np.ndarray] = [np.zeros((0, 3))] * n_units
    first = {str(name): unit for unit, name in reversed(list(enumerate(labels["run_id"])))}
    for trace in traces_of(campaign, observations):
        step = max(1, len(trace.way_m) // WAY_POINTS)
        along[first[trace.run_id]] = np.stack((trace.way_m, trace.along_m, trace.heading_rad), axis=1)[::step]
    return PanelData(
        run_id=labels["run_id"],
        session=labels["session"],
        kind=labels["kind"],
        channels=gap.channels,
        before=missing if gap.before is None else gap.before,
        after=missing if gap.after is None else gap.after,
        floor=missing if gap.floor is None else gap.floor,
        covariates=gap.covariates,
        paths_m=gap.paths_m,
        offset_m=gap.offset_m,
        along_m=tuple(along),
        causes=tuple(
            CauseBar(_with_group(cause.effect, gap.verdict), cause.probability, cause.share, cause.share_ci95)
            for cause in gap.verdict.causes
        ),
    )


def _with_group(effect: str, verdict: Verdict) -> str:
    """Return an effect with those that these runs cannot tell from it, a line each."""
    others = [
        other for group in verdict.groups if effect in group.effects for other in group.effects if other != effect
    ]
    more = [f"and {len(others) - NAMED} more"] if len(others) > NAMED else []
    return "\n".join([effect, *(f"or {other}" for other in others[:NAMED]), *more])
