"""What a command costs beyond the imports it cannot do without; ratios of processes started in turns."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

ROUNDS = 7
#: what the work itself is done with: arguments parsed (typer does it with pydantic), tables read, the fit, tables shown
NEEDED = (
    "import typer, numpy, pandas, statsmodels.regression.linear_model, rich.console, rich.table; "
    "from pydantic import TypeAdapter"
)


def _seconds(arguments: list[str], cwd: Path) -> float:
    """Return the processor's seconds of a process: those of the clock where nothing else runs, its own elsewhere."""
    # one thread for both: idle threads of a linear algebra library fight over a busy machine
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], cwd=cwd, check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _ratio(ours: list[str], reference: list[str], cwd: Path) -> float:
    """Best of several each, in turns after one of each unmeasured, so that a busy machine meets both alike."""
    _seconds(reference, cwd), _seconds(ours, cwd)
    pairs = [(_seconds(reference, cwd), _seconds(ours, cwd)) for _ in range(ROUNDS)]
    bare, command = (min(column) for column in zip(*pairs, strict=True))
    return command / bare


def test_help_takes_at_most_1_4_times_the_import_of_typer(project_root: Path) -> None:
    ratio = _ratio(["-m", "calib", "--help"], ["-c", "import typer"], project_root)
    assert ratio <= 1.4, f"calib --help takes {ratio:.2f} times as long as import typer"


def test_fit_takes_at_most_1_25_times_the_imports_it_needs(project_root: Path) -> None:
    if not (project_root / "sample_runs" / "corridor").is_dir():
        pytest.skip("the sample campaign is not here: sample_runs/corridor")
    ratio = _ratio(["-m", "calib", "fit", "sample_runs/corridor"], ["-c", NEEDED], project_root)
    assert ratio <= 1.25, f"calib fit takes {ratio:.2f} times as long as the imports it needs"
