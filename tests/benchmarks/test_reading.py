"""Reading a campaign's logs against ``pandas.read_csv`` alone on the same files, and its memory against their size."""

from __future__ import annotations

import gc
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.campaign import write_campaign
from calib.campaign.read import read_campaign
from tests.campaign.making import campaign

ROUNDS, MOST_ROUNDS = 4, 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """60 runs of 40 m at 0.5 m/s and 100 Hz: about 480,000 samples."""
    made = campaign(runs_per_load=12, rate_hz=100.0)
    assert 450_000 < made.logs.offsets[-1] < 510_000
    return write_campaign(made, tmp_path_factory.mktemp("reading") / "c")


def _pandas_alone(folder: Path) -> list[pd.DataFrame]:
    return [pd.read_csv(path) for path in sorted((folder / "logs").iterdir())]


def _seconds(work: object, *arguments: object) -> float:
    start = time.perf_counter()
    work(*arguments)  # type: ignore[operator]
    return time.perf_counter() - start


def test_reading_is_at_least_half_as_fast_as_pandas_alone(folder: Path) -> None:
    """Best of several each, in turns, so that a busy machine meets both alike; no more than show the limit kept."""
    _pandas_alone(folder), read_campaign(folder)
    alone = ours = float("inf")
    for turn in range(MOST_ROUNDS):
        alone = min(alone, _seconds(_pandas_alone, folder))
        ours = min(ours, _seconds(read_campaign, folder))
        if turn >= ROUNDS and ours < 2.0 * alone:
            break
    assert ours < 2.0 * alone, f"read_campaign {ours:.3f} s, pandas alone {alone:.3f} s"


def test_reading_takes_less_than_four_times_the_files_in_memory(folder: Path) -> None:
    size = sum(path.stat().st_size for path in (folder / "logs").iterdir())
    read_campaign(folder)
    gc.collect()
    tracemalloc.start()
    try:
        made = read_campaign(folder)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert int(made.logs.offsets[-1]) == int(np.sum(made.logs.lengths))
    assert peak < 4 * size, f"peak {peak / 1e6:.1f} MB, files {size / 1e6:.1f} MB"


@pytest.mark.parametrize("reader", ["pandas alone", "read_campaign"])
def test_speed_of_reading(benchmark: object, folder: Path, reader: str) -> None:
    """For ``pytest --benchmark-enable``: both readers in one table."""
    benchmark(_pandas_alone if reader == "pandas alone" else read_campaign, folder)  # type: ignore[operator]
