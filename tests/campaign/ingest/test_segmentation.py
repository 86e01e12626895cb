"""Each rule of segmentation finds the runs; poses and ranges count from the start of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.campaign.ingest.build import ingest
from calib.campaign.ingest.logs import read_mapped
from calib.campaign.ingest.mapping import Segmentation, parse_section, read_mapping
from calib.campaign.ingest.segmentation import end_values, find_runs, from_start
from calib.campaign.model import Border
from calib.campaign.settings_file import parse_settings
from calib.errors import BadFileError

M_PER_COUNT = 0.001
EPOCH = 1_777_888_999_000_000_000


def _log() -> dict[str, np.ndarray]:
    """Stands of 5 s, drives of 10 s at 1 m/s, at 10 Hz: drives from 5 to 15, 20 to 30, 35 to 45 s."""
    time = np.arange(0, 50, 0.1)
    speed = np.where((time % 15 >= 5) & (time < 45), 1000.0, 0.0)
    counts = np.cumsum(speed) * 0.1
    return {"t_s": time, "counts_left": counts, "counts_right": counts + (np.arange(len(time)) % 2)}


def _spans(cut: Segmentation, log: dict[str, np.ndarray]) -> list[tuple[float, float]]:
    runs = find_runs(cut, log, m_per_count=M_PER_COUNT, start_ns=EPOCH, shown="log")
    return [(float(log["t_s"][run][0]), float(log["t_s"][run][-1])) for run in runs]


def test_at_stops_with_a_standstill_at_both_ends() -> None:
    """A toggling count is no drive; a standstill of a second and a half at most is kept at both ends."""
    spans = _spans(Segmentation(by="stops", min_stop_s=2.0), _log())
    assert len(spans) == 3
    for (start, end), true in zip(spans, (5, 20, 35), strict=True):
        assert true - 1.5 <= start < true
        assert true + 10 <= end <= true + 11.5


def test_a_short_stop_ends_no_run() -> None:
    assert len(_spans(Segmentation(by="stops", min_stop_s=8.0), _log())) == 1


def test_by_length_of_path_and_of_time() -> None:
    assert len(_spans(Segmentation(by="length", length_m=5.0), _log())) == 6
    assert _spans(Segmentation(by="length", length_s=25.0, min_length_m=0.0), _log()) == [
        (0.0, pytest.approx(24.9)),
        (pytest.approx(25.0), pytest.approx(49.9)),
    ]


def test_by_a_column_zero_and_empty_between() -> None:
    log = _log()
    number = np.zeros(len(log["t_s"]))
    number[40:160], number[190:310] = 1, 2
    number[340:460] = np.nan
    assert _spans(Segmentation(by="column", column="run"), log | {"cut": number}) == [
        (pytest.approx(4.0), pytest.approx(15.9)),
        (pytest.approx(19.0), pytest.approx(30.9)),
    ]


def test_by_times_in_seconds_and_of_the_clock() -> None:
    """1777888999 s is 2026-05-04T10:03:19Z."""
    times = [[4.0, 16.0], ["2026-05-04T12:03:38+02:00", "2026-05-04T10:03:50Z"]]
    assert _spans(Segmentation(by="times", times=times), _log()) == [
        (pytest.approx(4.0), pytest.approx(16.0)),
        (pytest.approx(19.0), pytest.approx(31.0)),
    ]


@pytest.mark.parametrize(
    ("section", "match"),
    [
        ({"by": "stop"}, "cut.by"),
        ({"by": "length"}, "cut.length_m"),
        ({"by": "length", "length_m": 1, "length_s": 1}, "cut.length_m"),
        ({"by": "column"}, "cut.column"),
        ({"by": "times"}, "cut.times"),
        ({"by": "times", "times": [1, 2]}, "cut.times"),
        ({"min_stop_s": -1}, "cut.min_stop_s"),
        ({"minimum": 1}, "cut.minimum"),
    ],
)
def test_a_wrong_section_is_named(section: dict[str, object], match: str) -> None:
    with pytest.raises(BadFileError, match=match):
        parse_section(Segmentation, section, "mapping", "cut")


def test_times_outside_the_recording_are_refused() -> None:
    with pytest.raises(BadFileError, match="no samples from 90 to 95; it spans 0 to 49"):
        _spans(Segmentation(by="times", times=[[90, 95]]), _log())


def _run(first_known: int) -> dict[str, np.ndarray]:
    """A straight drive of 2 m, standstills of two seconds at both ends, in a frame turned by 30 degrees and shifted."""
    time = np.arange(0, 8, 0.1)
    along = np.clip(time - 2.0, 0.0, 4.0) * 0.5
    angle = np.pi / 6
    columns = {
        "t_s": time,
        "counts_left": np.round(1000 * along),
        "counts_right": np.round(1000 * along),
        "range_m": 7.0 - along,
        "ref_x_m": 3.0 + along * np.cos(angle),
        "ref_y_m": -1.0 + along * np.sin(angle),
        "ref_theta_rad": np.full(len(time), angle),
    }
    for name in ("range_m", "ref_x_m", "ref_y_m", "ref_theta_rad"):
        columns[name][:first_known] = np.nan
    return columns


@pytest.mark.parametrize("first_known", [0, 5])
def test_a_straight_drive_lies_on_the_x_axis(first_known: int) -> None:
    turned = from_start(_run(first_known), poses=True, distance=True)
    ends = end_values(turned)
    assert ends["distance_m"] == pytest.approx(2.0)
    assert (ends["ref_x_m"], ends["ref_y_m"], ends["ref_theta_rad"]) == pytest.approx((2.0, 0.0, 0.0), abs=1e-12)


def test_a_reference_that_starts_after_the_wheels_counts_from_its_first_pose() -> None:
    """A sample that is missing at the start does not empty the path."""
    turned = from_start(_run(30), poses=True, distance=True)
    assert np.isfinite(turned["ref_x_m"][30:]).all()
    assert turned["ref_x_m"][30] == pytest.approx(0.0, abs=1e-12)


#: a turn on the spot between standstills, one a run: radians
TURNS = (2 * np.pi, -2 * np.pi, 0.5)


def _turning(start: float, step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and the heading of three turns on the spot of 20 s each, with standstills of 5 s around them."""
    time = np.arange(0.0, 80.0, step_s)
    inside = [np.clip((time - 5.0 - 25.0 * number) / 20.0, 0.0, 1.0) for number in range(len(TURNS))]
    return time, start + np.dot(TURNS, inside)


