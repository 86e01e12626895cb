"""What only an effect knows stands in `calib.gap.effects`: nowhere else is an effect called by its id."""

from __future__ import annotations

import ast
from pathlib import Path

from calib.gap.effects.library import REGISTRY

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "calib"
HOME = PACKAGE / "gap" / "effects"

# The outside plant bears the same ids by agreement and may not import the library; each of these files says why it has
# to name effects.
EXEMPT = {
    # which effects are planted with which, and which look alike by construction
    "challenge/__init__.py",
    # which planted effects have no sign, and what each needs to show
    "challenge/cases.py",
    # which of the plant's effects a replay of logged counts cannot drive
    "challenge/own_runs.py",
    # which planted parameter is which fitted one
    "challenge/judge.py",
    # a parameter of the vehicle, called in the geometry's format as the effect that a wrong one leaves
    "kinematics/drives.py",
    # the same effects without the library: the folder stands alone, tests/runtime/test_effects.py holds both together
    "runtime/effects.py",
    # the same in C: tests/coefficients/test_c_effects.py
    "coefficients/formats/for_vehicle.py",
}
PLANT = PACKAGE / "plant"

FILES = [
    path
    for path in sorted(PACKAGE.rglob("*.py"))
    if not path.is_relative_to(HOME) and not path.is_relative_to(PLANT) and str(path.relative_to(PACKAGE)) not in EXEMPT
]


def _ids(text: str) -> list[str]:
    return [
        f"line {node.lineno}: {node.value}"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and (node.value in REGISTRY or node.value.startswith("covariate:"))
    ]


def test_an_id_is_seen_as_one() -> None:
    assert _ids("if effect == 'load_radius':\n    pass") == ["line 1: load_radius"]
    assert _ids("x = 'covariate:' + column") == ["line 1: covariate:"]


def test_no_effect_is_called_by_its_id() -> None:
    called = {path.relative_to(PACKAGE).as_posix(): _ids(path.read_text(encoding="utf-8")) for path in FILES}
    assert {name: places for name, places in called.items() if places} == {}


def test_every_exemption_is_needed() -> None:
    assert all(_ids((PACKAGE / name).read_text(encoding="utf-8")) for name in EXEMPT)
