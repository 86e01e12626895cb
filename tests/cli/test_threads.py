"""Linear algebra runs on one thread: set before numpy is imported, and the user's own setting wins."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from calib.cli.main import BLAS_THREADS, run

#: what a command leaves in the environment, and whether numpy was imported before it began
PROBE = """
import os, sys
from calib.cli.main import run
early = "numpy" in sys.modules
run(["diagnose", "nowhere"])
sys.stdout.write(f"{early} {os.environ['OMP_NUM_THREADS']}")
"""


def test_the_setting_precedes_numpy() -> None:
    environment = {key: value for key, value in os.environ.items() if key not in BLAS_THREADS}
    done = subprocess.run([sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "False 1"


def test_a_setting_of_the_user_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in BLAS_THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert run(["--version"]) == 0
    assert [os.environ[name] for name in BLAS_THREADS] == ["3", "1", "1"]