def _written(path: Path, columns: dict[str, np.ndarray]) -> Path:
    np.savetxt(path, np.column_stack(list(columns.values())), "%.5f", ",", header=",".join(columns), comments="")
    return path


@pytest.mark.parametrize("start", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("unit", ["rad", "deg"])
@pytest.mark.parametrize("wrapped", [True, False])
def test_whole_turns_of_a_wrapped_heading_are_kept(start: float, unit: str, wrapped: bool, tmp_path: Path) -> None:
    """A recording cut into runs states the turn of each run from any start heading, wrapped or not."""
    time, heading = _turning(start, 0.05)
    yaw = np.angle(np.exp(1j * heading)) if wrapped else heading
    wheel = np.round(4096 * 0.25 * (heading - start) / (2 * np.pi * 0.1))
    columns = {"t_s": time, "counts_left": -wheel, "counts_right": wheel, "x [m]": 0.0 * time, "y [m]": 0.0 * time}
    columns[f"yaw [{unit}]"] = np.degrees(yaw) if unit == "deg" else yaw
    source = _written(tmp_path / "turns.csv", columns)
    mapping = tmp_path / "m.toml"
    mapping.write_text(
        '[vehicle]\ndrive = "differential"\n[encoder]\ncounts_per_rev = 4096\n[log]\nref_x_m = "x [m]"\n'
        f'ref_y_m = "y [m]"\nref_theta_rad = "yaw [{unit}]"\n[cut]\nby = "stops"\n'
        "min_stop_s = 2.0\nmin_length_m = 0.01\n"
    )
    found = ingest([source], tmp_path / "c", mapping=mapping).campaign.runs.number("ref_theta_rad")
    assert found == pytest.approx(TURNS, abs=1e-3)


def test_a_wrapped_heading_of_another_file_is_not_interpolated_across_its_jump(tmp_path: Path) -> None:
    """A heading at other times than the wheels' is joined to them without samples that it never had."""
    time, heading = _turning(3.0, 0.05)
    wheel = np.round(4096 * 0.25 * (heading - 3.0) / (2 * np.pi * 0.1))
    wheels = _written(tmp_path / "w.csv", {"t_s": time, "counts_left": -wheel, "counts_right": wheel})
    own, turned = _turning(3.0, 0.031)
    pose = {"t_s": own, "x": 0.0 * own, "y": 0.0 * own, "yaw": np.degrees(np.angle(np.exp(1j * turned)))}
    camera = _written(tmp_path / "m.csv", pose)
    mapping = tmp_path / "m.toml"
    mapping.write_text(
        '[log]\nfiles = {w = "w{n}.csv", m = "m{n}.csv"}\ncounts_left = "w:counts_left"\n'
        'counts_right = "w:counts_right"\nref_x_m = "m:x"\nref_y_m = "m:y"\n'
        'ref_theta_rad = {column = "m:yaw", unit = "deg"}\n'
    )
    read = read_mapping(mapping)
    settings = parse_settings(read.settings, read.shown, "c")
    joined = read_mapped({"w": wheels, "m": camera}, read, settings, Border(lenient=False))
    theta = joined.columns["ref_theta_rad"]
    assert np.nanmax(np.abs(theta - np.interp(joined.columns["t_s"], time, heading))) < 0.01
