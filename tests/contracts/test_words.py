"""One vocabulary: words that a robotics or metrology engineer would have to translate do not occur."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[2]

#: pattern -> what the field says
NOT_OURS: Final[dict[str, str]] = {
    r"\bnought\b": "zero",
    r"\bat hand\b": "current, present",
    r"\bdriven alike\b": "replicates",
    r"\bputs? (?:[\w' ]{1,40} )?right\b": "correct",
    r"\bstands? in for\b": "is confounded with, replaces",
    r"\bthe way in\b": "API",
    r"\b(?-i:whisker)\b": "a small ridge term",
    r"\bby a hair\b": "by a rounding error",
    r"\bgross (?:fault|gap|error)s?\b": "blunder",
    r"\bleft out\b": "held out, excluded, omitted",
    r"\blight(?:s|ed)? up\b|\blit up\b": "highlight",
    r"\bhauled\b": "guided",
    r"\bled straight\b": "guided",
    r"\bturn either way\b": "total absolute rotation",
    r"\bgoes with\b": "correlates with",
    r"\bof no kind\b|\bnobody says\b": "unspecified",
    r"\bcould not have shown\b": "detection limit",
    r"\bbeyond computing\b": "overflow",
    r"\bwhatsoever\b|\bwhatever\b|\bwhichever\b": "any; or leave it out",
    r"\bdo(?:es)? as well\b": "is an alternative explanation",
    r"\bleaves the same shape\b": "is collinear with",
    r"\bto the last digit\b": "stopped early",
    r"\btrack other than believed\b": "wrong track width",
    r"\bnats\b": "log-evidence",
}

#: any of them at once: most files have none
ANY: Final = re.compile("|".join(NOT_OURS), re.IGNORECASE)
#: where such a word is the thing itself
ALLOWED: Final[frozenset[str]] = frozenset({"tests/contracts/test_words.py"})


def _texts() -> list[Path]:
    try:
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        files = [ROOT / line for line in listed.splitlines()]
    except (OSError, subprocess.CalledProcessError):
        files = [one for folder in ("calib", "tests", "docs") for one in (ROOT / folder).rglob("*")]
    suffixes = {".py", ".md", ".typ", ".h", ".cff", ".html", ".j2", ".toml"}
    return [one for one in files if one.suffix in suffixes and one.is_file()]


def test_the_words_are_those_of_the_field() -> None:
    """Code, comments, messages, documentation and changelog alike."""
    places = []
    for path in _texts():
        if path.relative_to(ROOT).as_posix() in ALLOWED:
            continue
        text = path.read_text(encoding="utf-8")
        for number, line in enumerate(text.splitlines() if ANY.search(text) else (), start=1):
            places += [
                f"{path.relative_to(ROOT)}:{number}: {match.group()!r}, rather: {better}"
                for pattern, better in NOT_OURS.items()
                for match in re.finditer(pattern, line, re.IGNORECASE)
            ]
    assert not places, "\n".join(places)
