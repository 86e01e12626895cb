"""Naming a command imports nothing heavy: what it computes with is imported when it runs."""

from __future__ import annotations

import subprocess
import sys

import pytest

from calib.cli.main import COMMANDS

HEAVY = (
    "numpy",
    "pandas",
    "scipy",
    "statsmodels",
    "matplotlib",
    "pydantic",
    "typst",
    "pyarrow",
    "openpyxl",
    "mujoco",
    "numba",
)
MODULES = ("calib", "calib.cli.main", "calib.runtime", *(f"calib.cli.{name}" for name in COMMANDS.values()))


@pytest.mark.parametrize("module", MODULES)
def test_importing_it_imports_nothing_heavy(module: str) -> None:
    # typer parses arguments with pydantic of its own accord; what counts is what comes on top
    program = (
        "import sys, typer; before = set(sys.modules); "
        f"import {module}; "
        f"print(*(name for name in {HEAVY!r} if name in set(sys.modules) - before))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_the_vehicles_runtime_needs_nothing_but_python() -> None:
    """On the vehicle there is no package but the standard library."""
    program = (
        "import sys; import calib.runtime; "
        "print(*{name.split('.')[0] for name in sys.modules} - sys.stdlib_module_names - {'calib', '__main__'})"
    )
    # isolated, and without site: packages that are merely installed are not imported at start-up
    path = [one for one in sys.path if one]
    program = f"import sys; sys.path[:] = {path!r}; " + program
    found = subprocess.run([sys.executable, "-I", "-S", "-c", program], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []
