"""Each way of cutting finds the runs that are there."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.ingest.cut import Cut, cut_pieces, parse_cut
from calib.errors import BadFileError

M_PER_COUNT = 0.001
EPOCH = 1_777_888_999_000_000_000


def _log() -> dict[str, np.ndarray]:
    """Stands of 5 s, drives of 10 s at 1 m/s, at 10 Hz: drives from 5 to 15, 20 to 30, 35 to 45 s."""
    time = np.arange(0, 50, 0.1)
    speed = np.where((time % 15 >= 5) & (time < 45), 1000.0, 0.0)
    counts = np.cumsum(speed) * 0.1
    return {"t_s": time, "counts_left": counts, "counts_right": counts + (np.arange(len(time)) % 2)}


def _spans(cut: Cut, log: dict[str, np.ndarray]) -> list[tuple[float, float]]:
    pieces = cut_pieces(cut, log, m_per_count=M_PER_COUNT, start_ns=EPOCH, shown="log")
    return [(float(log["t_s"][one.first]), float(log["t_s"][one.last])) for one in pieces]


def test_at_stops_with_rest_at_both_ends() -> None:
    """A toggling count is no drive; every run begins and ends at rest, at most a second and a half beside the drive."""
    spans = _spans(Cut(by="stops", min_stop_s=2.0), _log())
    assert len(spans) == 3
    for (start, end), true in zip(spans, (5, 20, 35), strict=True):
        assert true - 1.5 <= start < true
        assert true + 10 <= end <= true + 11.5


def test_a_short_stop_ends_no_run() -> None:
    assert len(_spans(Cut(by="stops", min_stop_s=8.0), _log())) == 1


def test_by_length_of_path_and_of_time() -> None:
    assert len(_spans(Cut(by="length", length_m=5.0), _log())) == 6
    assert _spans(Cut(by="length", length_s=25.0, min_length_m=0.0), _log()) == [
        (0.0, pytest.approx(24.9)),
        (pytest.approx(25.0), pytest.approx(49.9)),
    ]


def test_by_a_column_zero_and_empty_between() -> None:
    log = _log()
    number = np.zeros(len(log["t_s"]))
    number[40:160], number[190:310] = 1, 2
    number[340:460] = np.nan
    assert _spans(Cut(by="column", column="run"), log | {"cut": number}) == [
        (pytest.approx(4.0), pytest.approx(15.9)),
        (pytest.approx(19.0), pytest.approx(30.9)),
    ]


def test_by_times_in_seconds_and_of_the_clock() -> None:
    """1777888999 s is 2026-05-04T10:03:19Z."""
    times = ((4.0, 16.0), ("2026-05-04T12:03:38+02:00", "2026-05-04T10:03:50Z"))
    assert _spans(Cut(by="times", times=times), _log()) == [
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
        parse_cut(section, "mapping")


def test_times_outside_the_recording_are_refused() -> None:
    with pytest.raises(BadFileError, match="no samples from 90 to 95; it spans 0 to 49"):
        _spans(Cut(by="times", times=((90, 95),)), _log())
