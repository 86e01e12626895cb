"""What holds of every file that is written by hand: its size, and that it speaks of the project alone."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "calib"
SOURCES = sorted(PACKAGE.rglob("*.py"))
#: lines of a function without its docstring: what fits on a screen
MOST_IN_FUNCTION: Final = 60
#: lines of a file: what can be read in one go
MOST_IN_FILE: Final = 400
#: lines below which a file is a fragment of another topic; a package's ``__init__`` may be shorter
LEAST_IN_FILE: Final = 25
#: a folder of one machine: it holds nowhere else; placeholders such as /path/to are none
MACHINE = re.compile(r"(?<![\w.~<-])/(?:home|Users|root|opt|tmp|work|mnt)/\w")


def _lines(path: Path) -> int:
    return path.read_text(encoding="utf-8").count("\n")


def _long_functions(text: str) -> Iterator[tuple[str, int]]:
    """Yield name and lines of the functions that are too long, docstrings aside."""
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0]
        documented = ast.get_docstring(node) is not None
        lines = node.end_lineno - node.lineno + 1 - (first.end_lineno - first.lineno + 1 if documented else 0)
        if lines > MOST_IN_FUNCTION:
            yield node.name, lines


def _tracked() -> list[Path]:
    """Return the files under version control; those of the folders where there is none (an unpacked archive)."""
    try:
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        files = [ROOT / line for line in listed.splitlines()]
    except (OSError, subprocess.CalledProcessError):
        files = [one for folder in ("calib", "tests", "docs", "sample_runs") for one in (ROOT / folder).rglob("*")]
    texts = {".py", ".md", ".toml", ".json", ".h", ".c", ".typ", ".yaml", ""}
    return [one for one in files if one.is_file() and one.suffix in texts and "__pycache__" not in one.parts]


def test_a_function_fits_on_a_screen() -> None:
    """No function has more than 60 lines beside its docstring."""
    too_long = [(path.name, *found) for path in SOURCES for found in _long_functions(path.read_text(encoding="utf-8"))]
    assert not too_long


def test_a_file_is_neither_a_fragment_nor_too_long_to_read() -> None:
    sizes = {path.relative_to(PACKAGE).as_posix(): _lines(path) for path in SOURCES}
    assert {name: lines for name, lines in sizes.items() if lines > MOST_IN_FILE} == {}
    fragments = {name: lines for name, lines in sizes.items() if lines < LEAST_IN_FILE and "__init__" not in name}
    assert fragments == {}


def test_the_measure_counts_lines_but_not_the_docstring() -> None:
    """61 lines of code are too many, 60 are not, however long the docstring is."""
    docstring = '    """' + "\n    word" * 30 + '\n    """\n'
    for lines, too_long in ((60, 0), (61, 1)):
        assert len(list(_long_functions("def f():\n" + docstring + "    x = 1\n" * (lines - 1)))) == too_long


def test_no_file_names_a_folder_of_one_machine() -> None:
    places = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}"
        for path in _tracked()
        if path != Path(__file__).resolve()
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if MACHINE.search(line)
    ]
    assert not places


def test_the_package_carries_what_it_needs_beside_code() -> None:
    """Data files that code opens are inside the package, so that an installed wheel has them."""
    for name in (
        "py.typed",
        "campaign/ingest/names.toml",
        "coefficients/formats/c_header.h.j2",
        "coefficients/formats/c_runtime.h",
        "coefficients/formats/ros2.yaml.j2",
        "reporting/exports/dcc.xml.j2",
        "reporting/exports/nav2.yaml.j2",
        "reporting/figures/calib.mplstyle",
        "reporting/page.typ",
        "reporting/page.html.j2",
        "reporting/panels.js",
        "reporting/words.toml",
    ):
        assert (PACKAGE / name).is_file(), name


def test_the_limits_of_a_verdict_are_eight_in_one_file_each_with_its_reason() -> None:
    """Others follow from these, or are usual: one in twenty, even odds, half."""
    path = PACKAGE / "gap" / "inference" / "__init__.py"
    lines, limits = path.read_text(encoding="utf-8").splitlines(), set[str]()
    for node in ast.parse("\n".join(lines)).body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Constant):
            limits.add(ast.unparse(node.target))
            assert lines[node.lineno - 2].startswith("#: "), ast.unparse(node)
    assert len(limits - {"FALSE_REJECTION", "EVEN_PROBABILITY", "HALF_CLOSURE"}) == 8


def _missing_imports(path: Path) -> Iterator[str]:
    """Yield what a file imports from the package that is not there."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").partition(".")[0] == "calib":
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names if not hasattr(module, alias.name)):
                if importlib.util.find_spec(f"{node.module}.{name}") is None:
                    yield f"{path.relative_to(ROOT)}: {node.module}.{name}"


def test_what_studies_and_samples_import_is_there() -> None:
    """No test runs every study; that their calls fit is what mypy checks."""
    files = (one for folder in ("tests", "docs", "sample_runs") for one in (ROOT / folder).rglob("*.py"))
    assert [missing for path in files for missing in _missing_imports(path)] == []
