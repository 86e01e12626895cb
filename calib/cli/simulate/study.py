"""`calib simulate study`: the studies of the paper's Section 7."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, Seed, nearest, pairs
from calib.cli.simulate.common import DRAWS, SPEED_MPS, Draws, Law, Output, Speed, Targets, Track, Tum, finish
from calib.cli.terminal import waiting
from calib.errors import BadInputError

EPILOG = "Example: calib simulate study corrected --law sample_runs/corridor --output section7"


def run(
    name: Annotated[str, typer.Argument(metavar="STUDY", help="symmetric, asymmetric or corrected.")],
    law: Law = None,
    load: Annotated[
        list[str] | None, typer.Option(metavar="L,R", help="With --law: wheel loads in place of the study's, N.")
    ] = None,
    route: Annotated[list[str] | None, typer.Option(help="Another route than the study's; again for more.")] = None,
    track: Track = None,
    draws: Draws = DRAWS,
    seed: Seed = 0,
    output: Output = None,
    tum: Tum = None,
    speed: Speed = SPEED_MPS,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Run a study of the paper's Section 7: what wrong radii do to a vehicle that follows its own odometry.

    symmetric: both wheels alike. asymmetric: the radii differ. corrected: the radii follow the load, and what is left
    is the 95 % band of the regression. With --law, Table 1 and journeys under that law are added.
    """
    import numpy as np

    from calib.motion.studies.law_source import law_source
    from calib.motion.studies.run import LawJourneys, simulate
    from calib.motion.studies.sweeps import STUDIES
    from calib.vehicle import Vehicle

    targets = Targets(output, tum, speed, json, force)
    if name not in STUDIES:
        raise BadInputError(f"study: found {name!r}; expected one of {', '.join(STUDIES)}" + nearest(name, STUDIES))
    loads_N = pairs(load, "--load")
    if loads_N and law is None:
        raise BadInputError("--load: found no law; expected --law PATH beside it; loads mean nothing without one")
    if min((value for pair in loads_N for value in pair), default=1.0) <= 0.0:
        raise BadInputError("--load: found 0 N or below; expected loads above 0 N; correct it")
    source = None if law is None else law_source(law)
    vehicle = Vehicle() if source is None else source.vehicle
    with waiting("simulating"):
        simulation = simulate(
            name,
            routes=route or (),
            track_m=vehicle.track_m if track is None else track,
            under=None if source is None else LawJourneys(source.axle(track), loads_N, draws=draws),
            rng=np.random.default_rng(seed),
        )
    finish(simulation, targets, seed=seed, notes=() if source is None else source.notes)
