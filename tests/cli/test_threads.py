"""Commands of many small matrices keep linear algebra to one thread, before numpy is there, and let users overrule."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from calib.cli.threads import SETTINGS, one_blas_thread

#: what a command leaves in the environment, and whether numpy was there when the setting was made
PROBE = """
import sys
import calib.cli.threads as threads
seen = []
plain = threads.one_blas_thread
def watched():
    seen.append("numpy" in sys.modules)
    plain()
threads.one_blas_thread = watched
from calib.cli.main import run
import os
run(sys.argv[1:])
sys.stdout.write(f"{seen} {os.environ.get('OMP_NUM_THREADS')}")
"""


@pytest.mark.parametrize(
    "arguments",
    [
        ["diagnose", "nowhere"],
        ["plan", "nowhere"],
        ["report", "nowhere", "--diagnosis"],
        ["challenge", "run", "nowhere"],
    ],
)
def test_the_setting_is_made_before_numpy(arguments: list[str], tmp_path: Path) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in SETTINGS}
    command = [sys.executable, "-c", PROBE, *arguments]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.endswith("[False] 1")


def test_what_the_user_set_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    one_blas_thread()
    assert [os.environ[name] for name in SETTINGS] == ["3", "1", "1"]
