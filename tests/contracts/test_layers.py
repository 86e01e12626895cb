"""Who may import whom: data flow one way."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "calib"
SOURCES = sorted(PACKAGE.rglob("*.py"))

# A folder may import the folders listed for it (and itself), nothing else of the house.
GROUND = {"documents", "errors", "io", "types", "units", "vehicle"}
ALLOWED: dict[str, set[str]] = {
    # what is seen here are the names for type checkers; nothing is imported before it is used
    "__init__": {"api", "campaign", "documents", "gap", "kinematics", "odometry", "radius"},
    "errors": set(),
    "units": set(),
    # words and figures of a result are looked up by name at the first call: tests/test_result.py
    "documents": set(),
    "io": {"documents", "errors"},
    "types": set(),
    "vehicle": {"errors", "types", "units"},
    "campaign": GROUND,
    "radius": GROUND | {"campaign"},
    "kinematics": GROUND | {"campaign", "radius"},
    "coefficients": GROUND | {"__init__", "campaign", "radius", "kinematics"},
    "odometry": GROUND | {"campaign", "radius", "coefficients", "runtime"},
    "gap": GROUND | {"campaign", "radius", "kinematics", "coefficients", "odometry"},
    "reporting": GROUND
    | {"__init__", "campaign", "radius", "kinematics", "coefficients", "odometry", "gap", "fleet", "challenge"},
    "fleet": GROUND | {"campaign", "radius", "kinematics", "gap"},
    "runtime": set(),
    "plant": GROUND | {"campaign"},
    "challenge": GROUND | {"__init__", "campaign", "plant", "gap", "fleet"},
    "api": GROUND | {"__init__", "campaign", "radius", "kinematics", "coefficients", "odometry", "gap", "reporting"},
    "cli": {"*"},
    "__main__": {"cli"},
}


def _imports(path: Path) -> set[str]:
    folders = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names] if node.module == "calib" else [node.module]
        for name in names:
            parts = name.split(".")
            if parts[0] == "calib":
                folders.add(parts[1] if len(parts) > 1 and parts[1] != "__version__" else "__init__")
    return folders


def test_a_folder_imports_only_folders_below_it() -> None:
    for path in SOURCES:
        folder = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        allowed = ALLOWED[folder]
        strangers = _imports(path) - allowed - {folder}
        assert "*" in allowed or not strangers, f"{path.relative_to(PACKAGE)} imports {sorted(strangers)}"


SILENT = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] not in {"cli", "__main__.py"}]


FORBIDDEN = {"print", "exit", "quit", "sys.exit", "typer.echo", "input", "eval", "exec", "pickle.load", "pickle.loads"}


def test_only_the_command_line_prints_or_exits_and_nothing_evaluates() -> None:
    for path in SILENT:
        called = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Call(ast.Name(name)):
                    called.add(name)
                case ast.Call(ast.Attribute(ast.Name(name), attribute)):
                    called.add(f"{name}.{attribute}")
        assert called & FORBIDDEN == set(), path


def test_every_folder_is_known() -> None:
    """A new folder has to say what it may import."""
    folders = {
        p.name.removesuffix(".py") for p in PACKAGE.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists()
    }
    assert folders <= set(ALLOWED)
