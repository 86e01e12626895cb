"""The replay in C ends where the Python odometry ends, and goes on after a dropout."""

from __future__ import annotations

import csv
import shutil
import subprocess
from pathlib import Path

import pytest

from calib.coefficients.build import coefficients_of, export
from calib.runtime import Odometer, Status

SAMPLE = Path(__file__).parents[2] / "sample_runs" / "corridor_crossed"
SOURCE = Path(__file__).parents[2] / "examples" / "replay.c"
LOADS = (500.0, 500.0)
#: digits that the program prints
PRINTED = 1e-8


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler is installed")
    folder = tmp_path_factory.mktemp("replay")
    file = coefficients_of(SAMPLE).file
    (folder / "calib_coefficients.h").write_bytes(export(file, "c")[0].data)
    (folder / "coefficients.json").write_bytes(file.to_bytes())
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    subprocess.run([compiler, *flags, str(SOURCE), "-lm", "-o", str(folder / "replay")], check=True)
    return folder / "replay"


def _replayed(program: Path, text: str) -> tuple[int, list[list[float]], str]:
    command = [str(program), *map(str, LOADS)]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    rows = [[float(cell) for cell in row] for row in csv.reader(done.stdout.splitlines()[1:])]
    return done.returncode, rows, done.stderr


def _odometer(program: Path) -> Odometer:
    odometer = Odometer.from_file(program.with_name("coefficients.json"))
    odometer.set_wheel_loads(*LOADS)
    return odometer


def _log() -> tuple[str, list[dict[str, str]]]:
    text = sorted((SAMPLE / "logs").glob("*.csv"))[0].read_text()
    return text, list(csv.DictReader(text.splitlines()))


def test_it_ends_where_the_odometer_ends(program: Path) -> None:
    text, rows = _log()
    status, path, said = _replayed(program, text)
    odometer = _odometer(program)
    for row in rows:
        odometer.feed(int(row["counts_left"]), int(row["counts_right"]), float(row["t_s"]))
    assert (status, len(path)) == (0, len(rows))
    assert path[-1][1:] == pytest.approx([odometer.pose.x_m, odometer.pose.y_m, odometer.pose.theta_rad], abs=PRINTED)
    assert f"{len(rows)} rows, 0 dropouts" in said


def test_after_a_dropout_it_goes_on_from_the_last_good_pose(program: Path) -> None:
    """A third of the log is missing: the motion in between is given up, said, and no more."""
    text, _ = _log()
    lines = text.splitlines()
    cut = [*lines[: len(lines) // 3], *lines[2 * len(lines) // 3 :]]
    status, path, said = _replayed(program, "\n".join(cut) + "\n")
    odometer = _odometer(program)
    for row in csv.DictReader(cut):
        sample = int(row["counts_left"]), int(row["counts_right"]), float(row["t_s"])
        if odometer.feed(*sample) in (Status.STALE, Status.JUMP):
            odometer.rebase()
            odometer.feed(*sample)
    assert status == 1 and said.count("given up") == 1
    assert path[-1][1:] == pytest.approx([odometer.pose.x_m, odometer.pose.y_m, odometer.pose.theta_rad], abs=PRINTED)
    assert odometer.pose.interrupted
    whole = _replayed(program, text)[1]
    assert path[-1][1] < 0.8 * whole[-1][1]


def test_a_log_without_counts_is_refused(program: Path) -> None:
    status, path, said = _replayed(program, "t_s,range_m\n0.0,1.0\n")
    assert (status, path) == (2, [])
    assert "found no column counts_left" in said
