"""A fuzz that stays: damaged files and options of every kind end in one helpful line, never in a traceback."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calib.cli import COMMANDS
from calib.coefficients.file import load_coefficients
from calib.documents import checksum
from tests.effort import EXPLORES
from tests.fuzz.answer import outcome
from tests.fuzz.damage import WORDS, damaged
from tests.fuzz.inputs import FILES, options, outcomes
from tests.fuzz.sound import prepared

#: inputs of the suite, in parts so that a fault names its part; the script takes as many as it is given
PARTS, OF_A_PART = 8, 225 if EXPLORES else 75
#: inputs with numbers alone, which reach further and take longer
QUANTITIES = 30
#: examples that hypothesis adds
TEXTS, NUMBERS = (100, 100) if EXPLORES else (40, 40)


@pytest.fixture(scope="module", autouse=True)
def _working_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Relative outputs of the commands go into a folder of the test's own."""
    with contextlib.chdir(tmp_path_factory.mktemp("fuzz_working_folder")):
        yield


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    yield prepared(tmp_path_factory.mktemp("fuzz") / "base")


@pytest.mark.parametrize("part", range(PARTS))
def test_damage_ends_in_one_line(part: int, base: Path) -> None:
    """Exit 0, 1, 2 or 130, no traceback, no more than ten seconds, one line about what to do."""
    faults = [
        f"input {number} of seed {part}: {result.arguments}: {fault}"
        for number, result, fault in outcomes(base, OF_A_PART, seed=part)
        if fault
    ]
    assert not faults, "\n".join(faults)


def test_numbers_that_nobody_means_end_in_one_line(base: Path) -> None:
    """One number of a sound command spoilt: in its options, a plan, a route, coefficients, a table, a log."""
    faults = [
        f"input {number}: {result.arguments}: {fault}"
        for number, result, fault in outcomes(base, QUANTITIES, seed=0, aim="quantities")
        if fault
    ]
    assert not faults, "\n".join(faults)


@given(text=st.text(min_size=0, max_size=40))
@settings(max_examples=TEXTS, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_text_as_a_run_id_is_data(text: str, base: Path) -> None:
    """What stands in a cell is shown as it stands, and steers nothing."""
    folder = base / "text"
    folder.mkdir(exist_ok=True)
    (folder / "campaign.toml").write_bytes((base / "C" / "campaign.toml").read_bytes())
    header, *rows = (base / "C" / "runs.csv").read_text(encoding="utf-8").splitlines()
    quoted = '"' + text.replace('"', '""') + '"'
    first = ",".join([quoted, *rows[0].split(",")[1:-1], ""])
    (folder / "runs.csv").write_text(
        "\n".join([header, first, *rows[3:]]), encoding="utf-8", errors="surrogatepass", newline=""
    )
    assert not outcome(["check", str(folder)]).fault


@given(command=st.sampled_from(sorted(COMMANDS)), values=st.lists(st.text(max_size=20), max_size=4))
@settings(max_examples=NUMBERS)
def test_any_words_are_refused_in_one_line(command: str, values: list[str]) -> None:
    """Arguments that nobody meant."""
    result = outcome([*command.split(), "--json", "-", *values])
    assert not result.fault, result.fault


def test_the_fuzz_reaches_every_command_and_format(base: Path) -> None:
    """Every command has options to be spoilt; every sound file is one, and its commands take it."""
    assert all(options(command) for command in COMMANDS)
    missing = [name for name in FILES if not (base / name).is_file()]
    assert not missing, missing


def test_a_file_without_the_sections_that_may_lack_is_sealed_anew(base: Path, tmp_path: Path) -> None:
    """What is written on from it carries a checksum that fits."""
    document = load_coefficients(base / "coefficients.json").to_dict()
    del document["effects"], document["checksum"]
    import json

    (tmp_path / "c.json").write_text(json.dumps(document | {"checksum": checksum(document)}), encoding="utf-8")
    file = load_coefficients(tmp_path / "c.json")
    assert file.checksum == checksum(file.to_dict())


def test_the_damage_is_the_same_for_the_same_number() -> None:
    """So that a fault can be looked at again."""
    assert damaged(b"abc" * 50, random.Random(3)) == damaged(b"abc" * 50, random.Random(3))
    assert len(set(WORDS)) == len(WORDS)
