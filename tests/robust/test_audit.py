"""What the audit of the installed packages says without a network."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
ALL = [{"introduced": "0"}]
BELOW = [{"introduced": "0"}, {"fixed": "0.0.1"}]


def advisory(name: str, events: list[dict[str, str]], **more: Any) -> dict[str, Any]:
    """Return an advisory as OSV writes them."""
    package = {"ecosystem": "PyPI", "name": name}
    return {
        "id": "TEST-1",
        "affected": [{"package": package, "ranges": [{"type": "ECOSYSTEM", "events": events}]}],
        **more,
    }


@pytest.mark.parametrize(
    ("records", "status", "words"),
    [
        ([advisory("NumPy", [{"fixed": "999"}, {"introduced": "0"}])], 1, f"numpy {version('numpy')}: TEST-1"),
        ([advisory("numpy", BELOW), advisory("absent-package", ALL)], 0, "2 advisories, 0 weaknesses"),
        ([advisory("numpy", ALL, withdrawn="2020-01-01")], 0, "0 weaknesses"),
        ([advisory("numpy", [{"introduced": "0"}, {"last_affected": version("numpy")}])], 1, "no version yet"),
        ([], 3, "NOT DONE"),
    ],
)  # fmt: skip
def test_an_advisory_speaks_of_the_versions_in_its_ranges(
    records: list[dict[str, Any]], status: int, words: str, tmp_path: Path
) -> None:
    """Open above and below, fixed, last affected, withdrawn; a file without any is no all-clear."""
    (tmp_path / "osv.json").write_text(json.dumps(records), encoding="utf-8")
    done = subprocess.run(
        [str(ROOT / ".ci" / "audit"), "--advisories", str(tmp_path / "osv.json")],
        env={**os.environ, "PYTHON": sys.executable},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout + done.stderr
    assert words in done.stdout
