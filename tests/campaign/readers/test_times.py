"""Times as loggers write them, against Python's own calendar."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.campaign.readers.times import decimal_ns, moment_ns, moments_ns, time_format


@given(
    st.datetimes(
        min_value=datetime.datetime(1970, 1, 2),
        max_value=datetime.datetime(2150, 1, 1),
        timezones=st.sampled_from([datetime.timezone(datetime.timedelta(minutes=m)) for m in (-300, 0, 60, 330)]),
    )
)
def test_iso_8601_is_what_python_reads(moment: datetime.datetime) -> None:
    since = moment - datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
    expected = (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000
    assert moment_ns(moment.isoformat()) == expected
    assert time_format(moment.isoformat()) == "iso8601"


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("2026-05-04T10:15:30.250Z", "2026-05-04T12:15:30.25+02:00"),
        ("2026-05-04 10:15:30,250", "2026-05-04T10:15:30.25Z"),
        ("04.05.2026 10:15:30,250", "2026-05-04T10:15:30.25Z"),
        ("2026-05-04T10:15:30.123456789Z", "2026-05-04T10:15:30.123456789+00:00"),
        ("2026-05-04 10:15", "2026-05-04T10:15:00Z"),
    ],
)
def test_other_spellings_mean_the_same(text: str, same: str) -> None:
    assert moment_ns(text) == moment_ns(same)


def test_a_time_of_day_runs_on_over_midnight() -> None:
    times, bad = moments_ns(["23:59:59.5", "00:00:00.5", "00:00:01.5"])
    assert bad is None
    assert np.diff(times).tolist() == [10**9, 10**9]


@pytest.mark.parametrize("text", ["2026-13-01T00:00:00", "2026-02-30T00:00:00", "25:00:00", "10:61:00", "soon"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        moment_ns(text)


@given(st.integers(min_value=-(10**18), max_value=4 * 10**18))
def test_decimal_seconds_are_exact(nanoseconds: int) -> None:
    sign, rest = "-" if nanoseconds < 0 else "", abs(nanoseconds)
    assert decimal_ns(f"{sign}{rest // 10**9}.{rest % 10**9:09d}") == nanoseconds
