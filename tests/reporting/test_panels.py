"""The table behind the panels of a page: paths in one frame, colours, order; what a browser makes of the choices."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict
from calib.reporting.figures.gap import GapArrays, distinct
from calib.reporting.formatting import natural
from calib.reporting.interactive import gap_along_runs, panel_columns, run_paths
from tests.kinematics.campaigns import Leg, Truth, campaign

ROOT = Path(__file__).parents[2]
#: noise of the reference
SIGMA_M, SIGMA_RAD = 5e-4, 5e-4
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BROWSER_S = 90
#: makes three choices one after the other and says what became of them
CHOOSE = """<script>
const settled = () => new Promise((done) => setTimeout(done, 300));
window.addEventListener("load", () => setTimeout(async () => {
  try {
    const page = Bokeh.documents[0];
    const table = [...page.all_models].find((m) => m.data && m.data.run);
    const said = [];
    const choose = async (name, value) => { page.get_model_by_name(name).value = value; await settled(); };
    await choose("colour", "by length_m");
    said.push(page.get_model_by_name("legend").text.includes("gradient"), new Set(table.data.colour).size);
    await choose("colour", "session");
    said.push(page.get_model_by_name("legend").text.startsWith("session:"), new Set(table.data.colour).size);
    await choose("axis", "time (s)");
    said.push(table.data.way[0][table.data.way[0].length - 1].toFixed(3));
    await choose("moment", 0);
    said.push(Math.max(...table.data.now_after_x.map(Math.abs)).toFixed(3));
    document.title = said.join(" ");
  } catch (error) { document.title = String(error); }
}, 1500));
</script>"""


@pytest.fixture(scope="module")
def along() -> Campaign:
    """Twelve winding recordings with a reference along the way, on the axle and on time."""
    rng = np.random.default_rng(3)
    legs: list[list[Leg]] = [[(1.0, turn) for turn in rng.uniform(-1.5, 1.5, 8 + k)] for k in range(12)]
    return campaign([("free", one) for one in legs], Truth(), rng, sigma=(SIGMA_M, SIGMA_RAD), along=True, samples=300)


@pytest.fixture(scope="module")
def diagnosis(along: Campaign) -> Diagnosis:
    return diagnose_in_full(along, plan=False)


def test_the_reference_path_ends_where_the_gap_says(along: Campaign, diagnosis: Diagnosis) -> None:
    """The end of the simulated path and the gap's arrow give the end of the measured one, in every window."""
    paths, gap = run_paths(diagnosis, along), GapArrays.of(diagnosis)
    assert gap.offset_m is not None
    ends = np.array([path[-1, 1:] for path in paths["before"]]) + gap.offset_m
    measured = np.array([path[-1, 1:] for path in paths["reference"]])
    # samples of the reference are taken at the ends of windows
    assert np.abs(ends - measured).max() < 1e-6


def test_the_causes_bring_the_path_to_the_reference(along: Campaign, diagnosis: Diagnosis) -> None:
    paths = run_paths(diagnosis, along)
    apart = [
        np.array([path[-1, 1:] - other[-1, 1:] for path, other in zip(which, paths["reference"], strict=True)])
        for which in (paths["before"], paths["after"])
    ]
    before, after = (float(np.sqrt(np.mean(one**2))) for one in apart)
    assert after < 0.2 * before


def test_the_path_of_a_run_without_a_log_has_times() -> None:
    """The slider of the time ends with the longest; such a run counts as driven at 1 m/s."""
    read = read_campaign(ROOT / "sample_runs/yard", logs=False)
    nominal = predict(observations_of(read))
    drawn = SimpleNamespace(observations=nominal.s, nominal=nominal, correction=SimpleNamespace(path=nominal))
    for path in run_paths(drawn, read)["before"]:  # type: ignore[arg-type]
        assert (np.diff(path[:, 0]) > 0.0).all() and path[0, 0] == 0.0


def test_runs_count_from_one_and_names_sort_as_people_count(along: Campaign, diagnosis: Diagnosis) -> None:
    gap = GapArrays.of(diagnosis)
    along_runs = gap_along_runs(diagnosis.observations, along)
    columns = panel_columns(gap, along_runs, run_paths(diagnosis, along), ("#000000", "#FFFFFF"))
    assert columns["by order driven"][0] == 1
    assert {len(values) for values in columns.values()} == {len(gap.before)}
    assert natural(["r10", "r2", "b", "r2", "10", "9"]) == ["9", "10", "b", "r2", "r10"]
    assert natural(["square_cw", "corridor_short", "corridor"]) == ["corridor", "corridor_short", "square_cw"]


def test_covariates_that_vary_alike_get_one_panel() -> None:
    rng = np.random.default_rng(1)
    load = rng.uniform(300, 1100, 30)
    covariates = {
        "payload_kg": load / 9.81,
        "load_left_N": load,
        "speed_mps": rng.uniform(0, 1, 30),
        "load_sum_N": -load,
    }
    assert distinct(covariates) == {"payload_kg": ["load_left_N", "load_sum_N"], "speed_mps": []}


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_colour_axis_and_time_can_be_chosen(along: Campaign, diagnosis: Diagnosis, tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="the extra html is not installed")
    from calib.reporting.pages import diagnosis_page

    before, end, after = diagnosis_page(diagnosis, along).rpartition("</body>")
    path = tmp_path / "page.html"
    path.write_text(before + CHOOSE + end + after, encoding="utf-8")
    flags = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-sync"
    command = [str(BROWSER), *flags.split(), f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=10000"]
    done = subprocess.run(
        [*command, "--dump-dom", path.as_uri()], capture_output=True, text=True, timeout=BROWSER_S, check=False
    )
    title = re.search(r"<title>(.*?)</title>", done.stdout)
    assert title is not None
    scale, shades, named, colours, last_s, start = title[1].split()
    assert (scale, named, start) == ("true", "true", "0.000")
    assert int(shades) > 3
    assert int(colours) == len(set(diagnosis.observations.labels["session"]))
    log = along.logs.of(0)
    assert float(last_s) == pytest.approx(float(log["t_s"][-1] - log["t_s"][0]), abs=0.2)  # thinned
