"""What holds of every file that is written by hand: its length, and that it speaks of the project alone."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted((ROOT / "calib").rglob("*.py"))
MOST_LINES = 450
#: a folder of one machine: it holds nowhere else; placeholders such as /path/to are none
MACHINE = re.compile(r"(?<![\w.~<-])/(?:home|Users|root|opt|tmp|work|mnt)/\w")


def _written() -> list[Path]:
    """Return the files under version control; those of the folders where there is none (an unpacked archive)."""
    try:
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        files = [ROOT / line for line in listed.splitlines()]
    except (OSError, subprocess.CalledProcessError):
        files = [one for room in ("calib", "tests", "docs", "sample_runs") for one in (ROOT / room).rglob("*")]
    texts = {".py", ".md", ".toml", ".json", ".h", ".c", ".typ", ".yaml", ""}
    return [one for one in files if one.is_file() and one.suffix in texts and "__pycache__" not in one.parts]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_holds_one_idea(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


def test_no_file_names_a_folder_of_one_machine() -> None:
    found = []
    for path in _written():
        if path == Path(__file__).resolve():
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            if MACHINE.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}")
    assert not found


def test_the_package_carries_what_it_needs_beside_code() -> None:
    """Data files that code opens are inside the package, so that an installed wheel has them."""
    for name in (
        "py.typed",
        "coefficients/coefficients.schema.json",
        "coefficients/formats/c_runtime.h",
        "report/page.typ",
        "challenge/seeds/scoring.toml",
    ):
        assert (ROOT / "calib" / name).is_file(), name
