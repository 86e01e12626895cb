"""`calib simulate route`: a route driven on an odometry that believes other radii than the real ones."""

from __future__ import annotations

from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, numbers
from calib.cli.simulate.common import SPEED_MPS, Output, Routes, Speed, Targets, Track, Tum, finish
from calib.errors import BadInputError

EPILOG = "Example: calib simulate route square_cw square_ccw --real 0.099,0.1 --output squares"


def run(
    route: Routes = None,
    real: Annotated[str | None, typer.Option(metavar="L,R", help="Real radii, m.")] = None,
    believed: Annotated[
        str | None, typer.Option(metavar="L,R", help="Radii the odometry believes, m (0.1,0.1).")
    ] = None,
    ratio: Annotated[str | None, typer.Option(metavar="E,E..", help="Ratios of radii, E_r = r_R / r_L.")] = None,
    which: Annotated[
        str, typer.Option("--wheel", help="Which wheel --ratio sets off: right, left, both, equal.")
    ] = "right",
    track: Track = None,
    real_track: Annotated[float | None, typer.Option(metavar="M", help="Real track, if another.")] = None,
    output: Output = None,
    tum: Tum = None,
    speed: Speed = SPEED_MPS,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Drive a route on an odometry that believes other radii than the real ones.

    The vehicle follows the route by its own odometry; what is shown is where it really ends.
    """
    import numpy as np

    from calib.motion.studies.run import CUSTOM, simulate
    from calib.motion.studies.sweeps import Case
    from calib.vehicle import Vehicle

    targets = Targets(output, tum, speed, json, force)
    vehicle = Vehicle()
    cases = [Case.off(which, value) for value in (numbers(ratio, None, "--ratio") if ratio else ())]
    if real is not None:
        left, right = numbers(real, 2, "--real")
        base = numbers(believed, 2, "--believed") if believed else (vehicle.wheel_radius_m,) * 2
        if min(left, right, *base) <= 0.0:
            raise BadInputError("--believed, --real: found a radius of 0 or below; expected metres above 0")
        cases.append(Case.given(left / base[0], right / base[1]))
    elif believed is not None:
        raise BadInputError("--believed: found no --real beside it; expected both; give the real radii, too")
    if not cases:
        raise BadInputError(
            "found no radii; expected --real or --ratio; under a fitted law it is 'calib simulate journey --law PATH'"
        )
    simulation = simulate(
        CUSTOM,
        routes=route or (),
        cases=cases,
        track_m=vehicle.track_m if track is None else track,
        real_track_m=real_track,
        rng=np.random.default_rng(0),
    )
    finish(simulation, targets, seed=0)
