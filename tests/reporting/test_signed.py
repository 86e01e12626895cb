"""What a laboratory adds to its report: signatures, method, the report replaced, logo; and names in any script."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from calib.campaign.model import Campaign
from calib.documents import plain
from calib.errors import CalibError
from calib.gap.decision.diagnosis import VerdictKind
from calib.reporting import Notice, Picture, Table
from calib.reporting.content import Report, compose
from calib.reporting.pages import to_pdf
from calib.reporting.source import Source, logo_of, opened, source_of
from calib.reporting.topics.fit import result_section

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="20" height="10"><rect width="20" height="10"/></svg>'
DATE = "2025-03-31"


def with_report(campaign: Campaign, root: Path | None = None, **stated: str) -> Campaign:
    return replace(campaign, extra={"report": stated}, root=root)


def bare(report: Report) -> Report:
    """The report's first page alone, which is quick to set."""
    return replace(report, sections=())


def test_method_and_the_report_replaced_stand_under_the_title(campaign: Campaign) -> None:
    made = compose(source_of(with_report(campaign, method="LAB-07", replaces="CR-1"), issued=DATE))
    assert ("Method", "LAB-07") in made.head
    assert ("Replaces report", "CR-1") in made.head


def test_nobody_is_told_that_no_report_is_replaced(report: Report) -> None:
    assert not {"Method", "Replaces report"} & set(dict(report.head))


def test_the_lines_to_be_signed_bear_the_names(campaign: Campaign, report: Report) -> None:
    made = compose(source_of(with_report(campaign, prepared="A. Miller", authorised="B. Smith"), issued=DATE))
    assert made.signatures == (("Prepared by", "A. Miller"), ("Authorised by", "B. Smith"))
    assert [name for _, name in report.signatures] == ["", ""]  # room to sign by hand


def test_a_logo_of_the_campaign_is_on_the_page(campaign: Campaign, tmp_path: Path) -> None:
    (tmp_path / "logo.svg").write_text(SVG)
    logo = logo_of(with_report(campaign, tmp_path, logo="logo.svg"))
    assert logo is not None
    source = source_of(campaign, issued=DATE)
    with_logo, without = (bare(compose(replace(source, logo=one))) for one in (logo, None))
    assert with_logo.to_dict()["logo"] == "logo.svg"
    assert to_pdf(with_logo) != to_pdf(without)


@pytest.mark.parametrize("name", ["../logo.svg", "/etc/logo.svg", "absent.svg", "logo.exe"])
def test_a_logo_from_elsewhere_is_refused(campaign: Campaign, tmp_path: Path, name: str) -> None:
    """Paths in data never leave the campaign."""
    inner = tmp_path / "campaign"
    inner.mkdir()
    (tmp_path / "logo.svg").write_text(SVG)
    (inner / "logo.exe").write_text(SVG)
    with pytest.raises(CalibError, match="logo"):
        logo_of(with_report(campaign, inner, logo=name))


@pytest.mark.parametrize("name", ["走廊 тест 🚚 ümläut", "ממ ไทย", "\U0001f600" * 3])
def test_names_in_any_script_do_not_stop_a_report(report: Report, name: str) -> None:
    """With the fonts of the machine where it has them, else by code point."""
    assert to_pdf(bare(replace(report, name=name, title=name))).startswith(b"%PDF")


def test_page_one_says_what_a_diagnosis_beside_the_fit_found(
    source: Source, campaign: Campaign, project_root: Path, tmp_path: Path
) -> None:
    import shutil

    folder = shutil.copytree(project_root / "sample_runs" / "corridor_crossed", tmp_path / "c")
    found = {"campaign": campaign.name, "verdict": "explained", "sentence": "It is the load."}
    (folder / "diagnosis.json").write_text(json.dumps(found))
    known = source_of(opened(folder), issued=DATE)
    assert known.known_verdict == (VerdictKind.EXPLAINED, "It is the load.")
    notices = [block for block in result_section(known).blocks if isinstance(block, Notice)]
    assert notices[-1].text == "It is the load."
    assert "diagnosis.json" in notices[-1].title
    assert len([block for block in result_section(source).blocks if isinstance(block, Notice)]) == 1
    (folder / "diagnosis.json").write_text(json.dumps(found | {"campaign": "another"}))
    assert source_of(opened(folder), issued=DATE).known_verdict is None
    (folder / "diagnosis.json").write_text("{}")
    with pytest.raises(CalibError, match=r"diagnosis\.json"):
        source_of(opened(folder), issued=DATE)


def test_the_budget_is_drawn_and_says_what_is_not_declared(report: Report, campaign: Campaign) -> None:
    section = next(one for one in report.sections if one.title == "Uncertainty budget")
    assert [block.name for block in section.blocks if isinstance(block, Picture)] == ["budget"]
    assert "declares no systematic parts" in str(plain(section))
    entry = {"rangefinder": {"scale": {"half_width": 5e-5, "distribution": "rectangular"}}}
    declared = compose(source_of(replace(campaign, extra={"uncertainty": entry}), issued=DATE))
    section = next(one for one in declared.sections if one.title == "Uncertainty budget")
    law = [block for block in section.blocks if isinstance(block, Table)][1]
    assert [column.title for column in law.columns][-2:] == ["Systematic", "Combined"]
    assert "are declared" in str(plain(section))


def test_the_table_of_runs_has_the_counts_of_the_campaign(report: Report, campaign: Campaign) -> None:
    section = next(one for one in report.sections if one.title == "Runs")
    table = next(block for block in section.blocks if isinstance(block, Table))
    k = next(number for number, column in enumerate(table.columns) if column.group == "Counts")
    order = {str(name): number for number, name in enumerate(campaign.runs.run_id)}
    for row in table.rows:
        measured = [abs(campaign.runs.number(f"counts_{side}")[order[row[0]]]) for side in ("left", "right")]
        assert [int(cell) for cell in row[k : k + 2]] == [round(value) for value in measured]


def test_the_html_page_is_whole_and_needs_no_network(report: Report) -> None:
    from calib.reporting.pages import to_html

    page = to_html(report)
    assert page.startswith("<!doctype html>")
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)", page)
    assert "<script" not in page
    assert page.count("<figure>") == len(report.pictures)
    for section in report.sections:
        assert section.title in page
