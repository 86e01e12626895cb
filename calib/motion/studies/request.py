"""What a user asked to simulate, from the texts of the command line to numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calib.errors import BadInputError
from calib.motion.pose_covariance import RandomWalk
from calib.motion.studies.law_path import Loading
from calib.motion.studies.numbers import numbers
from calib.motion.studies.sweeps import Case
from calib.radius.law import RadiusLaw
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N

if TYPE_CHECKING:
    from calib.coefficients.file import CoefficientFile

__all__ = ["Request", "request"]


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """Cases, law, loads and track of a simulation, and what the user should know of where they come from.

    `loading` are the loads that change on the way; `track_std_m` and `walk` say what else makes the pose uncertain,
    both as the coefficient file says.
    """

    cases: tuple[Case, ...]
    law: RadiusLaw | None
    loads_N: tuple[tuple[float, float], ...]
    loading: Loading | None
    reference_N: tuple[float, float]
    track_m: float
    track_std_m: float
    walk: RandomWalk | None
    notes: tuple[str, ...]


def request(
    *,
    law: Path | None,
    track_m: float | None,
    which: str,
    ratios: str | None,
    believed: str | None,
    real: str | None,
    loads: Sequence[str],
    payloads: Sequence[str],
    payloads_at: Sequence[str],
    reference: str,
) -> Request:
    """Return what was asked for.

    Parameters
    ----------
    law : Path or None
        Campaign, result folder or coefficient file.
    track_m : float or None
        Track; None: that of the law's vehicle, else the nominal one.
    which, ratios : str
        Wheel that is off, and ratios of radii.
    believed, real : str or None
        Radii ``L,R`` in m that the odometry believes, and the real ones.
    loads, payloads : sequence of str
        Wheel loads ``L,R`` in N, and payloads ``KG,X,Y``, of journeys under the law.
    payloads_at : sequence of str
        Payloads ``S,KG,X,Y`` carried from the distance S in m on; before the first one the vehicle is unladen.
    reference : str
        Loads ``L,R`` in N whose radii the uncorrected odometry uses.

    Raises
    ------
    BadInputError
        Where a text does not say what it should.
    RefusedError
        Where a payload cannot be carried.
    """
    vehicle, fitted, track_std_m, walk = Vehicle(), None, 0.0, None
    notes: tuple[str, ...] = ()
    if law is not None:
        from calib.coefficients.source import coefficients_of, effects_left_out

        source = coefficients_of(law)
        vehicle, fitted = source.file.geometry, source.file.law
        track_std_m, walk = source.file.vehicle.track_std.value, _walk(source.file)
        notes = (*source.notes, *effects_left_out(source.file, "not simulated"))
    cases: list[Case] = []
    if ratios is not None:
        cases += [Case.of(which, ratio) for ratio in numbers(ratios, None, "--ratio")]
    if real is not None:
        left, right = numbers(real, 2, "--real")
        base = numbers(believed, 2, "--believed") if believed else (vehicle.wheel_radius_m,) * 2
        if min(left, right, *base) <= 0.0:
            raise BadInputError("--believed, --real: found a radius of 0 or below; expected metres above 0")
        cases.append(Case.given(left / base[0], right / base[1]))
    elif believed is not None:
        raise BadInputError("--believed: found no --real beside it; expected both; give the real radii, too")
    if (loads or payloads or payloads_at) and fitted is None:
        raise BadInputError(
            "--load, --payload, --payload-at: found no law; expected --law PATH; loads mean nothing without one"
        )
    pairs: list[tuple[float, ...]] = [numbers(text, 2, "--load") for text in loads]
    pairs += [_carried(vehicle, *numbers(text, 3, "--payload")) for text in payloads]
    rows = [numbers(text, 4, "--payload-at") for text in payloads_at]
    if any(row[0] < 0.0 for row in rows):
        raise BadInputError("--payload-at: found a distance below 0 m; expected one along the route; correct it")
    if rows and min(row[0] for row in rows) > 0.0:
        rows.append((0.0, 0.0, 0.0, 0.0))
    loading = Loading.of([(row[0], *_carried(vehicle, *row[1:])) for row in rows]) if rows else None
    base_N = numbers(reference, 2, "--reference-load")
    if min([*base_N, *np.ravel(pairs).tolist()]) <= 0.0:
        raise BadInputError("wheel loads: found one of 0 N or below; expected loads above 0 N")
    return Request(
        cases=tuple(cases),
        law=fitted,
        loads_N=tuple((pair[0], pair[1]) for pair in pairs),
        loading=loading,
        reference_N=(base_N[0], base_N[1]),
        track_m=vehicle.track_m if track_m is None else track_m,
        track_std_m=track_std_m,
        walk=walk,
        notes=notes,
    )


def _carried(vehicle: Vehicle, mass_kg: float, x_m: float, y_m: float) -> tuple[float, float]:
    """Return the wheel loads (left, right) under a payload that the vehicle can carry."""
    if mass_kg < 0.0:
        raise BadInputError(f"payload: found {mass_kg:g} kg; expected a mass from 0 kg; correct it")
    front, left_N, right_N = wheel_loads_N(vehicle, mass_kg, x_m, y_m)
    check_wheel_loads(vehicle, front, left_N, right_N, what=f"payload {mass_kg:g} kg at x {x_m:g} m, y {y_m:g} m")
    return float(left_N), float(right_N)


def _walk(file: CoefficientFile) -> RandomWalk:
    """Return the random part of the pose's error as a coefficient file states it."""
    return RandomWalk(
        sigma_along_m_per_sqrt_m=file.noise.along.value,
        sigma_heading_rad_per_sqrt_m=file.noise.heading.value,
        count_std=file.noise.count_std.value,
        counts_per_rev_left=file.encoder.counts_per_rev_left.value,
        counts_per_rev_right=file.encoder.counts_per_rev_right.value,
    )
