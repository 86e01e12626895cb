"""Building the coefficient file from a fitted law and its campaign."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from calib import __version__
from calib.coefficients.file import FORMAT, CoefficientFile, Outside, sealed
from calib.coefficients.sections import EffectSection
from calib.errors import BadInputError, ImplausibleError
from calib.radius.law import RadiusLaw, WheelLaw
from calib.units import GRAVITY_MPS2
from calib.vehicle import Vehicle

if TYPE_CHECKING:
    from calib.campaign.settings import Encoder
    from calib.radius.fitted import Fit

# Defaults of what a corridor campaign does not measure; every one stands in the file, where it can be bettered.
TRACK_STD_M: Final = 1e-3
ALONG_M_PER_SQRT_M: Final = 5e-4
HEADING_RAD_PER_SQRT_M: Final = 5e-4
COUNT_STD: Final = 1.0 / math.sqrt(12.0)  # a reading is uniform within one count
# The valid range reaches beyond the loads measured by this part of their span, and by 1 N at least: weighing scatters
# by newtons, and a vehicle that carries what it carried in the campaign must not be refused.
LOAD_MARGIN: Final = 0.01
LEAST_LOAD_MARGIN_N: Final = 1.0
MAX_STEP_M: Final = 0.5
MAX_GAP_S: Final = 1.0
LOAD_TABLE_LINES: Final = 64


def from_fit(
    fit: Fit,
    *,
    outside: Outside = "refuse",
    created: str | None = None,
    inputs: Mapping[str, str] | None = None,
) -> CoefficientFile:
    """Return the coefficient file of a fit: its laws, vehicle, encoder and load points.

    `outside` ({"refuse", "clamp"}): what the vehicle does with a load that was not measured; `created`: date as
    YYYY-MM-DD; passed in, so that the same input gives the same file; `inputs`: path of an input -> its SHA-256; None:
    those of the fit's provenance. Raises BadInputError where the fit lacks vehicle and encoder, or its provenance is
    damaged; ImplausibleError where the fit is beyond the bounds of its vehicle and nobody accepted that.
    """
    if fit.implausible and not fit.accepted:
        raise ImplausibleError(fit.name, fit.implausible)
    hashes = fit.provenance.get("inputs", {}) if inputs is None else inputs
    if fit.setup is None or not isinstance(hashes, Mapping):
        raise BadInputError(
            f"fit of {fit.name!r}: found no vehicle, encoder and input hashes; expected those of its campaign; "
            "make it anew with 'calib fit CAMPAIGN --into FOLDER'"
        )
    try:
        file = from_law(
            fit.law,
            fit.setup.vehicle,
            fit.setup.encoder,
            Header(fit.name, fit.simulated, outside, created, hashes),
            load_table=load_points(fit.radii.load_left_N, fit.radii.load_right_N),
        )
    except (TypeError, OverflowError) as error:
        raise BadInputError(
            f"fit of {fit.name!r}: found a value that is no number ({error}); expected those of a fit; make it anew "
            "with 'calib fit CAMPAIGN --into FOLDER'"
        ) from error
    if not fit.implausible:
        return file
    return file.changed(accepted_implausible={"reason": fit.accepted, "findings": list(fit.implausible)})


def load_points(load_left_N: npt.ArrayLike, load_right_N: npt.ArrayLike) -> dict[str, tuple[float, float]]:
    """Return the load points of runs as lines of a load table: name -> mean wheel loads left and right in N.

    Runs whose loads agree to a newton are one point. Empty where there are more than 64 points: no table is then meant.

    `load_left_N`, `load_right_N` (shape (n_runs,)): wheel loads; runs where one is not finite are passed over.
    """
    pairs = np.column_stack([load_left_N, load_right_N])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    keys, group = np.unique(np.round(pairs), axis=0, return_inverse=True)
    if len(keys) > LOAD_TABLE_LINES:
        return {}
    size = np.bincount(group.ravel(), minlength=len(keys))
    means = np.column_stack([np.bincount(group.ravel(), pairs[:, side], minlength=len(keys)) / size for side in (0, 1)])
    return {
        f"L{key[0]:.0f} R{key[1]:.0f}": (float(mean[0]), float(mean[1])) for key, mean in zip(keys, means, strict=True)
    }


@dataclass(frozen=True, slots=True)
class Header:
    """What a coefficient file says of itself."""

    name: str
    #: whether a program made the measurements
    simulated: bool
    #: what the vehicle does with a load that was not measured: ``refuse`` or ``clamp``
    outside: Outside = "refuse"
    #: date, YYYY-MM-DD
    created: str | None = None
    #: path of an input -> its SHA-256
    inputs: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Standard uncertainty of the track, and random walk of distance and heading per square root of metre."""

    track_std_m: float = TRACK_STD_M
    along_m_per_sqrt_m: float = ALONG_M_PER_SQRT_M
    heading_rad_per_sqrt_m: float = HEADING_RAD_PER_SQRT_M


