"""The graph of imports: no circle between files or between folders, nothing imports what stands above it."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "calib"

# From the ground up: a file may import its own folder and those listed before it. Folders beside one another (the plant
# knows nothing of the diagnosis) have narrower rules in test_layers.
ORDER: Mapping[str, tuple[str, ...]] = {
    "calib": (
        "types",
        "errors",
        "arguments",
        "documents",
        "io",
        "units",
        "vehicle",
        "runtime",
        "campaign",
        "radius",
        "kinematics",
        "coefficients",
        "odometry",
        "plant",
        "gap",
        "fleet",
        "challenge",
        "reporting",
        "api",
        "cli",
        "__main__",
    ),
    "calib.gap": (
        "observations",
        "steps",
        "predict",
        "effects",
        "inference",
        "localise",
        "plan",
        "decision",
        "diagnose",
        "apply",
        "simulator",
    ),
}
# what stands in a folder's own __init__ is its front door: it may import all that is behind it
MOST_ARROWS_IN_GAP = 40

Graph = dict[str, set[str]]


def _module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imports(tree: ast.AST, known: Iterable[str], package: str) -> set[str]:
    """Return the modules that a file imports anywhere, in functions as well.

    What stands under ``if TYPE_CHECKING:`` counts too: a type that a file names is something that its reader has to
    know, and a circle of names is a circle to the reader.
    """
    names = set(known)
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *([base] if base else [])])
            found |= {f"{base}.{alias.name}" if f"{base}.{alias.name}" in names else base for alias in node.names}
    return found & names


def _graph() -> Graph:
    paths = {_module(path): path for path in sorted(PACKAGE.rglob("*.py"))}
    graph: Graph = {}
    for name, path in paths.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        # a folder's own __init__ gathers what its files hold; that is no dependence of the folder on itself
        graph[name] = _imports(ast.parse(path.read_text(encoding="utf-8")), paths, package) - {name}
    return graph


def _folders(graph: Graph, folder: str) -> Graph:
    """Return the arrows between what stands directly inside a folder."""
    inside = f"{folder}."
    folders: Graph = {}
    for source, targets in graph.items():
        for target in targets:
            if source.startswith(inside) and target.startswith(inside):
                ends = [name.removeprefix(inside).partition(".")[0] for name in (source, target)]
                if ends[0] != ends[1]:
                    folders.setdefault(ends[0], set()).add(ends[1])
    return folders


def _circle(graph: Graph) -> list[str]:
    """Return some circle of a graph as a list of its members, empty where there is none."""
    done: set[str] = set()

    def visit(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return []
        for target in sorted(graph.get(name, ())):
            circle = visit(target, [*way, name])
            if circle:
                return circle
        done.add(name)
        return []

    for name in sorted(graph):
        circle = visit(name, [])
        if circle:
            return circle
    return []


def _without_doors(graph: Graph) -> Graph:
    """Return the graph without the package's own front door, ``calib/__init__.py``, which leads to everything."""
    return {name: targets - {"calib"} for name, targets in graph.items() if name != "calib"}


@cache
def graph() -> Graph:
    """Return the graph of the package, made where it is first asked for: not by every process that collects tests."""
    return _without_doors(_graph())


def test_the_circle_finder_finds_circles() -> None:
    assert _circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert _circle({"a": {"b", "c"}, "b": {"c"}}) == []


def test_imports_are_seen_wherever_they_stand() -> None:
    text = "import a.b\ndef f():\n    from a import c\n    from . import d\nfrom a.e import name\n"
    assert _imports(ast.parse(text), ["a.b", "a.c", "a.d", "a.e"], "a") == {"a.b", "a.c", "a.d", "a.e"}


def test_no_circle_between_files() -> None:
    assert _circle(graph()) == []


def test_no_circle_between_folders() -> None:
    folders = sorted({name.rpartition(".")[0] for name in graph() if "." in name})
    assert [circle for folder in folders if (circle := _circle(_folders(graph(), folder)))] == []


@pytest.mark.parametrize("folder", ORDER)
def test_nothing_imports_what_stands_above_it(folder: str) -> None:
    height = {folder: number for number, folder in enumerate(ORDER[folder])}
    folders = _folders(graph(), folder)
    unknown = ({*folders} | {target for targets in folders.values() for target in targets}) - height.keys()
    assert not unknown, f"say in ORDER where {sorted(unknown)} stand"
    upward = [(a, b) for a, targets in folders.items() for b in targets if height[b] >= height[a]]
    assert upward == []


def test_few_arrows_inside_the_gap() -> None:
    arrows = [(a, b) for a, targets in _folders(graph(), "calib.gap").items() for b in targets]
    assert len(arrows) <= MOST_ARROWS_IN_GAP, sorted(arrows)
