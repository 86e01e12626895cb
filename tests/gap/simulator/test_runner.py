"""Runs of a simulator: what fails says so with its own output, what is done is kept, nothing is left running."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from calib.errors import BadInputError
from calib.gap.simulator import read_settings, run_cache
from calib.gap.simulator.runner import Job, SimulatorRunner

RUNS = ["a", "b"]
#: writes p and 2 p as the ends of two runs, after what a test puts in the place of ACT
SCRIPT = """
import json, os, sys, time
campaign, parameters, out = sys.argv[1:]
p = json.load(open(parameters))["p"]
open(campaign + "/ran.txt", "a").write(f"{p}\\n")
ACT
open(out, "w").write(f"run_id,sim_x_m\\na,{p}\\nb,{2 * p}\\n")
"""


def runner(folder: Path, act: str = "", *, timeout_s: float = 30.0, workers: int = 1) -> SimulatorRunner:
    """A runner of the script with its campaign in the same folder."""
    (folder / "sim.py").write_text(SCRIPT.replace("ACT", act))
    path = folder / "SIM.toml"
    # -S -E: starts in a fifth of the time
    command = [sys.executable, "-S", "-E", "sim.py", "{campaign}", "{parameters}", "{out}"]
    path.write_text(
        f"command = {json.dumps(command)}\ntimeout_s = {timeout_s}\n"
        '[[parameter]]\nname = "p"\nnominal = 1\nstep = 0.1\nlargest = 1\n'
    )
    settings = read_settings(path)
    cache = run_cache(settings, {"runs.csv": "0"})
    return SimulatorRunner(settings, folder, RUNS, cache, workers, lambda *_: None)


def jobs(*values: float) -> list[Job]:
    return [Job({"p": value}, f"p = {value:g}") for value in values]


def ran(folder: Path) -> list[str]:
    path = folder / "ran.txt"
    return path.read_text().split() if path.exists() else []


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_results_come_in_the_order_asked_for_and_the_second_time_nothing_runs(tmp_path: Path, cache: Path) -> None:
    first = runner(tmp_path, workers=2)
    tables = first.run(jobs(3.0, 1.0))
    assert [table[:, 1].tolist() for table in tables] == [[3.0, 6.0], [1.0, 2.0]]
    again = runner(tmp_path)
    np.testing.assert_array_equal(again.run(jobs(1.0))[0], tables[1])
    assert (again.asked, again.ran) == (1, 0)
    assert sorted(ran(tmp_path)) == ["1.0", "3.0"]
    # a damaged file is as good as none, and so is a result of another script
    for path in cache.rglob("*.json"):
        path.write_bytes(path.read_bytes()[:-20])
    runner(tmp_path).run(jobs(1.0))
    runner(tmp_path, "p = p + 0").run(jobs(1.0))
    assert len(ran(tmp_path)) == 4


@pytest.mark.parametrize(
    ("act", "words"),
    [
        ('print("no such mesh"); sys.exit(3)', ["exit status 3", "its output ends: no such mesh"]),
        ('raise ValueError("diverged")', ["exit status 1", "ValueError: diverged"]),
        ("os._exit(0)", ["no output file", "it printed nothing"]),
        ("os.kill(os.getpid(), 9)", ["exit status -9"]),
        ('p = float("nan"); print("\\x1b[31mbad")', ["sim_x_m = 'nan' in run a", "?[31mbad"]),
        ('open(out, "w").write("run_id,sim_x_m\\na,1\\n"); sys.exit()', ["no row for 1 of 2 runs (b first)"]),
    ],
)
def test_a_simulator_that_fails_is_named_in_one_line_with_its_own_output(
    tmp_path: Path, act: str, words: list[str]
) -> None:
    with pytest.raises(BadInputError) as caught:
        runner(tmp_path, act).run(jobs(1.5))
    text = str(caught.value)
    assert "\n" not in text
    for part in ["SIM.toml", "p = 1.5", *words]:
        assert part in text


def test_one_that_hangs_is_stopped_with_all_that_it_started(tmp_path: Path) -> None:
    act = (
        'import subprocess; child = subprocess.Popen(["sleep", "60"]); '
        'open(campaign + "/child.txt", "w").write(str(child.pid)); print("loading", flush=True); time.sleep(60)'
    )
    begun = time.monotonic()
    with pytest.raises(BadInputError, match=r"no end after 1 s.*its output ends: loading"):
        runner(tmp_path, act, timeout_s=1.0).run(jobs(1.0))
    assert time.monotonic() - begun < 10.0
    child = int((tmp_path / "child.txt").read_text())
    deadline = time.monotonic() + 5.0
    while _alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _alive(child)


def _alive(pid: int) -> bool:
    try:
        # a process that has ended but that nobody has waited for yet is none
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_what_was_done_before_a_failure_or_an_interruption_is_kept(tmp_path: Path) -> None:
    act = 'sys.exit("out of memory") if p == 3 and not os.path.exists(campaign + "/mended") else None'
    with pytest.raises(BadInputError, match="out of memory"):
        runner(tmp_path, act).run(jobs(1.0, 2.0, 3.0, 4.0))
    done = {"1.0", "2.0"}
    assert done <= set(ran(tmp_path))
    (tmp_path / "mended").write_text("")
    (tmp_path / "ran.txt").unlink()

    stopped = runner(tmp_path, act)

    def interrupt(count: int, *_: object) -> None:
        if count >= 3:
            raise KeyboardInterrupt

    stopped.progress = interrupt
    with pytest.raises(KeyboardInterrupt):
        stopped.run(jobs(1.0, 2.0, 3.0, 4.0))
    assert not done & set(ran(tmp_path))
    finished = runner(tmp_path, act)
    assert [table[0, 1] for table in finished.run(jobs(1.0, 2.0, 3.0, 4.0))] == [1.0, 2.0, 3.0, 4.0]
    # which of the two was done before the interruption is the machine's choice
    assert 1 in [ran(tmp_path).count(one) for one in ("3.0", "4.0")]
    assert threading.active_count() < 10


def test_runs_go_side_by_side(tmp_path: Path) -> None:
    """Each of two waits for the other, which only ends where both are at work at once."""
    act = (
        'open(f"{campaign}/at{p}", "w").close()\n'
        'while not all(os.path.exists(f"{campaign}/at{q}") for q in (1.0, 2.0)): time.sleep(0.01)'
    )
    assert len(runner(tmp_path, act, workers=2, timeout_s=20.0).run(jobs(1.0, 2.0))) == 2


def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    made = runner(tmp_path)
    text = (tmp_path / "SIM.toml").read_text().replace(json.dumps(sys.executable), '"no-such-simulator"')
    (tmp_path / "SIM.toml").write_text(text)
    made.settings = read_settings(tmp_path / "SIM.toml")
    with pytest.raises(BadInputError, match="no program 'no-such-simulator'"):
        made.run(jobs(1.0))


def test_nothing_is_kept_where_the_cache_is_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CALIB_CACHE", "off")
    for _ in range(2):
        runner(tmp_path).run(jobs(1.0))
    assert ran(tmp_path) == ["1.0", "1.0"]
    assert os.environ["CALIB_CACHE"] == "off"
