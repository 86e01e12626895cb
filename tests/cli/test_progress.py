"""How far a command is: on standard error, where that is a terminal, and nowhere else."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.diagnose import diagnose_in_full
from calib.types import stepped

Told = list[tuple[int, int, str]]


@pytest.fixture(scope="module")
def read(project_root: Path) -> tuple[Campaign, Told]:
    told: Told = []
    campaign = read_campaign(project_root / "sample_runs" / "yard", progress=lambda *step: told.append(step))
    return campaign, told


def test_steps_are_told_before_each_and_at_the_end() -> None:
    told: Told = []
    assert list(stepped("ab", lambda *step: told.append(step), "letters")) == ["a", "b"]
    assert told == [(0, 2, "letters"), (1, 2, "letters"), (2, 2, "letters")]


def test_reading_tells_each_log(read: tuple[Campaign, Told]) -> None:
    campaign, told = read
    n_logs = int(campaign.logs.present.sum())
    assert told == [(number, n_logs, "logs") for number in range(n_logs + 1)]


def test_a_diagnosis_tells_its_stages(read: tuple[Campaign, Told]) -> None:
    """A few runs are enough: passes of the search, counted without a known end, then the verdict."""
    told: Told = []
    few = read[0].select(range(12))
    diagnose_in_full(few, plan=False, progress=lambda *step: told.append(step))
    searching = [done for done, total, stage in told if stage == "search of causes" and total == 0]
    assert searching == list(range(1, len(searching) + 1))
    assert told[-1][2] == "verdict"


def test_a_terminal_sees_it_and_a_file_does_not(project_root: Path, tmp_path: Path) -> None:
    """Standard error is a pseudo-terminal; what goes to standard output is what people read, without an escape."""
    ours, theirs = pty.openpty()
    with (tmp_path / "out").open("wb") as out:
        command = [sys.executable, "-m", "calib", "check", "sample_runs/corridor"]
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80"}
        running = subprocess.Popen(command, cwd=project_root, env=environment, stdout=out, stderr=theirs)
        os.close(theirs)
        seen = b""
        while True:
            try:
                data = os.read(ours, 4096)
            except OSError:
                # the other end is closed
                break
            if not data:
                break
            seen += data
        assert running.wait() == 0
    os.close(ours)
    assert b"checking" in seen
    assert b"\x1b" not in (tmp_path / "out").read_bytes()
