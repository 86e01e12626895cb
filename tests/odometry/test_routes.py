"""Routes: closed figures close, files are read or refused in words, recorded paths are followed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from calib.errors import BadFileError, BadInputError
from calib.odometry.poses import write_tum
from calib.odometry.routes import NAMED, find_route, read_route

ROUNDING_M = 1e-12

GOOD = """
format = "calib-route/1"
name = "dock"
[[segment]]
straight_m = 5.0
[[segment]]
radius_m = 3.0
turn_deg = 90
[[segment]]
straight_m = 5
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "route.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("name", "turn"), [("square_ccw", 2 * math.pi), ("square_cw", -2 * math.pi), ("figure8", 0.0)])
def test_closed_routes_close(name: str, turn: float) -> None:
    end = find_route(name).poses()[-1]
    np.testing.assert_allclose(end.stacked(), [0.0, 0.0, turn], rtol=0.0, atol=ROUNDING_M)


def test_a_route_file_says_the_same_as_the_named_route(tmp_path: Path) -> None:
    read, named = read_route(write(tmp_path, GOOD)), find_route("paper_route")
    np.testing.assert_allclose(read.length_m, named.length_m, rtol=1e-15)
    np.testing.assert_allclose(read.turn_rad, named.turn_rad, rtol=1e-15)
    assert read.name == "dock"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("calib-route/1", "route"), "calib-route/1"),
        (("straight_m = 5.0", "straight = 5.0"), "segment 1"),
        (("radius_m = 3.0", "radius_m = -3.0"), "radius_m"),
        (("turn_deg = 90", "turn_deg = nan"), "turn_deg"),
        (("turn_deg = 90", 'turn_deg = "90"'), "turn_deg"),
        (("straight_m = 5.0", "straight_m = 1e300"), "straight_m"),
        (("[[segment]]", "[[piece]]"), "segment"),
        (('name = "dock"', "name = 3"), "name"),
        (("radius_m = 3.0", "radius_m = "), "TOML"),
    ],
)
def test_route_files_that_cannot_be_used_are_refused_in_words(
    tmp_path: Path, change: tuple[str, str], words: str
) -> None:
    with pytest.raises(BadFileError, match=words):
        read_route(write(tmp_path, GOOD.replace(*change)))


def test_unknown_routes_are_refused_naming_the_known_ones() -> None:
    with pytest.raises(BadInputError, match="figure8"):
        find_route("spiral")
    with pytest.raises(BadFileError, match=r"missing\.toml"):
        find_route("missing.toml")


@pytest.mark.parametrize("name", NAMED)
def test_a_recorded_path_becomes_the_route_it_was(name: str, tmp_path: Path) -> None:
    fine = find_route(name).divided(0.1)
    path = write_tum(tmp_path / "driven.tum", fine.distance_m(), fine.poses())
    back = find_route(str(path))
    # the quaternion's yaw is read back to 1e-15, over arcs of 0.1 m
    np.testing.assert_allclose(back.length_m, fine.length_m, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(back.turn_rad, fine.turn_rad, rtol=0.0, atol=1e-12)


def test_turning_on_the_spot_stays_on_the_spot(tmp_path: Path) -> None:
    text = 'format = "calib-route/1"\n[[segment]]\nradius_m = 0\nturn_rad = 3.0\n'
    end = read_route(write(tmp_path, text)).poses()[-1]
    np.testing.assert_allclose(end.stacked(), [0.0, 0.0, 3.0], rtol=0.0, atol=ROUNDING_M)
