"""`calib simulate journey`: a route driven under a fitted law, without and with radii that follow the load."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, Seed, numbers, pairs
from calib.cli.simulate.common import DRAWS, SPEED_MPS, Draws, Output, Routes, Speed, Targets, Track, Tum, finish
from calib.cli.terminal import waiting
from calib.errors import BadInputError

EPILOG = "Example: calib simulate journey figure8 --law sample_runs/corridor --payload-at 5,100,0.5,0.1"


def run(
    law: Annotated[
        Path,
        typer.Option(
            "--law",
            "--model",
            metavar="PATH",
            help="Campaign, result folder of calib fit, or coefficient file, also one of calib diagnose --apply.",
        ),
    ],
    route: Routes = None,
    load: Annotated[
        list[str] | None, typer.Option(metavar="L,R", help="Wheel loads, N; again for more journeys.")
    ] = None,
    payload: Annotated[
        list[str] | None, typer.Option(metavar="KG,X,Y", help="The same from a payload and its place; again for more.")
    ] = None,
    payload_at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="S,KG,X,Y",
            help="Payload from S m along the route on, 0 kg to unload; again for more. Unladen before the first one.",
        ),
    ] = None,
    reference: Annotated[
        str,
        typer.Option("--reference-load", metavar="L,R", help="Loads whose radii the uncorrected odometry uses, N."),
    ] = "300,300",
    track: Track = None,
    draws: Draws = DRAWS,
    seed: Seed = 0,
    output: Output = None,
    tum: Tum = None,
    speed: Speed = SPEED_MPS,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Drive a route under a fitted law, without and with radii that follow the load.

    The 95 % band of the law is carried to the end pose by linear propagation and by Monte Carlo.
    """
    import numpy as np

    from calib.motion.studies.law_source import carried_loads_N, law_source, loading_on_the_way
    from calib.motion.studies.run import CUSTOM, LawJourneys, simulate

    targets = Targets(output, tum, speed, json, force)
    base = numbers(reference, 2, "--reference-load")
    loads_N = pairs(load, "--load")
    carried = [numbers(text, 3, "--payload") for text in payload or ()]
    changes = [numbers(text, 4, "--payload-at") for text in payload_at or ()]
    if min([*base, *(value for pair in loads_N for value in pair)]) <= 0.0:
        raise BadInputError("--load, --reference-load: found 0 N or below; expected loads above 0 N; correct it")
    source = law_source(law)
    loads_N += [carried_loads_N(source.vehicle, mass, x, y) for mass, x, y in carried]
    with waiting("driving"):
        loading = loading_on_the_way(source.vehicle, changes) if changes else None
        under = LawJourneys(source.axle(track), loads_N, (base[0], base[1]), loading, draws)
        rng = np.random.default_rng(seed)
        simulation = simulate(CUSTOM, routes=route or (), track_m=under.axle.track_m, under=under, rng=rng)
    finish(simulation, targets, seed=seed, notes=source.notes)
