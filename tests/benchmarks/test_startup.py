"""What a command costs beyond the imports it cannot do without; ratios of processes started in turns."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

#: at most; a machine that is busy with other things has quiet moments
ROUNDS = 40
#: what such work is commonly done with: arguments parsed (typer does it with pydantic), tables read and shown, a fit
NEEDED = (
    "import typer, numpy, pandas, statsmodels.regression.linear_model, rich.console, rich.table; "
    "from pydantic import TypeAdapter"
)


def _seconds(arguments: list[str], cwd: Path) -> float:
    """Return a process's own seconds on the processor; what it compiles is kept, as an installed tool's is."""
    # one thread for both: idle threads of a linear algebra library fight over a busy machine
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], cwd=cwd, check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _ratio(ours: list[str], reference: list[str], cwd: Path, limit: float) -> float:
    """Best of several each, in turns after one of each that compiles; no more turns than show the limit kept."""
    _seconds(reference, cwd), _seconds(ours, cwd)
    bare = command = float("inf")
    for _ in range(ROUNDS):
        bare = min(bare, _seconds(reference, cwd))
        command = min(command, _seconds(ours, cwd))
        if command <= limit * bare:
            break
    return command / bare


def test_help_takes_at_most_1_4_times_the_import_of_typer(project_root: Path) -> None:
    ratio = _ratio(["-m", "calib", "--help"], ["-c", "import typer"], project_root, 1.4)
    assert ratio <= 1.4, f"calib --help takes {ratio:.2f} times as long as import typer"


def test_fit_takes_little_more_than_the_imports_it_stands_on(project_root: Path) -> None:
    """Reading 60 logs, the fit with influence and heteroscedasticity, the tables: at most 0.4 of the imports."""
    if not (project_root / "sample_runs" / "corridor").is_dir():
        pytest.skip("the sample campaign is not here: sample_runs/corridor")
    ours, needed = ["-m", "calib", "fit", "sample_runs/corridor"], ["-c", NEEDED]
    ratio = _ratio(ours, needed, project_root, 1.4)
    assert ratio <= 1.4, f"calib fit takes {ratio:.2f} times as long as these imports"


def test_import_takes_at_most_1_2_times_bare_python_and_typing(project_root: Path) -> None:
    """The Python API is lazy: its functions import what they compute with when they are called."""
    ratio = _ratio(["-c", "import calib"], ["-c", "import typing"], project_root, 1.2)
    assert ratio <= 1.2, f"import calib takes {ratio:.2f} times as long as import typing"
