"""The diagnosis as a page."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import pytest

from calib.gap.data.channels import Channel
from calib.gap.verdict.outcome import Closure, PlannedRunAdvice
from calib.gap.verdict.result import Cause, Quantity, Verdict, VerdictKind
from calib.gap.where.result import ChannelGap, Where
from calib.report.blocks import Notice, Picture, Section, Table
from calib.report.content import compose
from calib.report.gap_findings import GapFindings
from calib.report.html import block_html
from calib.report.pages import diagnosis
from calib.report.pdf import to_pdf
from calib.report.source import Source
from calib.report.statements.diagnosis import diagnosis_content
from calib.report.text import to_text
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
    assert notice.title == "These runs cannot tell the causes apart (ambiguous)"
    tables = {block.columns[0].title: block for block in made.blocks if isinstance(block, Table)}
    sizes = next(block for block in made.blocks if isinstance(block, Table) and block.columns[1].title == "Parameter")
    assert sizes.rows[0] == ("track_width", "relative", "1", "0.003020", "0.002930", "0.003110")
    assert tables["Run"].rows[0][0] == "1. square ccw"
    assert tables["Run"].rows[0][-1] == "tells the two apart"
    text = str([block.to_dict() for block in made.blocks])
    for phrase in ("track_width, curve_scrub", "61 %", "'61.0'", "4.10", "99 %", "m/s²", "suspect latency",
                   "wear: nothing varies", "r_004: lateral +34.0 mm, 4 times its floor"):  # fmt: skip
        assert phrase in text, phrase


@pytest.mark.parametrize("kind", VerdictKind)
def test_a_bare_verdict_is_a_page(source: Source, kind: VerdictKind) -> None:
    """A verdict without arrays, causes or closure still says what it is."""
    made = page(source, GapFindings(Verdict(kind, "It is as it is.")))
    notice = next(block for block in made.blocks if isinstance(block, Notice))
    assert kind.value in notice.title
    assert notice.text == "It is as it is."
    assert not [block for block in made.blocks if isinstance(block, Picture)]


def test_terminal_pdf_and_html_say_the_same(source: Source) -> None:
    """Every word of the content that the terminal shows stands in the HTML, and every block is one of the PDF's."""
    content = diagnosis_content(findings())
    markup = " ".join(unescape(re.sub(r"<[^>]+>", " ", block_html(block))) for block in content)
    said = set(re.findall(r"\w+", to_text(content, width=400)))
    assert len(said) > 100
    assert said <= set(re.findall(r"\w+", markup))
    assert [block.to_dict() for block in page(source, findings()).blocks] == [block.to_dict() for block in content]


def test_missing_values_are_dashes_not_failures(source: Source) -> None:
    nan = float("nan")
    cause = Cause("track_width", "track", "", nan, nan, nan, {"relative": Quantity(nan, (nan, nan), "1")})
    verdict = Verdict(
        VerdictKind.EXPLAINED,
        "",
        causes=(cause,),
        where=Where(channels=(ChannelGap(Channel.ALONG, 0.0, 0.0),)),
        closure=Closure(),
        next_runs=(PlannedRunAdvice("corridor", "why"),),
    )
    text = str([block.to_dict() for block in page(source, GapFindings(verdict)).blocks])
    assert "–" in text
    assert "None" not in text
    assert "nan" not in text


def test_the_report_with_a_diagnosis_is_set(source: Source) -> None:
    made = compose(replace(source, gap=findings()))
    assert to_pdf(made).startswith(b"%PDF")
    assert made.report_id != compose(source).report_id
