"""What many sessions, many runs and the imports cost a diagnosis: each against a reference in the same run.

The processes take turns, as many as show it; the ratios of the least of each are what is held. `python -m
tests.benchmarks.table --parts sessions` prints them for the documentation.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from calib.campaign import write_campaign
from tests.benchmarks.large_campaign import in_sessions
from tests.benchmarks.measured import Spent, least, spent
from tests.benchmarks.test_diagnosis import campaign_of, of_rows
from tests.benchmarks.test_startup import NEEDED

#: the same runs in many sessions cost at most so many times what they cost in few
MOST_FOR_SESSIONS = 1.5
#: memory for a run more, over what a run's own log takes in memory
MOST_MEMORY_RATIO = 8.0
#: 160 runs cost at most so many times what the imports cost
MOST_OVER_IMPORTS = 2.5


def diagnosed(folder: Path) -> Spent:
    """What `calib diagnose` takes in a process of its own."""
    return spent(["-m", "calib", "diagnose", str(folder)])


def folders_of(into: Path, runs: int, rows: int, sessions: Sequence[int]) -> list[Path]:
    """The same runs in so many sessions, one folder each."""
    made = of_rows(campaign_of(runs), rows)
    return [write_campaign(in_sessions(made, count), into / f"s{count}") for count in sessions]


@pytest.mark.slow
def test_many_sessions_cost_what_few_cost(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """160 runs in 40 sessions and in 5 (1,020 in 85 and in 5 where benchmarks are asked for)."""
    runs, many, turns = (1020, 85, 2) if benchmark.enabled else (160, 40, 3)

    def kept(found: Sequence[Spent]) -> bool:
        return not benchmark.enabled and found[1].cpu_s <= MOST_FOR_SESSIONS * found[0].cpu_s

    few_folder, many_folder = folders_of(tmp_path, runs, 200, (5, many))
    few, with_many = least(turns, lambda: diagnosed(few_folder), lambda: diagnosed(many_folder), enough=kept)
    benchmark.extra_info.update({"of 5 sessions": few.cpu_s, f"of {many}": with_many.cpu_s})
    benchmark.pedantic(lambda: None, rounds=1)
    ratio = with_many.cpu_s / few.cpu_s
    assert ratio <= MOST_FOR_SESSIONS, f"{runs} runs in {many} sessions take {ratio:.2f} times what they take in 5"
    assert with_many.peak_MB <= MOST_FOR_SESSIONS * few.peak_MB


@pytest.mark.slow
def test_a_further_run_takes_little_more_memory_than_its_log(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """Between two sizes, so that what the program itself takes falls out; a log is five columns of eight bytes."""
    rows, sizes = 1000, (1000, 3000) if benchmark.enabled else (60, 240)
    peaks = []
    for size in sizes:
        folder = write_campaign(of_rows(campaign_of(size), rows), tmp_path / f"r{size}")
        peaks.append(diagnosed(folder).peak_MB)
    further_MB = (peaks[1] - peaks[0]) / (sizes[1] - sizes[0])
    ratio = further_MB / (5 * 8e-6 * rows)
    benchmark.extra_info["memory of a run over its log"] = ratio
    benchmark.pedantic(lambda: None, rounds=1)
    # the smaller campaign's peak may be that of the imports: then less than a log is left between the two
    assert 0.0 < ratio <= MOST_MEMORY_RATIO, f"a run takes {ratio:.1f} times what its log does: {peaks} MB"


def test_what_is_spent_is_measured() -> None:
    """Half a second of the processor and 100 MB, in a process of its own."""
    idle, busy = (
        spent(["-c", "pass"]),
        spent(["-c", "import time\nheld = b'x' * 10**8\nwhile time.process_time() < 0.6: pass"]),
    )
    assert busy.cpu_s > idle.cpu_s + 0.4
    assert 90 < busy.peak_MB - idle.peak_MB < 130


@pytest.mark.slow
def test_160_runs_beside_the_imports(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """160 runs of 600 rows against bare imports; in turns."""
    folder = write_campaign(of_rows(campaign_of(160), 600), tmp_path / "r160")

    def kept(found: Sequence[Spent]) -> bool:
        return not benchmark.enabled and found[1].cpu_s <= MOST_OVER_IMPORTS * found[0].cpu_s

    # beside other tests single turns are up to a tenth off; the first that keeps the limit ends them
    bare, ours = least(8, lambda: spent(["-c", NEEDED]), lambda: diagnosed(folder), enough=kept)
    benchmark.extra_info["160 runs over bare imports"] = ours.cpu_s / bare.cpu_s
    benchmark.pedantic(lambda: None, rounds=1)
    assert ours.cpu_s <= MOST_OVER_IMPORTS * bare.cpu_s, f"{ours.cpu_s / bare.cpu_s:.2f} times the imports"
