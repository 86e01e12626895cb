"""The plants share no code with what they check."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PLANT = ROOT / "calib" / "plant"
CONTACT = ROOT / "tests" / "plant" / "contact"
FORBIDDEN = {"motion", "gap", "radius", "coefficients", "runtime", "report"}


def _imported(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


#: modules of both plants; what stands beside them in the contact plant's folder are tests and scripts
SOURCES = [*sorted(PLANT.rglob("*.py")), *sorted(set(CONTACT.glob("*.py")) - set(CONTACT.glob("test_*.py")))]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_plant_imports_nothing_of_the_simulator_or_the_diagnosis(path: Path) -> None:
    strangers = {name for name in _imported(path) if name.startswith("calib.") and name.split(".")[1] in FORBIDDEN}
    assert not strangers


def test_the_plant_computes_its_own_wheel_loads() -> None:
    """Even the static loads are the plant's own: `calib.vehicle` gives it the geometry only."""
    names = {name for path in PLANT.glob("**/*.py") for name in _imported(path)}
    assert "calib.vehicle.wheel_loads_N" not in names
