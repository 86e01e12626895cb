"""The page of a diagnosis: opens from disk alone, complete without scripts, and a selection highlights everywhere."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from html import unescape
from pathlib import Path

import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import Diagnosis

pytest.importorskip("bokeh", reason="the extra html is not installed")

from calib.documents import plain
from calib.reporting.content import report_without_law
from calib.reporting.formatting import prose
from calib.reporting.interactive import interactive_panels
from calib.reporting.pages import GAP_PICTURES, diagnosis_page, to_html

ROOT = Path(__file__).resolve().parents[2]
#: what a page of the samples may weigh: it is sent by mail
MOST_BYTES = 2_000_000
BROWSER_S = 90
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
#: selects the units of the first session through the list of sessions and says how many every panel's table then has
CHOOSE = """<script>
window.addEventListener("load", () => setTimeout(() => {
  try {
    const models = [...Bokeh.documents[0].all_models];
    const choice = Bokeh.documents[0].get_model_by_name("choice");
    choice.value = [choice.options.find((o) => o.startsWith("session "))];
    const tables = models.filter((m) => m.data && m.data.run);
    setTimeout(() => document.title = "chosen " + tables.map((t) => t.selected.indices.length).join(",") + " panels " +
      models.filter((m) => m.x_range && m.toolbar).length, 500);
  } catch (error) { document.title = String(error); }
}, 1500));
</script>"""


@pytest.fixture(scope="module")
def diagnosis(diagnosed_sample: Callable[[str], tuple[Campaign, Diagnosis]]) -> Diagnosis:
    return diagnosed_sample("yard")[1]


@pytest.fixture(scope="module")
def page(diagnosis: Diagnosis) -> str:
    return diagnosis_page(diagnosis, read_campaign(ROOT / "sample_runs" / "yard"))


def test_a_page_is_light(page: str) -> None:
    assert len(page.encode()) < MOST_BYTES


def test_a_page_fetches_nothing(page: str) -> None:
    """No tag names a place elsewhere: scripts, styles and pictures stand inside."""
    markup = re.sub(r"(<script[^>]*>).*?</script>", r"\1", page, flags=re.DOTALL)
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*\b(?:src|href)=[\"'](?!data:|#)", markup)


def test_the_words_stand_outside_the_scripts(page: str, diagnosis: Diagnosis) -> None:
    """Sentence and causes can be read where no script runs."""
    text = unescape(re.sub(r"<[^>]+>", "", re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)))
    assert all(prose(part) in text for part in diagnosis.sentence.split("; ")[1:])
    assert all(cause.effect in text for cause in diagnosis.causes)


@pytest.fixture(scope="module")
def report_page(diagnosis: Diagnosis) -> str:
    """The page of a report that carries the diagnosis."""
    campaign = read_campaign(ROOT / "sample_runs" / "yard")
    report = report_without_law(campaign, issued="2026-01-01", why="asked for", diagnosis=diagnosis)
    assert {picture.name for picture in report.pictures} == set(GAP_PICTURES)
    assert diagnosis.causes[0].title in str(plain(report.sections[0]))
    return to_html(report, interactive_panels(diagnosis, campaign))


def test_a_report_carries_the_panels_of_its_diagnosis(report_page: str) -> None:
    """In place of the figures of the same things."""
    assert report_page.count('<script type="application/gzip">') >= 3  # Bokeh, its widgets, the panels
    assert "data:image/svg" not in report_page
    assert len(report_page.encode()) < MOST_BYTES


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
@pytest.mark.parametrize("name", ["page", "report_page"])
def test_choosing_a_session_highlights_it_everywhere(
    name: str, diagnosis: Diagnosis, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """In a real browser: all panels share one table, and the choice of a session selects its runs in it."""
    page: str = request.getfixturevalue(name)
    path = tmp_path / "page.html"
    # the last end of a body: Bokeh's own script holds the words, too
    before, end, after = page.rpartition("</body>")
    path.write_text(before + CHOOSE + end + after, encoding="utf-8")
    flags = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync"
    command = [str(BROWSER), *flags.split(), f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=10000"]
    done = subprocess.run(
        [*command, "--dump-dom", path.as_uri()], capture_output=True, text=True, timeout=BROWSER_S, check=False
    )
    title = re.search(r"<title>(.*?)</title>", done.stdout)
    assert title is not None
    found = re.fullmatch(r"chosen ([\d,]+) panels (\d+)", title[1])
    assert found is not None, title[1]
    sessions = diagnosis.observations.labels["session"]
    first = sorted(set(sessions))[0]
    assert [int(number) for number in found[1].split(",")] == [int((sessions == first).sum())]
    assert int(found[2]) >= 4
