"""A made-up diagnosis in the shape of the contract, with arrays that fit it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib.gap.data.channels import Channel
from calib.gap.verdict.outcome import ChannelClosure, Closure, Detectable, Group, PlannedRunAdvice
from calib.gap.verdict.result import Cause, Quantity, Verdict, VerdictKind
from calib.gap.where.result import ChannelGap, CovariateLine, RunLine, Where
from calib.report.gap_findings import GapFindings

CHANNELS = (("distance", "m"), ("along", "m"), ("lateral", "m"), ("heading", "rad"))
NOISE = np.array([0.0015, 0.004, 0.008, 0.001])


def findings(seed: int = 0, n: int = 48) -> GapFindings:
    """Return findings on runs of four routes whose lateral and heading gap follows the turn."""
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
    verdict = Verdict(
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
        groups=(Group(("track_width", "curve_scrub")),),
        undetectable=(Detectable("side_slip", "2 mrad per m/s^2"), Detectable("wear", "nothing varies", never=True)),
        where=Where(
            channels=tuple(
                ChannelGap(Channel[name.upper()], 0.02, float(NOISE[k])) for k, (name, _) in enumerate(CHANNELS)
            ),
            covariates=(CovariateLine("turn_rad", Channel.HEADING, 0.9, (0.8, 0.95), 1e-9, significant=True),),
            runs=(RunLine("r_004", Channel.LATERAL, 0.034, 0.008, 4.2),),
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
        next_runs=(PlannedRunAdvice("square_ccw", "tells the two apart", payload_kg=200, speed_mps=0.3),),
        campaign="yard",
    )
    return GapFindings(
        verdict=verdict,
        channels=CHANNELS,
        before=before,
        after=after,
        floor=np.broadcast_to(NOISE, before.shape).copy(),
        group=kinds,
        covariates={"turn_rad": turn, "speed_mps": rng.uniform(0.2, 0.8, n), "payload_kg": rng.choice([0.0, 200.0], n)},
        paths_m=tuple(paths),
        offset_m=rng.normal(0, 0.01, (n, 2)) + 0.03,
    )
