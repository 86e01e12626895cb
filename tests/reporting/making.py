"""A made-up diagnosis in the shape of the contract, with arrays that fit it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from calib.gap.decision.diagnosis import Cause, Diagnosis, Quantity, VerdictKind
from calib.gap.decision.held_out import ChannelClosure, Closure
from calib.gap.localise.locate import ChannelGap, CovariateResult, GapLocation, RunDeviation
from calib.gap.observations import Channel
from calib.gap.plan import DetectionLimit
from calib.gap.plan.planned_runs import PlannedRun
from calib.reporting.figures.gap import GapArrays
from calib.reporting.source import Source

CHANNELS = (("distance", "m"), ("along", "m"), ("lateral", "m"), ("heading", "rad"))
NOISE = np.array([0.0015, 0.004, 0.008, 0.001])


def findings(seed: int = 0, n: int = 48) -> tuple[Diagnosis, GapArrays]:
    """Return verdict and arrays on runs of four routes whose lateral and heading gap follows the turn."""
    rng = np.random.default_rng(seed)
    kinds = np.array(["square_ccw", "square_cw", "route_left", "corridor"])[np.arange(n) % 4]
    turn = np.array([2 * np.pi, -2 * np.pi, np.pi / 2, 0.0])[np.arange(n) % 4]
    paths = []
    for kind in kinds:
        t = np.linspace(0, 1, 60)
        if kind == "corridor":
            paths.append(np.column_stack((12 * t, 0 * t)))
        elif kind == "route_left":
            paths.append(np.column_stack((8 * np.sin(t * np.pi / 2), 8 * (1 - np.cos(t * np.pi / 2)))))
        else:
            side = 1 if kind.endswith("ccw") else -1
            corners = np.array([[0, 0], [4, 0], [4, 4 * side], [0, 4 * side], [0, 0.2 * side]], dtype=float)
            paths.append(np.concatenate([np.linspace(a, b, 15) for a, b in pairwise(corners)]))
    before = rng.normal(size=(n, 4)) * NOISE
    before[:, 2] += 0.01 * turn
    before[:, 3] += 0.003 * turn
    before[kinds != "corridor", 0] = np.nan
    after = np.where(np.isnan(before), np.nan, rng.normal(size=(n, 4)) * NOISE)
    verdict = Diagnosis(
        kind=VerdictKind.AMBIGUOUS,
        sentence="The gap is explained by the track or by scrub in curves: these runs cannot tell which.",
        causes=(
            Cause(
                effect="track_width",
                title="Track differs from the model's",
                form="",
                probability=0.61,
                share=0.93,
                signal=20.0,
                parameters={"relative": Quantity(3.02e-3, (2.93e-3, 3.11e-3), "1")},
            ),
            Cause("curve_scrub", "scrub in curves", "", 0.37, 0.93, 20.0, {}, remark="suspect latency"),
        ),
        credible_sets=(("track_width",), ("curve_scrub",)),
        groups=(("track_width", "curve_scrub"),),
        undetectable=(
            DetectionLimit("side_slip", "2 mrad per m/s^2"),
            DetectionLimit("wear", "nothing varies", never=True),
        ),
        where=GapLocation(
            channels=tuple(
                ChannelGap(Channel[name.upper()], 0.02, float(NOISE[k])) for k, (name, _) in enumerate(CHANNELS)
            ),
            covariates=(CovariateResult("turn_rad", Channel.HEADING, 0.9, (0.8, 0.95), 1e-9, significant=True),),
            runs=(RunDeviation("r_004", Channel.LATERAL, 0.034, 0.008, 4.2),),
        ),
        closure=Closure(
            0.061,
            0.0041,
            0.004,
            0.99,
            (0.97, 1.0),
            "session",
            (ChannelClosure(Channel.LATERAL, 0.061, 0.0041, 0.004, 0.99),),
        ),
        next_runs=(PlannedRun("square_ccw", why="tells the two apart", payload_kg=200, speed_mps=0.3),),
        campaign="yard",
    )
    arrays = GapArrays(
        channels=CHANNELS,
        labels={"run_id": np.array([f"r_{k:03d}" for k in range(n)]), "session": np.full(n, "s1"), "kind": kinds},
        before=before,
        after=after,
        noise_level=np.broadcast_to(NOISE, before.shape).copy(),
        covariates={"turn_rad": turn, "speed_mps": rng.uniform(0.2, 0.8, n), "payload_kg": rng.choice([0.0, 200.0], n)},
        paths_m=tuple(paths),
        offset_m=rng.normal(0, 0.01, (n, 2)) + 0.03,
    )
    return verdict, arrays


def with_findings(source: Source) -> Source:
    """Return a source with the findings as its diagnosis."""
    verdict, arrays = findings()
    return replace(source, verdict=verdict, gap=arrays)
