"""Functions fit on a screen and files can be read in one go; what cannot is named here, one by one, with the reason."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "calib"
SOURCES = sorted(PACKAGE.rglob("*.py"))

#: lines of a function without its docstring, and of a file
MOST_IN_FUNCTION: Final = 60
MOST_IN_FILE: Final = 400


#: functions that are longer, and why
LONG_FUNCTIONS: Final[dict[str, str]] = {}

#: files that are longer, and why
LONG_FILES: Final[dict[str, str]] = {}


def long_functions(path: Path) -> Iterator[tuple[str, int]]:
    """Yield the functions of a file that are too long, by place and name, and their lines."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0]
        documented = ast.get_docstring(node) is not None
        lines = node.end_lineno - node.lineno + 1 - (first.end_lineno - first.lineno + 1 if documented else 0)
        if lines > MOST_IN_FUNCTION:
            yield f"{path.relative_to(PACKAGE).as_posix()}:{node.name}", lines


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_function_fits_on_a_screen(path: Path) -> None:
    """No function has more than 60 lines beside its docstring, but for those named above."""
    too_long = {place: lines for place, lines in long_functions(path) if place not in LONG_FUNCTIONS}
    assert not too_long, f"longer than {MOST_IN_FUNCTION} lines: {too_long}"


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_file_can_be_read_in_one_go(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").count("\n")
    allowed = path.relative_to(PACKAGE).as_posix() in LONG_FILES
    assert allowed or lines <= MOST_IN_FILE, f"{lines} lines"


def test_the_measure_counts_lines_but_not_the_docstring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """61 lines of code are too many, 60 are not, whatever the docstring's length."""
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path)
    docstring = '    """' + "\n    word" * 30 + '\n    """\n'
    for lines, found in ((60, 0), (61, 1)):
        file = tmp_path / f"with{lines}.py"
        file.write_text("def f():\n" + docstring + "    x = 1\n" * (lines - 1), encoding="utf-8")
        assert len(list(long_functions(file))) == found
