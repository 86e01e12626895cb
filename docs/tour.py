# ruff: noqa: T201  (a script shows what it does)
"""Run every command that the README and the site show and put its real output beneath it: ``python docs/tour.py``.

A block that begins with ``console`` after its fence holds commands, each in a line that begins with ``$``; what stands
between them is replaced by what they print. ``--only WORD`` runs the blocks that hold the word; ``--check`` writes
nothing and ends with status 1 where a page no longer shows what the commands print.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: pages in the order in which a reader meets them: later ones use what earlier commands wrote
PAGES = tuple(
    ROOT / name
    for name in (
        "README.md",
        "docs/start.md",
        "docs/verdicts.md",
        "docs/planning.md",
        "docs/exports.md",
        "docs/commands.md",
    )
)
BLOCK = re.compile(r"(?<=^```console\n).*?(?=^```$)", re.MULTILINE | re.DOTALL)
PROMPT = "$ "


def commands_of(block: str) -> list[str]:
    """Return the commands of a block, without the prompt."""
    return [line.removeprefix(PROMPT) for line in block.splitlines() if line.startswith(PROMPT)]


def output_of(command: str) -> str:
    """Return what a command prints, run in the project's folder with the ``calib`` of this interpreter."""
    paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "PATH": paths, "PYTHONUTF8": "1"}
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    return "\n".join(lines).strip("\n")


def renewed(text: str, wanted: Callable[[str], bool]) -> str:
    """Return a page with the output of the blocks that are `wanted` made again."""

    def make(found: re.Match[str]) -> str:
        block = found.group(0)
        if not wanted(block):
            return block
        shown = []
        for command in commands_of(block):
            print(f"$ {command}", file=sys.stderr, flush=True)
            shown.append(f"{PROMPT}{command}\n{output_of(command)}".rstrip())
        return "\n\n".join(shown) + "\n"

    return BLOCK.sub(make, text)


def main() -> int:
    """Renew the pages, or say which are out of date."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="WORD", default="", help="only blocks that hold the word")
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 where something would change")
    given = parser.parse_args()
    stale = []
    for page in PAGES:
        before = page.read_text(encoding="utf-8")
        after = renewed(before, lambda block: given.only in block)
        if after != before:
            stale.append(page.relative_to(ROOT).as_posix())
            if not given.check:
                page.write_text(after, encoding="utf-8")
    if given.check:
        print(f"out of date: {', '.join(stale)}; run python docs/tour.py" if stale else "all pages are up to date")
    return int(bool(stale) and given.check)


if __name__ == "__main__":
    sys.exit(main())
