"""Who may import whom: data flow one way."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "calib"
SOURCES = sorted(PACKAGE.rglob("*.py"))

# A room may import the rooms listed for it (and itself), nothing else of the house.
GROUND = {"arrays", "errors", "units", "files", "folders", "limits", "progress", "seal", "vehicle"}
ALLOWED: dict[str, set[str]] = {
    # what is seen here are the names for type checkers; nothing is imported before it is used
    "__init__": {"api", "campaign", "results"},
    "arrays": set(),
    "errors": set(),
    "units": set(),
    "inputs": {"errors"},
    "leftovers": set(),
    "limits": {"errors"},
    "progress": set(),
    "seal": set(),
    "files": {"errors", "inputs", "leftovers"},
    "folders": {"errors", "files", "inputs", "leftovers"},
    "vehicle": {"arrays", "errors", "units"},
    "campaign": GROUND,
    "radius": GROUND | {"campaign"},
    "geometry": GROUND | {"campaign", "radius"},
    "coefficients": GROUND | {"__init__", "campaign", "radius", "geometry"},
    "motion": GROUND | {"campaign", "radius", "coefficients", "runtime"},
    "gap": GROUND | {"campaign", "radius", "coefficients", "motion"},
    "report": GROUND
    | {"__init__", "campaign", "radius", "geometry", "coefficients", "motion", "gap", "fleet", "challenge"},
    "fleet": GROUND | {"leftovers", "campaign", "radius", "geometry", "gap"},
    "runtime": set(),
    "plant": GROUND | {"campaign"},
    "challenge": GROUND | {"__init__", "campaign", "plant", "gap"},
    "results": GROUND | {"campaign", "radius", "geometry", "motion", "gap", "report"},
    "api": GROUND
    | {"__init__", "campaign", "radius", "geometry", "coefficients", "motion", "gap", "report", "results"},
    "cli": {"*"},
    "__main__": {"cli"},
}


def _imports(path: Path) -> set[str]:
    rooms = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names] if node.module == "calib" else [node.module]
        for name in names:
            parts = name.split(".")
            if parts[0] == "calib":
                rooms.add(parts[1] if len(parts) > 1 and parts[1] != "__version__" else "__init__")
    return rooms


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_room_imports_only_rooms_below_it(path: Path) -> None:
    parts = path.relative_to(PACKAGE).parts
    room = parts[0].removesuffix(".py")
    allowed = ALLOWED[room]
    strangers = _imports(path) - allowed - {room}
    assert "*" in allowed or not strangers, f"{path.name} imports {sorted(strangers)}"


SILENT = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] not in {"cli", "__main__.py"}]


@pytest.mark.parametrize("path", SILENT, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_the_command_line_prints_or_exits(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            assert name not in {"print", "exit", "quit", "sys.exit", "typer.echo", "input", "eval", "exec"}, name
            assert name not in {"pickle.load", "pickle.loads"}, name


def test_every_room_is_known() -> None:
    """A new folder has to say what it may import."""
    rooms = {p.name.removesuffix(".py") for p in PACKAGE.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()}
    assert rooms <= set(ALLOWED)
