"""The registry of effects: adding one means a file of its own and one line here."""

from __future__ import annotations

import importlib
from collections.abc import Collection
from typing import Final

from calib.gap.data.observations import Observations
from calib.gap.effects.covariate import covariate_effects
from calib.gap.effects.effect import Effect
from calib.gap.effects.user import declared_effects, entry_point_effects

__all__ = ["REGISTRY", "library"]

#: id -> (module, class); the order is the order of listings
REGISTRY: Final[dict[str, tuple[str, str]]] = {
    "radius_scale": ("radius_scale", "RadiusScale"),
    "unequal_radii": ("unequal_radii", "UnequalRadii"),
    "track_width": ("track_width", "TrackWidth"),
    "load_radius": ("load_radius", "LoadRadius"),
    "load_radius_nonlinear": ("load_radius_nonlinear", "LoadRadiusNonlinear"),
    "load_creep": ("load_creep", "LoadCreep"),
    "wheel_eccentricity": ("wheel_eccentricity", "WheelEccentricity"),
    "curve_load_transfer": ("curve_load_transfer", "CurveLoadTransfer"),
    "load_dependent_track": ("load_dependent_track", "LoadDependentTrack"),
    "braking_skid": ("braking_skid", "BrakingSkid"),
    "speed_radius": ("speed_radius", "SpeedRadius"),
    "temperature_radius": ("temperature_radius", "TemperatureRadius"),
    "wear": ("wear", "Wear"),
    "session_step": ("session_step", "SessionStep"),
    "lost_counts": ("lost_counts", "LostCounts"),
    "encoder_gross": ("encoder_gross", "EncoderGross"),
    "rangefinder_scale": ("rangefinder_scale", "RangefinderScale"),
    "rangefinder_offset": ("rangefinder_offset", "RangefinderOffset"),
    "beam_misalignment": ("beam_misalignment", "BeamMisalignment"),
    "reference_lever_arm": ("reference_lever_arm", "ReferenceLeverArm"),
    "reference_yaw": ("reference_yaw", "ReferenceYaw"),
    "reference_latency": ("reference_latency", "ReferenceLatency"),
    "rear_drag": ("rear_drag", "RearDrag"),
    "travel_direction": ("travel_direction", "TravelDirection"),
    "side_slip": ("side_slip", "SideSlip"),
    "curve_scrub": ("curve_scrub", "CurveScrub"),
    "steering_zero": ("steering_zero", "SteeringZero"),
    "steering_scale": ("steering_scale", "SteeringScale"),
    "steering_backlash": ("steering_backlash", "SteeringBacklash"),
    "steering_delay": ("steering_delay", "SteeringDelay"),
    "drive_slip": ("drive_slip", "DriveSlip"),
    "payload_mass": ("payload_mass", "PayloadMass"),
    "payload_position": ("payload_position", "PayloadPosition"),
    "floor_slope": ("floor_slope", "FloorSlope"),
    "floor_zone": ("floor_zone", "FloorZone"),
    "floor_undulation": ("floor_undulation", "FloorUndulation"),
    "path_weave": ("path_weave", "PathWeave"),
    "integration_scheme": ("integration_scheme", "IntegrationScheme"),
}


def library(s: Observations, *, exclude: Collection[str] = (), declared: object = ()) -> list[Effect]:
    """Return the effects that a campaign is judged by.

    Parameters
    ----------
    s : Observations
        The campaign; its further numeric columns become effects of their own.
    exclude : collection of str
        Ids to leave out.
    declared : object
        The ``[[effects]]`` tables of ``campaign.toml`` as read.

    Returns
    -------
    list of Effect
        The registered effects in the order of the registry, then covariates, then the user's own.

    Raises
    ------
    CalibError
        Where a declaration or an entry point cannot be used.
    """
    made: list[Effect] = []
    for module, kind in REGISTRY.values():
        made.append(getattr(importlib.import_module(f"calib.gap.effects.{module}"), kind)())
    made += covariate_effects(s)
    made += declared_effects(declared, s, [effect.id for effect in made])
    made += entry_point_effects([effect.id for effect in made])
    return [effect for effect in made if effect.id not in exclude]
