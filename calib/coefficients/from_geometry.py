"""Building the coefficient file from a geometry: radii and track estimated together, with or without loads."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.coefficients.build import Header, PoseNoise, from_law, load_points
from calib.coefficients.file import CoefficientFile, Outside
from calib.errors import RefusedError
from calib.radius.law import RadiusLaw, WheelLaw

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.geometry.result import Geometry

#: spread of a radius' change with load where no loads were driven, relative to the radius, per newton: 1 % per kN
SLOPE_STD_PER_N: Final = 1e-5
#: spread of a length that nobody measured, relative
NOMINAL_STD: Final = 0.01
UNITS: Final = {"_m": "m", "_rad": "rad", "_s": "s", "_scale": "1", "_m_per_N": "m/N"}


def from_geometry(
    geometry: Geometry, campaign: Campaign, *, outside: Outside = "refuse", created: str | None = None
) -> CoefficientFile:
    """Return the coefficient file of a geometry.

    Where no loads were driven the slope is 0 and its standard deviation what is usual (1 % of the radius per kN), about
    the mean load of the runs: the uncertainty of a radius grows with the distance from that load. The valid range is
    then all that the vehicle may carry. Lengths that were not determined stand at their nominal value with 1 %.

    `campaign`: the one it was estimated from; `outside` ({"refuse", "clamp"}): what the vehicle does with a load
    outside the valid range; `created`: date as YYYY-MM-DD. Raises RefusedError where a gross fault was recognised: the
    file would carry it to the vehicle.
    """
    if geometry.faults:
        raise RefusedError(
            f"coefficients of {geometry.name!r}: found a gross fault ({geometry.faults[0].text}); expected a campaign "
            "without; correct it and estimate again"
        )
    vehicle = campaign.vehicle
    names = {
        "rear": ("radius_left_m", "radius_right_m"),
        "wheels": ("wheel_radius_m", "wheel_radius_m"),
        "front": ("", ""),
    }[geometry.source]
    law = RadiusLaw(
        left=_wheel(geometry, campaign, "left", names[0]), right=_wheel(geometry, campaign, "right", names[1])
    )
    track, track_std = _track(geometry, campaign)
    wheelbase = geometry.values.get("wheelbase_m", vehicle.wheelbase_m)
    runs = campaign.included().runs
    file = from_law(
        law,
        replace(vehicle, track_m=track, wheelbase_m=wheelbase),
        campaign.encoder,
        Header(geometry.name, geometry.simulated, outside, created, geometry.inputs),
        load_table=load_points(runs.number("load_left_N"), runs.number("load_right_N")),
        noise=PoseNoise(track_std, geometry.noise["along_walk"], geometry.noise["heading_walk"]),
    )
    return file.changed(joint_geometry=_section(geometry))


def _section(geometry: Geometry) -> dict[str, object]:
    names = [estimate.name for estimate in geometry.estimates]
    return {
        "drive": geometry.drive,
        "source": geometry.source,
        "parameters": {name: {"value": value, "unit": _unit(name)} for name, value in geometry.values.items()},
        "covariance": [
            {
                "first": first,
                "second": second,
                "covariance": {
                    "value": float(geometry.covariance[row, row + column]),
                    "unit": _product(_unit(first), _unit(second)),
                },
            }
            for row, first in enumerate(names)
            for column, second in enumerate(names[row:])
        ],
    }


def _unit(name: str) -> str:
    return next(unit for suffix, unit in sorted(UNITS.items(), key=lambda pair: -len(pair[0])) if name.endswith(suffix))


def _product(first: str, second: str) -> str:
    return f"({first})^2" if first == second else f"({first})({second})"


def _wheel(geometry: Geometry, campaign: Campaign, side: str, name: str) -> WheelLaw:
    """Return the law of a wheel; at the nominal radius where the drive says nothing of rear wheels."""
    runs = campaign.included().runs
    loads = runs.number(f"load_{side}_N")
    loads = loads[np.isfinite(loads)]
    slope_name = f"slope_{side}_m_per_N"
    names = [estimate.name for estimate in geometry.estimates]
    radius = geometry.values.get(name, campaign.vehicle.wheel_radius_m)
    covariance = np.diag([(NOMINAL_STD * radius) ** 2, (SLOPE_STD_PER_N * radius) ** 2])
    dof = 0.0
    for row, first in enumerate((name, slope_name)):
        if first not in names:
            continue
        covariance[row, row] = geometry[first].std ** 2
        dof = geometry[first].dof if row == 0 else dof
    if name in names and slope_name in names:
        cross = geometry.covariance[names.index(name), names.index(slope_name)]
        covariance[0, 1] = covariance[1, 0] = cross
    driven = slope_name in names
    reference = campaign.model.reference_load_N
    if not driven and len(loads):
        reference = float(loads.mean())
    return WheelLaw(
        reference_load_N=reference,
        radius_ref_m=radius,
        slope_m_per_N=geometry.values.get(slope_name, 0.0),
        covariance=covariance,
        dof=dof,
        residual_std_m=0.0,
        load_min_N=float(loads.min()) if driven else 0.0,
        load_max_N=float(loads.max()) if driven else max(campaign.vehicle.max_wheel_load_N, reference),
        n_runs=geometry.n_runs,
    )


def _track(geometry: Geometry, campaign: Campaign) -> tuple[float, float]:
    """Return the track and its standard deviation; of mecanum wheels the track of two wheels that turn alike."""
    name, factor = ("half_length_plus_half_width_m", 2.0) if geometry.source == "wheels" else ("track_m", 1.0)
    track = factor * geometry.values.get(name, campaign.vehicle.track_m)
    determined = any(estimate.name == name for estimate in geometry.estimates)
    return track, factor * geometry[name].std if determined else NOMINAL_STD * track
