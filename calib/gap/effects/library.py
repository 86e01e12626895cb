"""The registry of effects: adding one means a file of its own and one line here."""

from __future__ import annotations

import importlib
from collections.abc import Collection
from typing import Final

from calib.errors import BadInputError
from calib.gap.data.observations import Observations
from calib.gap.effects.covariate import Covariate, column_of, covariate_effects
from calib.gap.effects.effect import Effect
from calib.gap.effects.encoder_gross import GrossFault, find_gross
from calib.gap.effects.turned_reference import TurnedReference, find_turned
from calib.gap.effects.user import declared_effects, entry_point_effects
from calib.gap.predict.path import Path
from calib.limits import COVARIATES, refuse_beyond

#: id -> class; the order is the order of listings
REGISTRY: Final[dict[str, str]] = {
    "radius_scale": "calib.gap.effects.radius_scale.RadiusScale",
    "unequal_radii": "calib.gap.effects.unequal_radii.UnequalRadii",
    "track_width": "calib.gap.effects.track_width.TrackWidth",
    "load_radius": "calib.gap.effects.load_radius.LoadRadius",
    "load_radius_nonlinear": "calib.gap.effects.load_radius_nonlinear.LoadRadiusNonlinear",
    "load_creep": "calib.gap.effects.load_creep.LoadCreep",
    "wheel_eccentricity": "calib.gap.effects.wheel_eccentricity.WheelEccentricity",
    "curve_load_transfer": "calib.gap.effects.curve_load_transfer.CurveLoadTransfer",
    "load_dependent_track": "calib.gap.effects.load_dependent_track.LoadDependentTrack",
    "braking_skid": "calib.gap.effects.braking_skid.BrakingSkid",
    "speed_radius": "calib.gap.effects.speed_radius.SpeedRadius",
    "temperature_radius": "calib.gap.effects.temperature_radius.TemperatureRadius",
    "wear": "calib.gap.effects.wear.Wear",
    "session_step": "calib.gap.effects.session_step.SessionStep",
    "lost_counts": "calib.gap.effects.lost_counts.LostCounts",
    "encoder_gross": "calib.gap.effects.encoder_gross.EncoderGross",
    "rangefinder_scale": "calib.gap.effects.rangefinder_scale.RangefinderScale",
    "rangefinder_offset": "calib.gap.effects.rangefinder_offset.RangefinderOffset",
    "beam_misalignment": "calib.gap.effects.beam_misalignment.BeamMisalignment",
    "reference_lever_arm": "calib.gap.effects.reference_lever_arm.ReferenceLeverArm",
    "reference_yaw": "calib.gap.effects.reference_yaw.ReferenceYaw",
    "reference_latency": "calib.gap.effects.reference_latency.ReferenceLatency",
    "rear_drag": "calib.gap.effects.rear_drag.RearDrag",
    "travel_direction": "calib.gap.effects.travel_direction.TravelDirection",
    "side_slip": "calib.gap.effects.side_slip.SideSlip",
    "curve_scrub": "calib.gap.effects.curve_scrub.CurveScrub",
    "steering_zero": "calib.gap.effects.steering_zero.SteeringZero",
    "steering_scale": "calib.gap.effects.steering_scale.SteeringScale",
    "steering_backlash": "calib.gap.effects.steering_backlash.SteeringBacklash",
    "steering_delay": "calib.gap.effects.steering_delay.SteeringDelay",
    "drive_slip": "calib.gap.effects.drive_slip.DriveSlip",
    "payload_mass": "calib.gap.effects.payload_mass.PayloadMass",
    "payload_position": "calib.gap.effects.payload_position.PayloadPosition",
    "floor_slope": "calib.gap.effects.floor_slope.FloorSlope",
    "floor_zone": "calib.gap.effects.floor_zone.FloorZone",
    "floor_undulation": "calib.gap.effects.floor_undulation.FloorUndulation",
    "path_weave": "calib.gap.effects.path_weave.PathWeave",
    "integration_scheme": "calib.gap.effects.integration_scheme.IntegrationScheme",
}


