"""The diagnosis of 160 runs of 600 rows against the whole library: where its time goes, and how it grows with runs.

Shares and ratios are of process time within one run of the benchmark; `--benchmark-enable -s` prints them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from calib.campaign import write_campaign
from calib.campaign.model import Campaign, Logs
from calib.gap import diagnose as whole
from calib.gap.inference import fit as fitting
from calib.gap.inference import local_search, noise
from calib.plant.design import good_design
from calib.plant.make import make_campaign

ROWS = 600


def of_rows(made: Campaign, rows: int = ROWS) -> Campaign:
    """The campaign with every log read off again at so many even times."""
    columns: dict[str, list[np.ndarray]] = {name: [] for name in made.logs.columns}
    lengths = []
    for run in range(len(made.runs)):
        log = made.logs.of(run)
        lengths.append(rows)
        at = np.linspace(log["t_s"][0], log["t_s"][-1], rows)
        for name, parts in columns.items():
            parts.append(np.interp(at, log["t_s"], log[name]) if name in log else np.full(rows, np.nan))
    offsets = np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return replace(made, logs=Logs(offsets=offsets, columns=joined))


@cache
def campaign_of(n_runs: int) -> Campaign:
    """A crossed plan in which wheels follow their load, front wheel and steering logged."""
    rng = np.random.default_rng(5)
    design = good_design(rng, n_runs=n_runs, needs={"front"})
    return of_rows(make_campaign(design, {"load_radius": float("nan")}, rng))


class Clock:
    """Process time spent in functions of some names, each function's own calls within itself counted once."""

    def __init__(self) -> None:
        self.spent_s: dict[str, float] = {}
        self.depth: dict[str, int] = {}

    def around(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            self.depth[name] = self.depth.get(name, 0) + 1
            begun = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                self.depth[name] -= 1
                if self.depth[name] == 0:
                    self.spent_s[name] = self.spent_s.get(name, 0.0) + time.process_time() - begun

        return timed


@contextmanager
def clocked() -> Iterator[Clock]:
    """Time the stages of a diagnosis as it calls them."""
    clock = Clock()
    places = [
        (fitting, "signature_columns", "signatures"),
        (whole, "estimate_noise", "noise"),
        (whole, "search", "search"),
        (local_search, "log_weights", "evidence"),
        (whole, "measure_closure", "held-out fits"),
        (whole, "trials", "transfer"),
        (whole, "locate", "where"),
        (whole, "undetectable", "undetectable"),
    ]
    with pytest.MonkeyPatch.context() as patch:
        for module, function, name in places:
            patch.setattr(module, function, clock.around(name, getattr(module, function)))
        yield clock


def spent(function: Callable[[], Any]) -> float:
    begun = time.process_time()
    function()
    return time.process_time() - begun


@pytest.mark.slow
def test_where_the_time_of_a_diagnosis_goes(benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str]) -> None:
    """Shares of process time of signatures, noise, search with its evidence, and held-out fits, in one diagnosis."""
    made = campaign_of(160 if benchmark.enabled else 16)
    with clocked() as clock:
        begun = time.process_time()
        diagnosis = benchmark.pedantic(whole.diagnose_in_full, args=(made,), rounds=1)
        total = time.process_time() - begun
    assert diagnosis.causes[0].effect == "load_radius"
    shares = {name: round(value / total, 3) for name, value in clock.spent_s.items()}
    assert {"signatures", "noise", "search", "evidence", "held-out fits"} <= shares.keys()
    # stages that do not lie within one another cannot add up to more than the whole; clocks tick in milliseconds
    assert sum(shares.get(name, 0.0) for name in ("noise", "search", "held-out fits", "where")) < 1.01
    benchmark.extra_info.update({f"share of {name}": value for name, value in shares.items()})
    if benchmark.enabled:
        with capsys.disabled():
            sys.stdout.write(f"\n{len(made.runs)} runs x {ROWS} rows: {total:.2f} s of process time; shares {shares}\n")


@pytest.mark.slow
def test_cost_grows_linearly_with_runs(benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str]) -> None:
    """Time for 80 and 160 runs over that for 40; a cost linear in runs at most doubles each time."""
    sizes = (40, 80, 160) if benchmark.enabled else (8, 16)
    made = {size: campaign_of(size) for size in sizes}
    took = {size: spent(lambda size=size: whole.diagnose_in_full(made[size])) for size in sizes}  # type: ignore[misc]
    ratios = {f"time of {size} runs over {sizes[0]}": round(took[size] / took[sizes[0]], 2) for size in sizes[1:]}
    benchmark.extra_info.update(ratios)
    benchmark.pedantic(noise.estimate_noise, args=_gap_of(made[sizes[0]]), rounds=1)
    assert all(value > 0 for value in ratios.values())
    if benchmark.enabled:
        with capsys.disabled():
            sys.stdout.write(f"\nprocess time by runs: { {n: round(t, 2) for n, t in took.items()} } s; {ratios}\n")


def _gap_of(made: Campaign) -> tuple[Any, Any]:
    from calib.gap.observations.from_campaign import observations_of
    from calib.gap.predict import predict, residuals

    nominal = predict(observations_of(made))
    return nominal, residuals(nominal, nominal)


@pytest.mark.slow
def test_the_whole_command_over_the_diagnosis_alone(
    benchmark: BenchmarkFixture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`calib diagnose` in a process of its own, reading included, over the diagnosis of the campaign in memory."""
    made = campaign_of(160 if benchmark.enabled else 16)
    folder = write_campaign(made, tmp_path / "campaign")
    alone = spent(lambda: whole.diagnose_in_full(made))
    verdict = tmp_path / "verdict.json"
    command = [sys.executable, "-m", "calib", "diagnose", str(folder), "--json", str(verdict)]

    def run() -> int:
        return subprocess.run(command, capture_output=True, check=False, env=dict(os.environ)).returncode

    before = os.times()
    assert benchmark.pedantic(run, rounds=1) in (0, 1)
    after = os.times()
    child = after.children_user + after.children_system - before.children_user - before.children_system
    wall = after.elapsed - before.elapsed
    benchmark.extra_info["command over diagnosis alone"] = round(child / alone, 2)
    assert verdict.stat().st_size > 0
    if benchmark.enabled:
        with capsys.disabled():
            sys.stdout.write(
                f"\ncalib diagnose, {len(made.runs)} runs: {wall:.1f} s wall, {child:.1f} s of process time\n"
            )
