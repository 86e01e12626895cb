"""From a laboratory's export with 16-bit counters to a vehicle that drives on across their overflows."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from calib.cli.main import run
from calib.runtime import Coefficients, Odometer, Status
from tests.campaign.ingest.lab import N_RUNS, SWAPPED, Lab
from tests.campaign.ingest.test_lab import Laboratory, edited
from tests.conftest import BLANK

DRIVER = Path(__file__).parents[1] / "runtime" / "driver.c"
#: distances of the runs against the runtime's: the radii's scatter of 2e-5 over 40 m, five times, and the straight path
DISTANCE_M = 0.01
#: C and Python round alike but for the order of sums
SAME_M = 1e-9


#: variant -> what it calls a run
VARIANTS = {"german": "Lauf {}", "plain": "run{:02}"}
#: radius at 300 N and slope of the wheels that the export was made of
TRUE = {"left": (0.0990, 1.3e-6), "right": (0.0993, 1.2e-6)}
#: lines of a mapping at most, without remarks and empty ones
MOST_LINES = 30


@pytest.fixture(scope="module", params=VARIANTS)
def exported(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, laboratory: Laboratory
) -> tuple[Lab, Path]:
    """One description, one edited mapping, one ingestion; then fit, report and export."""
    folder = tmp_path_factory.mktemp("lab")
    lab, proposed = laboratory(request.param)
    name = VARIANTS[request.param].format(SWAPPED)
    text = edited(proposed).replace("[log]", f'[log]\nswapped = ["{name}"] #')
    assert sum(bool(line.strip()) and not line.startswith("#") for line in text.splitlines()) <= MOST_LINES
    (folder / "m.toml").write_text(text, encoding="utf-8")
    mapping, campaign, fit = folder / "m.toml", folder / "c", folder / "f"
    assert run(["ingest", str(lab.table), str(lab.logs), "--mapping", str(mapping), "--into", str(campaign)]) == 0
    assert run(["fit", str(campaign), "--into", str(fit)]) == 0
    with pytest.MonkeyPatch.context() as patch:
        # what figures show is the tests' of figures
        patch.setattr("calib.reporting.Picture.svg", BLANK)
        assert run(["report", str(fit), "--into", str(folder / "report.pdf")]) == 0
    assert run(["export", str(fit), "--to", "json", "--output", str(folder / "coefficients.json")]) == 0
    assert run(["export", str(fit), "--to", "c", "--output", str(folder / "calib_coefficients.h")]) == 0
    return lab, folder


def _samples(lab: Lab, number: int) -> list[tuple[float, int, int]]:
    """A logger's file as the vehicle counts: 16 bits, overflowing."""
    if lab.logs.name == "runs":
        rows = [line.split(",") for line in (lab.logs / f"run{number:02}.csv").read_text().splitlines()[1:]]
        return [(1e-3 * float(ms), int(left), int(right)) for ms, left, right in rows]
    lines = (lab.logs / f"Lauf_{number:02}.csv").read_text(encoding="cp1252").splitlines()[7:]
    cells = [line.split(";") for line in lines]
    seconds = [float(time[17:23]) + 60 * float(time[14:16]) + 3600 * float(time[11:13]) for time, *_ in cells]
    return [(t - seconds[0], int(left), int(right)) for t, (_, left, right, _) in zip(seconds, cells, strict=True)]


def test_the_header_has_the_width_and_the_report_is_there(exported: tuple[Lab, Path]) -> None:
    lab, folder = exported
    fitted = json.loads((folder / "f" / "fit.json").read_text())
    # the run without a log is omitted; the one with exchanged wheels was corrected
    assert fitted["wheels"]["left"]["n_runs"] == N_RUNS - 1
    for side in ("left", "right"):
        low, high = fitted["wheels"][side]["radius_ref_ci95_m"]
        at = fitted["wheels"][side]["reference_load_N"]
        radius = TRUE[side][0] + TRUE[side][1] * (at - 300.0)
        margin = 0.5 * (high - low)  # the interval doubled: a fixed seed
        assert low - margin <= radius <= high + margin
    assert lab.table.is_file()
    assert re.search(r"#define CALIB_WRAP_BITS 16\b", (folder / "calib_coefficients.h").read_text())
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("number", [1, 5, 20])
def test_the_runtime_drives_on_across_overflows(number: int, exported: tuple[Lab, Path]) -> None:
    """No sample is refused, and the distance is the rangefinder's."""
    lab, folder = exported
    samples = _samples(lab, number)
    jumps = np.abs(np.diff([left for _, left, _ in samples])) > 2**15
    assert jumps.sum() >= 3
    odometer = Odometer(Coefficients.parse((folder / "coefficients.json").read_text()))
    sides = ("left", "right")
    loads = [float(lab.truth.runs.number(f"load_{side}_N")[number - 1]) for side in sides]
    odometer.set_wheel_loads(*loads)
    assert {odometer.feed(left, right, t) for t, left, right in samples} == {Status.OK}
    assert odometer.pose.distance_m == pytest.approx(lab.truth.runs.number("distance_m")[number - 1], abs=DISTANCE_M)


def test_the_compiled_header_drives_the_same(exported: tuple[Lab, Path], tmp_path: Path) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler here")
    lab, folder = exported
    command = [compiler, "-std=c99", "-I", str(folder), str(DRIVER), "-lm", "-o", str(tmp_path / "driver")]
    subprocess.run(command, check=True, capture_output=True)
    loads = [float(lab.truth.runs.number(f"load_{side}_N")[0]) for side in ("left", "right")]
    samples = _samples(lab, 1)
    script = f"L {loads[0]!r} {loads[1]!r}\n" + "".join(f"T {a} {b} {t!r}\n" for t, a, b in samples)
    out = subprocess.run([str(tmp_path / "driver")], input=script, capture_output=True, text=True, check=True).stdout
    lines = [line.split() for line in out.splitlines()]
    assert {line[0] for line in lines} == {"0"}
    odometer = Odometer(Coefficients.parse((folder / "coefficients.json").read_text()))
    odometer.set_wheel_loads(*loads)
    for t, left, right in samples:
        odometer.feed(left, right, t)
    assert float(lines[-1][7]) == pytest.approx(odometer.pose.distance_m, abs=SAME_M)
