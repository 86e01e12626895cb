"""The diagnosis as a page."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.report.blocks import Notice, Picture, Section, Table
from calib.report.content import compose
from calib.report.gap_findings import GapFindings
from calib.report.pages import diagnosis
from calib.report.pdf import to_pdf
from calib.report.source import Source
from tests.report.making import findings


def page(source: Source, gap: GapFindings) -> Section:
    made = diagnosis.section(replace(source, gap=gap))
    assert made is not None
    return made


def test_without_a_diagnosis_there_is_no_page(source: Source) -> None:
    assert diagnosis.section(source) is None


def test_the_page_shows_verdict_map_ranking_aliases_closure_and_next_runs(source: Source) -> None:
    made = page(source, findings())
    pictures = [block.name for block in made.blocks if isinstance(block, Picture)]
    assert pictures == ["gap-map", "gap-by-covariate", "gap-before-after"]
    notice = next(block for block in made.blocks if isinstance(block, Notice))
    assert notice.title == "These runs cannot tell the causes apart"
    assert "track width or curve scrub" in notice.text
    tables = {block.columns[0].title: block for block in made.blocks if isinstance(block, Table)}
    assert [row[1:3] for row in tables["Cause"].rows][:1] == [("relative", "1")]
    assert tables["No."].rows[0] == ("1", "square ccw", "200", "0.3", "tells the two apart")
    text = str([block.to_dict() for block in made.blocks])
    for phrase in ("track width – curve scrub", "61 %", "61 mm", "4.1 mm", "99 %", "m/s²", "suspect latency"):
        assert phrase in text, phrase


@pytest.mark.parametrize("verdict", ["no_gap", "explained", "partly_explained", "ambiguous", "unknown"])
def test_a_bare_verdict_is_a_page(source: Source, verdict: str) -> None:
    """A verdict without arrays, causes or closure still says what it is."""
    made = page(source, GapFindings({"verdict": verdict}))
    notice = next(block for block in made.blocks if isinstance(block, Notice))
    assert notice.text.endswith(".")
    assert not [block for block in made.blocks if isinstance(block, Picture)]


def test_missing_values_are_dashes_not_failures(source: Source) -> None:
    empty = {
        "verdict": "explained",
        "causes": [{"effect": "track_width", "probability": None, "parameters": {"relative": {"value": None}}}],
        "where": {"channels": {"along": {}, "heading": {"rms": None, "floor": None}}, "covariates": [{"name": "turn"}]},
        "closure": {"before_rms_m": None, "after_rms_m": None, "fraction": None, "ci95": None},
        "next_runs": [{"kind": "corridor"}],
        "undetectable": {"wear": 0.1, "side_slip": {"value": 2e-3, "unit": "rad"}},
    }
    text = str([block.to_dict() for block in page(source, GapFindings(empty)).blocks])
    assert "–" in text
    assert "None" not in text
    assert "nan" not in text


def test_the_report_with_a_diagnosis_is_set(source: Source) -> None:
    made = compose(replace(source, gap=findings()))
    assert to_pdf(made).startswith(b"%PDF")
    assert made.report_id != compose(source).report_id
