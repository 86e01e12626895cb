from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from calib.coefficients.file import CoefficientFile

FOLDER = Path(__file__).resolve().parents[2] / "calib" / "runtime"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda p: p.name)
def test_the_runtime_imports_the_standard_library_and_itself_alone(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
        else:
            continue
        assert {name.partition(".")[0] for name in names} <= sys.stdlib_module_names


def test_a_copy_of_the_folder_under_another_name_drives_a_vehicle(file: CoefficientFile, tmp_path: Path) -> None:
    """In an interpreter without site packages."""
    shutil.copytree(FOLDER, tmp_path / "odometry_of_truck", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "c.json").write_bytes(file.to_bytes())
    program = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from odometry_of_truck import Odometer\n"
        "o = Odometer.from_file(sys.argv[1] + '/c.json')\n"
        "o.set_payload(120.0, 0.45, 0.02); o.update(0, 0); p = o.update(100, 100)\n"
        "assert 0.0 < p.x_m < 0.02 and o.covariance[2][2] > 0.0\n"
        "assert not {'calib', 'numpy', 'pydantic'} & set(sys.modules)\n"
    )
    command = [sys.executable, "-I", "-S", "-c", program, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
