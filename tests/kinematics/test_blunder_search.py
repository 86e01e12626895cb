"""The search of blunders: what a rough fit rules out no fit would have named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from unittest.mock import patch

import numpy as np
import pytest

from calib.kinematics import Recording, blunder_search, recording_of
from calib.kinematics.assemble import divisions
from calib.kinematics.blunders import Fault
from calib.kinematics.estimate import Using
from calib.kinematics.readings import Reading, readings
from tests.kinematics.campaigns import Truth, campaign, mixed

#: of 70 readings: the recording as it stands, the right one and the same with a column of zeros, and some that are near
MOST_TRIED = 8
#: a fit of each takes seconds: one of so many
EACH = 4


def _in_millimetres(recording: Recording) -> Recording:
    return recording.with_reference(recording.reference * np.array([[1e3], [1e3], [1.0]]))


def _by_one_wheel(recording: Recording) -> Recording:
    """Nothing corrects this: the right wheel's turns are lost."""
    return recording.with_turned(recording.steps.turned_rad[[0, 0]] * np.array([[1.0], [0.7]]))


def _searched(
    using: Using, change: Callable[[Recording], Recording] = lambda recording: recording, *, along: bool = True
) -> tuple[Fault | None, int]:
    """Return what is named of a vehicle two per cent off with a displaced sensor, and how many readings were fitted."""
    truth = Truth(radius_left_m=0.051, sensor=(0.1, 0.02, 0.05) if using == "windows" else (0.0, 0.0, 0.0))
    made = campaign(mixed(1), truth, np.random.default_rng(1), along=along, samples=50)
    recording = change(recording_of(made, "rear"))
    with patch.object(blunder_search, "_tried", wraps=blunder_search._tried) as tried:
        found = blunder_search.find_blunder(made, recording, "rear", lambda _, other: next(divisions(other, using)))
    return found and found[2], tried.call_count


@pytest.mark.parametrize(
    ("using", "change", "code"),
    [("end_poses", _in_millimetres, "position_unit"), ("windows", _by_one_wheel, None)],
)
def test_a_rough_fit_rules_out_most_readings_and_changes_no_result(
    using: Using, change: Callable[[Recording], Recording], code: str | None
) -> None:
    """The fits of every fourth reading and of the right one name the same blunder, or none."""
    fault, n_tried = _searched(using, change)
    kept: list[bool] = []

    def few(*given: object, **options: object) -> Iterator[Reading]:
        for reading in readings(*given, **options):  # type: ignore[arg-type]
            kept.append(reading.blunder == fault or len(kept) % EACH == 0)
            if kept[-1]:
                yield reading

    with patch.object(blunder_search, "_hopeless", lambda *_: False), patch.object(blunder_search, "readings", few):
        every, n_all = _searched(using, change)
    assert fault == every
    assert (fault.code if fault else None) == code
    assert len(kept) > 60 and n_all > sum(kept)
    assert n_tried <= MOST_TRIED


def test_no_reading_is_tried_where_nothing_was_measured_along_the_path() -> None:
    """No change of columns brings poses along the path."""
    assert _searched("windows", along=False) == (None, 0)
