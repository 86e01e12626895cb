"""What a user asked to simulate, from the texts of the command line to numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.errors import BadInputError
from calib.motion.numbers import numbers
from calib.motion.studies import Case
from calib.radius.law import RadiusLaw
from calib.vehicle import Vehicle, check_wheel_loads, wheel_loads_N

__all__ = ["Request", "request"]


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """Cases, law, loads and track of a simulation, and what the user should know of where they come from."""

    cases: tuple[Case, ...]
    law: RadiusLaw | None
    loads_N: tuple[tuple[float, float], ...]
    reference_N: tuple[float, float]
    track_m: float
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
    reference : str
        Loads ``L,R`` in N whose radii the uncorrected odometry uses.

    Raises
    ------
    BadInputError
        Where a text does not say what it should.
    RefusedError
        Where a payload cannot be carried.
    """
    vehicle, fitted = Vehicle(), None
    notes: tuple[str, ...] = ()
    if law is not None:
        from calib.coefficients.source import coefficients_of, effects_left_out

        source = coefficients_of(law)
        vehicle, fitted = source.file.geometry, source.file.law
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
    if (loads or payloads) and fitted is None:
        raise BadInputError("--load, --payload: found no law; expected --law PATH; loads mean nothing without one")
    pairs = [numbers(text, 2, "--load") for text in loads]
    for text in payloads:
        mass, x, y = numbers(text, 3, "--payload")
        front, left_N, right_N = wheel_loads_N(vehicle, mass, x, y)
        check_wheel_loads(vehicle, front, left_N, right_N, what=f"payload {text}")
        pairs.append((float(left_N), float(right_N)))
    base_N = numbers(reference, 2, "--reference-load")
    if min([*base_N, *np.ravel(pairs).tolist()]) <= 0.0:
        raise BadInputError("wheel loads: found one of 0 N or below; expected loads above 0 N")
    return Request(
        cases=tuple(cases),
        law=fitted,
        loads_N=tuple((pair[0], pair[1]) for pair in pairs),
        reference_N=(base_N[0], base_N[1]),
        track_m=vehicle.track_m if track_m is None else track_m,
        notes=notes,
    )
