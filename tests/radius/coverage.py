"""How often the 95 % intervals hold the truth: `python -m tests.radius.coverage --campaigns 2000`.

Whole campaigns are simulated (distances with rangefinder noise, whole counts) and fitted as `calib fit` does; truth is
known. One line a design: share of intervals of slope and of radius that hold it, session-aware and with every run
counted as independent.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.radius.fit import fit_campaign
from calib.radius.result import Fit
from calib.vehicle import Vehicle

RADIUS_M, SLOPE_M_PER_N, REFERENCE_N = 0.1, 1.3e-6, 300.0
RUN_SCATTER, SESSION_SCATTER = 1.6e-4, 2.0e-4
LOADS_N = (300.0, 500.0, 700.0, 900.0, 1100.0)


@dataclass(frozen=True)
class Design:
    """Loads and sessions of a campaign, drawn anew for each."""

    name: str
    plan: Callable[[np.random.Generator], tuple[np.ndarray, np.ndarray]]
    session_scatter: float
    #: relative scatter of a run against its load, 1 where it is the same everywhere
    growth: float = 1.0
    #: correlation of the scatter of one run and the next of its session
    rho: float = 0.0


def one_load_a_session(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.repeat(generator.permutation(LOADS_N), 12), np.repeat(np.arange(5), 12)


def crossed(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.tile(np.resize(LOADS_N, 12), 5), np.repeat(np.arange(5), 12)


def unbalanced(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    sizes = (4, 8, 12, 16, 20)
    return generator.choice(LOADS_N, 60), np.repeat(np.arange(5), sizes)


def any_load(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return generator.uniform(200, 1100, 60), np.repeat(np.arange(5), 12)


def two_loads_a_session(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    pairs = [(LOADS_N[i], LOADS_N[(i + 1) % 5]) for i in range(5)]
    return np.concatenate([np.repeat(pair, 6) for pair in pairs]), np.repeat(np.arange(5), 12)


def single(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.repeat(LOADS_N, 6), np.zeros(30, dtype=int)


def drawn(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return generator.permutation(np.tile(LOADS_N, 6)), np.repeat(np.arange(3), 10)


def ascending(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.tile(np.repeat(LOADS_N, 2), 3), np.repeat(np.arange(3), 10)


def two_sessions(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.tile([LOADS_N[0], LOADS_N[-1]], 8), np.repeat(np.arange(2), 8)


def two_confounded(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return np.repeat([LOADS_N[0], LOADS_N[-1]], 8), np.repeat(np.arange(2), 8)


def run_scatter(design: Design, session: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Return the relative scatter of each run, autocorrelated within its session."""
    scatter = generator.normal(0.0, RUN_SCATTER, len(session))
    for run in np.flatnonzero(np.diff(session) == 0) + 1 if design.rho else ():
        scatter[run] = design.rho * scatter[run - 1] + np.sqrt(1 - design.rho**2) * scatter[run]
    return scatter


DESIGNS = {
    "confounded": Design("one load a session, sessions alike", one_load_a_session, 0.0),
    "confounded+": Design("one load a session, sessions scatter", one_load_a_session, SESSION_SCATTER),
    "crossed": Design("loads crossed with sessions, sessions alike", crossed, 0.0),
    "crossed+": Design("loads crossed with sessions, sessions scatter", crossed, SESSION_SCATTER),
    "two": Design("two loads a session, sessions alike", two_loads_a_session, 0.0),
    "two+": Design("two loads a session, sessions scatter", two_loads_a_session, SESSION_SCATTER),
    "unbalanced": Design("random loads, sessions of 4 to 20 runs, alike", unbalanced, 0.0),
    "unbalanced+": Design("random loads, sessions of 4 to 20 runs, scatter", unbalanced, SESSION_SCATTER),
    "any+": Design("any load in every session, sessions scatter", any_load, SESSION_SCATTER),
    "single": Design("one session of 30 runs", single, 0.0),
    "single+": Design("one session of 30 runs, sessions scatter", single, SESSION_SCATTER),
    "two-sessions+": Design("two loads in two sessions, sessions scatter", two_sessions, SESSION_SCATTER),
    "two-confounded+": Design("two sessions of a load each, sessions scatter", two_confounded, SESSION_SCATTER),
    "drawn": Design("three sessions, loads in random order", drawn, 0.0),
    "drawn~": Design("the same, runs autocorrelated (0.8)", drawn, 0.0, rho=0.8),
    "ascending": Design("three sessions, loads ascending", ascending, 0.0),
    "ascending~": Design("the same, runs autocorrelated (0.8)", ascending, 0.0, rho=0.8),
    "single~": Design("one session, loads ascending, autocorrelated (0.8)", single, 0.0, rho=0.8),
    "growing+": Design("crossed, scatter grows fourfold with load, sessions scatter", crossed, SESSION_SCATTER, 4.0),
}


