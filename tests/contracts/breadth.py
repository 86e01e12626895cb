"""How many files and dataclasses a command runs through: ``python -m tests.contracts.breadth``.

Counted are the modules of calib that a command has imported when it ends, ``__init__`` files aside, and the dataclasses
that they define.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[2]
#: name -> arguments; ``OUT`` is a folder that is removed again
COMMANDS: Final = {
    "fit": ["fit", "sample_runs/corridor_crossed", "--json", "OUT/fit.json"],
    "report": ["report", "sample_runs/corridor_crossed", "--into", "OUT/report.pdf"],
    "diagnose": ["diagnose", "sample_runs/yard", "--json", "OUT/diagnosis.json"],
    "geometry": ["geometry", "sample_runs/yard", "--json", "OUT/geometry.json"],
    "ingest": ["ingest", "sample_runs/yard/runs.csv", "--describe", "--json", "OUT/files.json"],
}
_COUNT: Final = """
import dataclasses, json, sys
from calib.cli.main import run
run(sys.argv[1:])
loaded = [m for name, m in sorted(sys.modules.items()) if name.startswith("calib.")]
modules = [m for m in loaded if not m.__file__.endswith("__init__.py")]
classes = {c for m in modules for c in vars(m).values() if isinstance(c, type) and dataclasses.is_dataclass(c)}
mine = [c for c in classes if c.__module__.startswith("calib")]
sys.stderr.write("\\n" + json.dumps([len(modules), len(mine)]))
"""


def breadth(arguments: list[str]) -> tuple[int, int]:
    """Return the files and the dataclasses that a command runs through."""
    done = subprocess.run(
        [sys.executable, "-c", _COUNT, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    files, classes = json.loads(done.stderr.splitlines()[-1])
    return int(files), int(classes)


def main() -> None:
    """Print a row a command."""
    sys.stdout.write("| command | files | dataclasses |\n|---|---|---|\n")
    with tempfile.TemporaryDirectory() as out:
        for name, arguments in COMMANDS.items():
            files, classes = breadth([word.replace("OUT", out) for word in arguments])
            sys.stdout.write(f"| {name} | {files} | {classes} |\n")


if __name__ == "__main__":
    main()
