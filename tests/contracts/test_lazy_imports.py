"""Naming a command imports nothing heavy: what it computes with is imported when it runs."""

from __future__ import annotations

import subprocess
import sys

from calib.cli import COMMANDS, module_of

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
MODULES = ("calib", "calib.cli.main", "calib.runtime", *sorted({module_of(name) for name in COMMANDS}))


def test_importing_the_front_imports_nothing_heavy() -> None:
    """Package, runtime and every command's module together; each names itself where it imports something heavy."""
    # typer parses arguments with pydantic of its own accord; what counts is what comes on top
    program = (
        "import importlib, sys, typer\n"
        f"for module in {MODULES!r}:\n"
        "    before = set(sys.modules)\n"
        "    importlib.import_module(module)\n"
        f"    heavy = [name for name in {HEAVY!r} if name in set(sys.modules) - before]\n"
        "    print(*[f'{module}:{name}' for name in heavy])"
    )
    imports = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert imports.stdout.split() == []


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
