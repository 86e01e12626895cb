"""SIM.toml and the table that a simulator writes: what is wrong is named, with what was expected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.errors import BadFileError
from calib.gap.simulator import BadTableError, read_settings, read_table, written_wrong

SOUND = """
command = ["sim", "{campaign}", "{parameters}", "{out}"]
[[parameter]]
name = "r"
nominal = 0.1
step = 0.0005
largest = 0.01
"""


def test_a_sound_file_has_the_defaults_of_the_manual(tmp_path: Path) -> None:
    path = tmp_path / "SIM.toml"
    path.write_text(SOUND)
    settings = read_settings(path)
    assert settings.nominal == {"r": 0.1}
    assert settings.timeout_s == 600.0
    assert (settings.parameters[0].unit, settings.parameters[0].sign, settings.parameters[0].effect) == ("1", 0, "")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{out}", "out", "no {out}"),
        ("{parameters}", "p", "no {parameters}"),
        ('command = ["sim"', 'command = "sim {out}" #', "command"),
        (
            "step = 0.0005",
            "step = 0",
            "found step = 0; expected a change from nominal, not 0 and 0.01 (largest) at most",
        ),
        ("step = 0.0005", "step = 0", "give step = 0.0005, for one"),
        ("step = 0.0005", 'step = "0.0005"', "step: found '0.0005'; expected a valid number"),
        ("largest = 0.01", "largest = true", "largest: found True; expected a valid number"),
        ("step = 0.0005", "step = 0.02", "step = 0.02"),
        ("step = 0.0005", "step = nan", "finite"),
        ("step = 0.0005", "step = 0.0005\nsign = -1", "sign that is physical"),
        ("step = 0.0005", 'step = 0.0005\neffect = "no_effect"', "no_effect"),
        ("step = 0.0005", "step = 0.0005\nsteps = 3", "no such key"),
        ("step = 0.0005", "", "a value"),
        ("largest = 0.01", "largest = -1", "greater than 0"),
        ('name = "r"', 'name = "a b"', "name"),
        ("largest = 0.01", 'largest = 0.01\n[[parameter]]\nname="r"\nnominal=1\nstep=0.1\nlargest=1', "twice"),
        ("[[parameter]]", "[[parameter", "TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "SIM.toml"
    assert old in SOUND
    path.write_text(SOUND.replace(old, new))
    with pytest.raises(BadFileError) as caught:
        read_settings(path)
    text = str(caught.value)
    assert words in text
    assert "SIM.toml" in text
    assert "\n" not in text


def test_a_folder_and_a_missing_file_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.toml"):
        with pytest.raises(BadFileError):
            read_settings(path)


def test_a_table_is_read_by_run_and_further_rows_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("sim_theta_rad,run_id,sim_x_m,mine\n0.5,b,2,z\n,c,,\n0.25,a,1,y\n")
    table = read_table(path, ["a", "b"])
    assert np.array_equal(table[:, 1], [1.0, 2.0])
    assert np.array_equal(table[:, 3], [0.25, 0.5])
    assert np.isnan(table[:, [0, 2]]).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "columns none"),
        ("run_id,x\na,1\n", "run_id and some of"),
        ("run_id,sim_x_m,sim_x_m\na,1,1\n", "columns"),
        ("run_id,sim_x_m\na,1\n", "no row for 1 of 2 runs (b first)"),
        ("run_id,sim_x_m\na,1\nb,nan\n", "'nan' in run b"),
        ("run_id,sim_x_m\na,1\nb,1e9\n", "'1e9' in run b"),
        ("run_id,sim_x_m\na,1\nb,ten\n", "'ten' in run b"),
        ("run_id,sim_x_m\na,1\na,1\nb,1\n", "a twice"),
        ("run_id,sim_x_m\na\nb,1\n", "1 cells in row 2"),
    ],
)
def test_a_table_of_nonsense_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "out.csv"
    path.write_text(text)
    with pytest.raises(BadTableError) as caught:
        read_table(path, ["a", "b"])
    assert words in str(caught.value)
    assert "expected" in str(caught.value)


def test_an_empty_cell_is_a_number_that_is_not_predicted(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("run_id,sim_distance_m,sim_x_m\na,,2\nb,3,4\n")
    np.testing.assert_array_equal(read_table(path, ["a", "b"])[:, :2], [[np.nan, 2.0], [3.0, 4.0]])


@pytest.mark.parametrize(
    ("written", "words"),
    [
        (lambda e: e * [1e3, 1e3, 1e3, 1.0], "millimetres"),
        (lambda e: e * [1.0, 1.0, 1.0, 180.0 / np.pi], "degrees"),
        (lambda e: e * [1.0, 1.0, -1.0, 1.0], "y to the right"),
        (lambda e: e * [1.0, 1.0, 1.0, -1.0], "headings clockwise"),
        (lambda e: e * [1.0, 1.0, -1.0, -1.0], "to the other side"),
        (lambda e: e[:, [0, 2, 1, 3]] * [1.0, -1.0, 1.0, 1.0], "y ahead"),
        (lambda e: e[:, [0, 2, 1, 3]], "exchanged"),
        (lambda e: e * 1.02, ""),
        (lambda e: e[::-1], ""),
    ],
)
def test_what_a_simulator_writes_wrongly_is_named(written: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    """Ends of curves to both sides; radii off by two per cent, and runs in another order, are none of these."""
    ends = np.array([[8.0, 7.0, 3.0, 0.9], [5.0, 3.0, -3.5, -1.7], [12.0, 11.0, 2.0, 0.4], [6.0, 1.0, 4.0, 2.9]])
    found = written_wrong(written(ends), ends, 0.08)
    assert words in found and bool(words) == bool(found)