def campaign_of(design: Design, generator: np.random.Generator) -> Campaign:
    """Return a simulated campaign of a design."""
    load, session = design.plan(generator)
    n = len(load)
    distance = generator.uniform(37.0, 42.0, n)
    growth = 1 + (design.growth - 1) * (load - 200) / 900
    counts = {}
    for side in ("left", "right"):
        shift = generator.normal(0.0, design.session_scatter, session.max() + 1)[session]
        radius = (RADIUS_M + SLOPE_M_PER_N * (load - REFERENCE_N)) * (
            1 + shift + growth * run_scatter(design, session, generator)
        )
        start = generator.uniform(size=n)
        counts[side] = np.floor(start + distance / (2 * np.pi * radius) * 4096)
    return Campaign(
        root=None,
        name="coverage",
        simulated=True,
        vehicle=Vehicle(),
        encoder=Encoder(),
        model=OdometryModel(RADIUS_M, RADIUS_M, 0.7, REFERENCE_N),
        rangefinder=Rangefinder(),
        reference=Reference(),
        runs=RunTable(
            labels={
                "run_id": np.array([f"r{run}" for run in range(n)]),
                "session": np.array([f"s{one}" for one in session]),
                "direction": np.resize(["out", "back"], n),
            },
            numbers={
                "distance_m": distance + generator.normal(0.0, 0.0015, n),
                "load_left_N": load,
                "load_right_N": load,
                "counts_left": counts["left"],
                "counts_right": counts["right"],
            },
            excluded=np.zeros(n, dtype=bool),
            line=np.arange(2, n + 2),
        ),
        logs=Logs.empty(n),
    )


def hits(fit: Fit) -> np.ndarray:
    """Return which intervals hold the truth, shape (2 wheels, 4): slope, radius, naive slope, naive radius."""
    rows = []
    for wheel in fit.wheels.values():
        assert wheel.slope_ci95_m_per_N is not None
        assert wheel.naive is not None
        rows.append(
            [
                low <= truth <= high
                for (low, high), truth in (
                    (wheel.slope_ci95_m_per_N, SLOPE_M_PER_N),
                    (wheel.radius_ref_ci95_m, RADIUS_M),
                    (wheel.naive.slope_ci95_m_per_N, SLOPE_M_PER_N),
                    (wheel.naive.radius_ref_ci95_m, RADIUS_M),
                )
            ]
        )
    return np.array(rows)


def band_held(fit: Fit) -> float:
    """Return at which share of the loads the band of the mean holds the truth, over both wheels."""
    held = []
    for wheel in fit.wheels.values():
        load = np.linspace(wheel.law.load_min_N, wheel.law.load_max_N, 9)
        low, high = wheel.band_m(load, single_run=False)
        truth = RADIUS_M + SLOPE_M_PER_N * (load - REFERENCE_N)
        held.append((low <= truth) & (truth <= high))
    return float(np.mean(held))


def coverage(design: Design, n_campaigns: int, seed: int) -> np.ndarray:
    """Return the shares of intervals that hold the truth, (4,), of doubtful laws and of bands that hold it, (6,)."""
    generator = np.random.default_rng(seed)
    fits = [fit_campaign(campaign_of(design, generator)) for _ in range(n_campaigns)]
    held = np.mean(np.concatenate([hits(fit) for fit in fits]), axis=0)
    doubtful = np.mean([fit.verdict == "doubtful" for fit in fits])
    return np.append(held, [doubtful, np.mean([band_held(fit) for fit in fits])])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--campaigns", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    n = arguments.campaigns
    print(f"{n} campaigns a design, two wheels each; standard error {100 * (0.95 * 0.05 / n / 2) ** 0.5:.2f} %")  # noqa: T201
    print(f"{'':62}{'session-aware':>16}{'runs as independent':>22}")  # noqa: T201
    print(f"{'design':60}{'slope':>9}{'radius':>9}{'slope':>11}{'radius':>11}{'doubtful':>11}{'band':>9}")  # noqa: T201
    for design in DESIGNS.values():
        shares = 100 * coverage(design, n, arguments.seed)
        law = "".join(f"{share:{width}.2f}%" for share, width in zip(shares, (8, 8, 10, 10, 10, 8), strict=True))
        print(f"{design.name:60}{law}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
