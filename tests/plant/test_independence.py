"""The plant shares no code with what it checks."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PLANT = Path(__file__).resolve().parents[2] / "calib" / "plant"
FORBIDDEN = {"motion", "gap", "radius", "coefficients", "runtime", "report"}


def _imported(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("path", sorted(PLANT.rglob("*.py")), ids=lambda p: str(p.relative_to(PLANT)))
def test_the_plant_imports_nothing_of_the_simulator_or_the_diagnosis(path: Path) -> None:
    strangers = {name for name in _imported(path) if name.startswith("calib.") and name.split(".")[1] in FORBIDDEN}
    assert not strangers


def test_the_plant_computes_its_own_wheel_loads() -> None:
    """Even the static loads are the plant's own: `calib.vehicle` gives it the geometry only."""
    names = {name for path in PLANT.glob("**/*.py") if "contact" not in path.parts for name in _imported(path)}
    assert "calib.vehicle.wheel_loads_N" not in names