def effect_class(name: str) -> type[Effect] | None:
    """Return the class of a registered effect, None for any other id."""
    if name not in REGISTRY:
        return None
    module, kind = REGISTRY[name].rsplit(".", 1)
    effect_type: type[Effect] = getattr(importlib.import_module(module), kind)
    return effect_type


def title_of(name: str) -> str:
    """Return what an effect is, for people, by its id; the id in plain words where the effect is the user's own."""
    registered = effect_class(name)
    if registered is not None:
        return registered.title
    column = column_of(name)
    return name.replace("_", " ") if column is None else Covariate(column).title


def why_it_stays(name: str) -> str:
    """Return why the correction of an effect is none for journeys to come, empty where it is one."""
    registered = effect_class(name)
    return "" if registered is None else registered.stays


def library(observations: Observations, *, exclude: Collection[str] = (), declared: object = ()) -> list[Effect]:
    """Return the effects that a campaign is judged by: of the registry, of its further columns, and the user's own.

    Effects that are found before the search (`fault_before_search`) are no part of it. A column that an effect acts
    through is no candidate of its own beside it. `declared` are the ``[[effects]]`` tables of ``campaign.toml``.
    """
    registered, covariates, own = _all(observations, declared)
    spoken_for = {column for effect in own if effect.id not in exclude for column in effect.columns}
    covariates = [effect for effect in covariates if effect.column not in spoken_for]
    searched = [e for e in registered if not (e.found_before_search or (observations.by_front and e.of_rear_wheels))]
    return [effect for effect in (*searched, *covariates, *own) if effect.id not in exclude]


def every_effect(observations: Observations, *, declared: object = ()) -> dict[str, Effect]:
    """Return all effects that can be named on a campaign, by id: what a file of effects, or an exclusion, may name."""
    registered, covariates, own = _all(observations, declared)
    return {effect.id: effect for effect in (*registered, *covariates, *own)}


def check_excluded(exclude: Collection[str], observations: Observations, declared: object = ()) -> None:
    """Refuse to leave out what is no effect of the campaign's library; the error names ids that begin alike."""
    known = every_effect(observations, declared=declared)
    for name in exclude:
        if name not in known:
            near = ", ".join(other for other in known if other[:4] == name[:4]) or ", ".join(known)
            raise BadInputError(f"exclude: found {name!r}; expected an effect of the library; choose of: {near}")


def fault_before_search(observations: Observations, nominal: Path, exclude: Collection[str] = ()) -> GrossFault | None:
    """Return the fault so gross that it is found, and put right, before the search; None where there is none."""
    return None if GrossFault.effect.id in exclude else find_gross(observations, nominal)


def turned_before_search(nominal: Path, exclude: Collection[str] = ()) -> TurnedReference | None:
    """Return by how much the reference's sensor is turned where that is far from small; None else."""
    return None if TurnedReference.effect.id in exclude else find_turned(nominal)


def _all(observations: Observations, declared: object) -> tuple[list[Effect], list[Covariate], list[Effect]]:
    """Return the registered effects, the columns' and the user's own."""
    registered = [kind() for kind in map(effect_class, REGISTRY) if kind is not None]
    spoken_for = {column for effect in registered for column in effect.columns}
    covariates = [effect for effect in covariate_effects(observations) if effect.column not in spoken_for]
    taken = [effect.id for effect in (*registered, *covariates)]
    own = declared_effects(declared, observations, taken)
    own += entry_point_effects([*taken, *(effect.id for effect in own)])
    refuse_beyond(
        len(covariates) + len(own),
        COVARIATES,
        shown="the campaign",
        what="further numeric columns and effects of its own, each a cause to be looked for",
        remedy="keep the columns that could matter",
    )
    return registered, covariates, own
