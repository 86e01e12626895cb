"""What a command costs beyond the imports it cannot do without; ratios of processes started in turns."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROUNDS = 7
#: libraries that the work itself is done with: the fit, the tables read, the tables shown
NEEDED = "import typer, numpy, pandas, statsmodels.regression.linear_model, rich.console, rich.table"


def _seconds(arguments: list[str], cwd: Path) -> float:
    # one thread for both: idle threads of a linear algebra library fight over a busy machine
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], cwd=cwd, check=True, stdout=subprocess.DEVNULL, env=environment)
    return time.perf_counter() - start


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