def from_law(
    law: RadiusLaw,
    vehicle: Vehicle,
    encoder: Encoder,
    header: Header,
    *,
    load_table: Mapping[str, tuple[float, float]] | None = None,
    effects: Iterable[EffectSection] = (),
    load_margin_N: float | None = None,
    noise: PoseNoise = PoseNoise(),
) -> CoefficientFile:
    """Return the coefficient file of a law, a vehicle and an encoder; see `from_fit`.

    Parameters
    ----------
    law : RadiusLaw
        Radius by load of each wheel.
    vehicle : Vehicle
        Geometry and mass.
    encoder : Encoder
        Counts of a turn, and where the counters wrap.
    header : Header
        What the file says of itself.
    load_table : mapping of str to (float, float)
        Name of a line -> wheel loads left and right in N; lines outside the valid range are left out.
    effects : iterable of EffectSection
        Effects that a diagnosis added to the model.
    load_margin_N : float, optional
        How far the valid range reaches beyond the loads measured. None: 1 % of their span, 1 N at least.
    noise : PoseNoise
        What the pose scatters by.
    """
    lengths = [
        2.0**encoder.wrap_bits / per_rev * 2.0 * math.pi * wheel.radius_ref_m
        for per_rev, wheel in ((encoder.counts_per_rev_left, law.left), (encoder.counts_per_rev_right, law.right))
        if encoder.wrap_bits is not None
    ]
    # a quarter of what the counter holds: which way it wrapped stays clear
    step = min([MAX_STEP_M, *(0.25 * length for length in lengths)])
    sides = {"left": _wheel(law.left, load_margin_N), "right": _wheel(law.right, load_margin_N)}
    loads = [
        {"name": key, "load_left": _q(left, "N"), "load_right": _q(right, "N")}
        for key, (left, right) in (load_table or {}).items()
        if _within(sides["left"], left) and _within(sides["right"], right)
    ]
    return sealed(
        {
            "format": FORMAT,
            "calib_version": __version__,
            "name": header.name,
            "created": header.created,
            "simulated": bool(header.simulated),
            "outside": header.outside,
            "wheels": sides,
            "vehicle": _vehicle(vehicle, noise.track_std_m),
            "encoder": {
                "counts_per_rev_left": _q(encoder.counts_per_rev_left, "count/rev"),
                "counts_per_rev_right": _q(encoder.counts_per_rev_right, "count/rev"),
                "wrap_bits": None if encoder.wrap_bits is None else _q(encoder.wrap_bits, "bit"),
            },
            "noise": {
                "along": _q(noise.along_m_per_sqrt_m, "m/m^0.5"),
                "heading": _q(noise.heading_rad_per_sqrt_m, "rad/m^0.5"),
                "count_std": _q(COUNT_STD, "count"),
            },
            "limits": {"max_step": _q(step, "m"), "max_gap": _q(MAX_GAP_S, "s")},
            "load_table": loads,
            "effects": [effect.model_dump(mode="json") for effect in effects],
            "inputs": [{"path": key, "sha256": value} for key, value in sorted(header.inputs.items())],
        }
    )


def _q(value: float, unit: str) -> dict[str, Any]:
    return {"value": float(value), "unit": unit}


def _vehicle(vehicle: Vehicle, track_std_m: float) -> dict[str, Any]:
    return {
        "track": _q(vehicle.track_m, "m"),
        "track_std": _q(track_std_m, "m"),
        "wheelbase": _q(vehicle.wheelbase_m, "m"),
        "wheel_radius": _q(vehicle.wheel_radius_m, "m"),
        "mass": _q(vehicle.mass_kg, "kg"),
        "cog_x": _q(vehicle.cog_x_m, "m"),
        "cog_y": _q(vehicle.cog_y_m, "m"),
        "cog_z": _q(vehicle.cog_z_m, "m"),
        "max_wheel_load": _q(vehicle.max_wheel_load_N, "N"),
        "gravity": _q(GRAVITY_MPS2, "m/s^2"),
        "drive": vehicle.drive,
        "front_wheel_radius": None if vehicle.front_wheel_radius_m is None else _q(vehicle.front_wheel_radius_m, "m"),
    }


def _wheel(law: WheelLaw, load_margin_N: float | None) -> dict[str, Any]:
    span = law.load_max_N - law.load_min_N
    margin = max(LOAD_MARGIN * span, LEAST_LOAD_MARGIN_N) if load_margin_N is None else load_margin_N
    return {
        "radius_ref": _q(law.radius_ref_m, "m"),
        "slope": _q(law.slope_m_per_N, "m/N"),
        "reference_load": _q(law.reference_load_N, "N"),
        "variance_radius_ref": _q(law.covariance[0, 0], "m^2"),
        "covariance_radius_ref_slope": _q(law.covariance[0, 1], "m^2/N"),
        "variance_slope": _q(law.covariance[1, 1], "m^2/N^2"),
        "dof": _q(law.dof, "1"),
        "residual_std": _q(law.residual_std_m, "m"),
        "n_runs": _q(law.n_runs, "1"),
        # outwards to whole millinewtons: a load computed by another program must not fall out by its last bit
        "valid_load": {
            "min": _q(max(math.floor((law.load_min_N - margin) * 1e3) / 1e3, 0.0), "N"),
            "max": _q(math.ceil((law.load_max_N + margin) * 1e3) / 1e3, "N"),
        },
    }


def _within(wheel: dict[str, Any], load_N: float) -> bool:
    return bool(wheel["valid_load"]["min"]["value"] <= load_N <= wheel["valid_load"]["max"]["value"])
