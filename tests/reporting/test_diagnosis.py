"""The diagnosis as a page."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import pytest

from calib.gap.decision.diagnosis import Cause, Diagnosis, Quantity, VerdictKind
from calib.gap.decision.held_out import Closure
from calib.gap.localise.locate import ChannelGap, GapLocation
from calib.gap.observations import Channel
from calib.gap.plan.planned_runs import PlannedRun
from calib.reporting import Notice, Picture, Section, Table
from calib.reporting.content import compose
from calib.reporting.formatting import to_text
from calib.reporting.pages import blocks_html, to_pdf
from calib.reporting.source import Source
from calib.reporting.topics.diagnosis import diagnosis_content, verdict_notice
from calib.reporting.topics.fit import diagnosis_section
from calib.reporting.topics.runs import next_runs_table
from tests.reporting.making import findings, with_findings


def page(source: Source) -> Section:
    made = diagnosis_section(source)
    assert made is not None
    return made


def test_without_a_diagnosis_there_is_no_page(source: Source) -> None:
    assert diagnosis_section(source) is None


def test_the_page_shows_verdict_map_ranking_aliases_closure_and_next_runs(source: Source) -> None:
    made = page(with_findings(source))
    pictures = [block.name for block in made.blocks if isinstance(block, Picture)]
    assert pictures == ["gap-map", "gap-by-covariate", "gap-before-after"]
    notice = next(block for block in made.blocks if isinstance(block, Notice))
    assert notice.title == "These runs cannot tell the causes apart (ambiguous)"
    tables = {block.columns[0].title: block for block in made.blocks if isinstance(block, Table)}
    sizes = next(block for block in made.blocks if isinstance(block, Table) and block.columns[1].title == "Parameter")
    assert sizes.rows[0] == ("track_width", "relative", "", "0.003020", "0.002930", "0.003110")
    assert tables["Run"].rows[0][0] == "1. square ccw, payload at 0, 0 m"
    assert tables["Run"].rows[0][-1] == "tells the two apart"
    text = str([block.to_dict() for block in made.blocks])
    for phrase in ("track_width, curve_scrub", "61 %", "'61.0'", "4.10", "99 %", "m/s²", "suspect latency",
                   "wear: nothing varies", "r_004: lateral +34.0 mm (4 times its noise level)"):  # fmt: skip
        assert phrase in text, phrase


@pytest.mark.parametrize("kind", VerdictKind)
def test_a_bare_verdict_is_a_page(source: Source, kind: VerdictKind) -> None:
    """A verdict without arrays, causes or closure still says what it is."""
    made = page(replace(source, verdict=Diagnosis(kind, "It is as it is.")))
    notice = next(block for block in made.blocks if isinstance(block, Notice))
    assert kind.value in notice.title
    assert notice.text == "It is as it is."
    assert not [block for block in made.blocks if isinstance(block, Picture)]


def test_terminal_pdf_and_html_say_the_same(source: Source) -> None:
    """Every word of the content that the terminal shows stands in the HTML, and every block is one of the PDF's."""
    content = diagnosis_content(*findings())
    markup = " ".join(unescape(re.sub(r"<[^>]+>", " ", blocks_html([block]))) for block in content)
    said = set(re.findall(r"\w+", to_text(content, width=400)))
    assert len(said) > 100
    assert said <= set(re.findall(r"\w+", markup))
    assert [block.to_dict() for block in page(with_findings(source)).blocks] == [block.to_dict() for block in content]


def test_missing_values_are_dashes_not_failures(source: Source) -> None:
    nan = float("nan")
    cause = Cause("track_width", "track", "", nan, nan, nan, {"relative": Quantity(nan, (nan, nan), "1")})
    verdict = Diagnosis(
        VerdictKind.EXPLAINED,
        "",
        causes=(cause,),
        where=GapLocation(channels=(ChannelGap(Channel.ALONG, 0.0, 0.0),)),
        closure=Closure(),
        next_runs=(PlannedRun("corridor", why="why"),),
    )
    text = str([block.to_dict() for block in page(replace(source, verdict=verdict)).blocks])
    assert "–" in text
    assert "None" not in text
    assert "nan" not in text


@pytest.mark.usefixtures("undrawn")
def test_the_report_with_a_diagnosis_is_set(source: Source) -> None:
    made = compose(with_findings(source))
    assert to_pdf(made).startswith(b"%PDF")
    assert made.report_id != compose(source).report_id


def test_a_title_and_its_sentence_say_a_thing_once() -> None:
    """A verdict that cannot be given begins its sentence, which stands alone elsewhere, as its title does."""
    sentence = "These runs cannot show whether there is a gap: their noise level rests on nothing."
    notice = verdict_notice(Diagnosis(VerdictKind.UNDECIDED, sentence))
    assert notice.title == "These runs cannot show whether there is a gap (undecided)"
    assert notice.text == "their noise level rests on nothing."
    assert verdict_notice(Diagnosis(VerdictKind.EXPLAINED, "The gap is small.")).text == "The gap is small."
    sentence = "Correct this first: swapped wheels. Until then: The gap is explained by the track."
    notice = verdict_notice(Diagnosis(VerdictKind.EXPLAINED, sentence))
    assert (notice.level, notice.title) == ("bad", "Correct this first (explained)")
    assert notice.text.startswith("swapped wheels.")


@pytest.mark.parametrize(("probability", "title"), [(0.31, "Probably no gap"), (0.5, "The cause of the gap is")])
def test_the_title_denies_what_is_less_probable_than_not(probability: float, title: str) -> None:
    """The title is all that many read."""
    verdict = Diagnosis(VerdictKind.UNKNOWN, "It may be.", gap_probability=probability)
    assert verdict_notice(verdict).title.startswith(title)
    assert verdict_notice(replace(verdict, kind=VerdictKind.NO_GAP)).title.startswith("No gap")


def test_runs_that_differ_in_the_place_of_the_payload_alone_differ_on_a_terminal() -> None:
    """At 80 columns, where a column of its own has no room."""
    left = PlannedRun("figure8", payload_kg=100.0, payload_x_m=0.3, payload_y_m=0.15, why="w" * 40)
    runs = [replace(left, payload_y_m=-0.15), left]
    text = to_text([next_runs_table([run.to_dict() for run in runs])])
    assert "at 0.3, -0.15 m" in " ".join(text.split()) and "at 0.3, 0.15 m" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80


def test_a_form_that_is_more_probable_than_the_cause_says_so() -> None:
    cause = Cause("curve_scrub", "scrubbing", "", 0.12, 1.0, 20.0, {}, forms_open=("load_dependent_track", "wear"))
    found = Diagnosis(VerdictKind.EXPLAINED, "", (cause,), probabilities={"load_dependent_track": 0.64})
    said = " ".join(to_text(diagnosis_content(found)).split())
    assert "do not determine the form; load_dependent_track (64 %), wear fit equally well" in said


def test_a_temperature_of_a_run_to_drive_is_one_that_a_hall_keeps() -> None:
    """The median of the runs driven, 19.975 degrees, is told to a tenth, and speeds as they were chosen."""
    made = next_runs_table([PlannedRun("corridor", speed_mps=0.35, temperature_C=19.975, why="tells").to_dict()])
    assert isinstance(made, Table)
    assert "20" in made.rows[0] and "0.35" in made.rows[0] and "19.975" not in " ".join(map(str, made.rows[0]))
