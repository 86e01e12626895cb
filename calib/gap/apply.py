"""A diagnosed effect added to the model, as a coefficient file, and what a vehicle has of it."""

from collections.abc import Sequence
from dataclasses import astuple, replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import Reference
from calib.campaign.wheels import mecanum_model, odometry_source, without_rear_wheels
from calib.coefficients.build import TRACK_STD_M, Header, PoseNoise, from_law, load_points
from calib.coefficients.file import (
    OF_INSTRUMENTS,
    SENSOR_PLACES,
    CoefficientFile,
    GeometrySection,
    believed_model,
    effects_left_out,
)
from calib.coefficients.sections import EffectSection, LoadRange, Quantity, WheelSection
from calib.errors import RefusedError
from calib.gap.decision.diagnosis import BY_SIMULATOR, Diagnosis, VerdictKind
from calib.gap.decision.held_out import end_rms_m
from calib.gap.decision.sentences import SMALLER
from calib.gap.effects.encoder import EncoderBlunder
from calib.gap.effects.library import effect_class, section_of, with_effects
from calib.gap.effects.mounting import LateReference, TurnedReference
from calib.gap.inference.fit import CALIBRATION_SD
from calib.gap.predict import measured_gap, predict
from calib.kinematics.drives import STEERING_SCALE
from calib.radius.law import JOINT, RadiusLaw, WheelLaw
from calib.types import FloatArray

#: what four wheels with rollers have for a track
ARM: Final = "half_length_plus_half_width_m"
#: share of its prior variance from which the runs did not tell the track
UNSEEN: Final = 0.9


def applied_model(
    diagnosis: Diagnosis,
    campaign: Campaign,
    effects: Sequence[EffectSection] = (),
    believed: CoefficientFile | None = None,
) -> CoefficientFile:
    """Return the campaign's model with the named causes added, as a coefficient file; refused where none is named.

    The fitted recalibration goes into radii and track, a load effect into the slopes of the law; others are written as
    `model_of` and `with_effects` of `calib.gap.effects.library` take them. The diagnosed model's own (`effects`) are
    kept, and of its file (`believed`) what is known of slopes that no load effect changes.
    """
    if not diagnosis.causes:
        why = "there is no gap" if diagnosis.kind is VerdictKind.NO_GAP else f"the verdict is {diagnosis.kind.value}"
        raise RefusedError(
            f"{diagnosis.campaign}: {why}, so there is no effect to add to the model; "
            "drive the runs that 'calib plan' names, or leave the model as it is"
        )
    fitted, observations = diagnosis.correction.at_end(), diagnosis.observations
    model = observations.model
    slopes, sections = _slopes_and_sections(diagnosis)
    kept = None if slopes else believed
    covariance, scatter = _covariance(diagnosis, slopes, believed), _scatter(diagnosis, kept)

    def law(number: int, side: str) -> WheelLaw:
        grown = 1.0 + float(fitted.calibration[number])
        radius_m = getattr(model, f"radius_{side}_m") * grown
        slope, load_N = slopes.get(side, (0.0, 0))[0], observations.loads_N[number]
        return WheelLaw(
            reference_load_N=model.reference_load_N,
            radius_ref_m=radius_m,
            slope_m_per_N=getattr(model, f"slope_{side}_m_per_N") * grown + slope,
            covariance=covariance[2 * number :, 2 * number :][:2, :2],
            dof=max(float(diagnosis.noise.dof), 1.0),
            residual_std_m=float(np.sqrt(scatter[number, number])),
            load_min_N=float(np.nanmin(load_N)),
            load_max_N=float(np.nanmax(load_N)),
            n_runs=len(observations),
        )

    left, right, track_m = law(0, "left"), law(1, "right"), model.track_m * (1.0 + float(fitted.calibration[2]))
    source, rows, lengths = _joint_parameters(diagnosis, campaign)
    # a file's track of four wheels is twice l + w
    per_track = 2.0 * float(rows[ARM][4]) if ARM in rows else 1.0
    file = from_law(
        RadiusLaw(left=left, right=right),
        observations.vehicle,
        campaign.encoder,
        Header(campaign.name, campaign.simulated, inputs=campaign.hashes),
        load_table=load_points(*observations.loads_N),
        effects=[*effects, *sections],
        noise=PoseNoise(track_std_m=per_track * float(np.sqrt(covariance[4, 4]))),
    ).calibrated(track=per_track * track_m)
    if kept is not None:
        file = file.changed(wheels={side: _as_wide(wheel, getattr(kept.wheels, side)) for side, wheel in file.wheels})
    lengths |= _sensor(diagnosis, campaign.reference)
    names, matrix = list(rows), np.stack(list(rows.values()))
    sizes = matrix @ (left.radius_ref_m, left.slope_m_per_N, right.radius_ref_m, right.slope_m_per_N, track_m)
    spread = matrix @ covariance @ matrix.T
    known = np.flatnonzero(np.diag(spread))
    by_name, determined = dict(zip(names, sizes.tolist(), strict=True)), [names[k] for k in known]
    shared_m2 = float(scatter[0, 1]) if source == "rear" else None
    spread = spread[np.ix_(known, known)]
    stated = by_name | lengths, determined, spread
    together = GeometrySection.of_together(file.vehicle.drive, source, *stated, shared_m2)
    return file.changed(joint_geometry=together)


def _covariance(
    diagnosis: Diagnosis, slopes: dict[str, tuple[float, int]], believed: CoefficientFile | None
) -> FloatArray:
    """Return the covariance of `JOINT`, shape (5, 5): of what was fitted, and as `believed` of what was not."""
    fitted, observations = diagnosis.correction.at_end(), diagnosis.observations
    model = observations.model
    # change of `JOINT` by what was fitted: the calibration's four first
    by_fitted = np.zeros((len(JOINT), len(fitted.covariance)))
    by_fitted[4, 2] = model.track_m
    for row, side in ((0, "left"), (2, "right")):
        of_law = np.array([getattr(model, f"radius_{side}_m"), getattr(model, f"slope_{side}_m_per_N")])
        share = np.full(2, 0.5) if observations.by_front else np.eye(2)[row // 2]  # of one counter, the mean alone
        by_fitted[row : row + 2, :2] = np.outer(of_law, share)
        if side in slopes:
            by_fitted[row + 1, slopes[side][1]] = 1.0
    covariance = np.asarray(by_fitted @ fitted.covariance @ by_fitted.T)
    if believed is not None and not slopes:
        # the runs show the radius at their mean load
        above_N, by_slope = np.nanmean(observations.loads_N, axis=1) - model.reference_load_N, np.zeros((len(JOINT), 2))
        for wheel in range(2):
            by_slope[2 * wheel : 2 * wheel + 2, wheel] = -above_N[wheel], 1.0
        covariance += by_slope @ believed.law.covariance()[1:4:2, 1:4:2] @ by_slope.T
    if fitted.covariance[2, 2] > UNSEEN * CALIBRATION_SD[2] ** 2:
        known_m = TRACK_STD_M if believed is None else believed.vehicle.track_std.value
        as_known = np.append(np.ones(4), known_m / np.sqrt(covariance[4, 4]))
        covariance *= np.outer(as_known, as_known)
    return covariance


def _scatter(diagnosis: Diagnosis, kept: CoefficientFile | None) -> FloatArray:
    """Return the covariance of single runs' radii about the law, shape (2, 2), no less than that of a law `kept`."""
    both, apart = (diagnosis.noise.scales.get(name, 0.0) for name in ("radius_scatter", "yaw_scatter"))
    model = diagnosis.observations.model
    shares = np.array([[both, both], [-0.5 * apart, 0.5 * apart]]) * (model.radius_left_m, model.radius_right_m)
    scatter = np.asarray(shares.T @ shares)
    if kept is not None:
        law = kept.law
        known = np.diag(np.square([law.left.residual_std_m, law.right.residual_std_m]))
        known[[0, 1], [1, 0]] = law.run_covariance_m2
        larger, other = (known, scatter) if np.trace(known) > np.trace(scatter) else (scatter, known)
        scatter = larger.copy()
        np.fill_diagonal(scatter, np.maximum(np.diag(larger), np.diag(other)))
    return scatter


def _as_wide(wheel: WheelSection, believed: WheelSection) -> WheelSection:
    low, high = (getattr(wheel.valid_load, end).value for end in ("min", "max"))
    of_law = believed.valid_load
    wide = LoadRange.of(min=min(low, of_law.min.value), max=max(high, of_law.max.value))
    return wheel.model_copy(update={"valid_load": wide})


def _sensor(diagnosis: Diagnosis, stated: Reference) -> dict[str, float]:
    situation = diagnosis.arrays.situation
    for fault in situation.faults:
        if isinstance(fault, TurnedReference) and (fault.mirrored or fault.clockwise):
            raise RefusedError(f"{diagnosis.campaign}: no model corrects a mirrored reference; {fault.remark}")
    believed = situation.campaign.reference
    return {} if believed == stated else {name: float(getattr(believed, name)) for name in SENSOR_PLACES}


def _joint_parameters(diagnosis: Diagnosis, campaign: Campaign) -> tuple[str, dict[str, FloatArray], dict[str, float]]:
    """Return the odometry's source, its parameters as sums (5,) of `JOINT`, and lengths of the model."""
    observations, unit = diagnosis.observations, np.eye(len(JOINT))
    model = observations.model
    if observations.by_front:
        # one counter: a radius for both, and what is believed of the angle
        source, name = ("shaft", "rear_radius_m") if observations.by_shaft else ("front", "front_radius_m")
        radius_m, *lengths = astuple(model.steered(observations.vehicle))
        steering = ["wheelbase_m", "steering_zero_rad", STEERING_SCALE, "understeer_s2_per_m2", "side_slip_s2_per_m"]
        return source, {name: radius_m / model.radius_left_m * unit[0]}, dict(zip(steering, lengths, strict=True))
    if odometry_source(campaign) != "wheels" or not without_rear_wheels(campaign):
        return "rear", dict(zip(JOINT, unit, strict=True)), {}
    wheels = mecanum_model(campaign, model)
    radius = 0.5 * wheels.radius_m / model.mean_radius_m * (unit[0] + unit[2])
    return "wheels", {"wheel_radius_m": radius, ARM: wheels.arm_m / model.track_m * unit[4]}, {}


def _slopes_and_sections(diagnosis: Diagnosis) -> tuple[dict[str, tuple[float, int]], list[EffectSection]]:
    fitted, causes = diagnosis.correction.at_end(), diagnosis.corrected_causes
    named = {cause.effect for cause in causes}
    slopes: dict[str, tuple[float, int]] = {}
    sections: list[EffectSection] = []
    for form, theta, place in fitted.each():
        if form.effect in named and effect_class(form.effect).carries_law_slope:
            rows = range(2) if len(theta) > 1 else (0, 0)
            slopes = {side: (float(theta[k]), place.start + k) for side, k in zip(("left", "right"), rows, strict=True)}
        elif form.effect in named:
            sections.append(section_of(form, theta))
    late = [fault.effect.id for fault in diagnosis.arrays.situation.faults if isinstance(fault, LateReference)]
    for cause in causes:
        if cause.effect in (EncoderBlunder.id, *late):
            sizes = {name: Quantity(value=q.value, unit=q.unit) for name, q in cause.parameters.items()}
            settings = dict(cause.settings)
            sections.append(EffectSection(effect=cause.effect, form=cause.form, settings=settings, parameters=sizes))
    return slopes, sections


def on_vehicle(file: CoefficientFile, diagnosis: Diagnosis, campaign: Campaign) -> tuple[str, ...]:
    """Return what a vehicle, which lacks the effects, has of a written model, and what to do there."""
    left_out, *notes = effects_left_out(file, "not in a vehicle's runtime, ros2, c and csv")
    seen = diagnosis.observations
    every = [section for section in file.effects if section.effect != EncoderBlunder.id]
    instruments = [section for section in every if section.effect.startswith(OF_INSTRUMENTS)]
    written, ends = believed_model(file, seen.model.reference_load_N), []
    for model, effects in ((seen.model, instruments), (written, instruments), (written, every)):
        bare = replace(seen, model=model, simulated=np.full_like(seen.simulated, np.nan))
        path = predict(with_effects(bare, effects, campaign.extra.get("effects", ()))[0])
        ends.append(end_rms_m(measured_gap(path, path), seen) or 0.0)
    if ends[0] and diagnosis.judged_against != BY_SIMULATOR:
        sizes = "{:.3g} m by the model before, {:.3g} m by radii and track of the file alone, {:.3g} m with its effects"
        other = "" if seen.by_front else ", or apply the effects by calib.runtime.Effects"
        idle = f"; keep those before{other}" if ends[1] * SMALLER > ends[0] else ""
        notes = [f"end error of these runs: {sizes.format(*ends)}{idle}"]
    for cause in diagnosis.corrected_causes:
        for name, size in cause.parameters.items() if cause.effect.startswith("payload_") else ():
            notes.append(f"enter payloads as found: {name.replace('_', ' ')} {size.value:+.3g} {size.unit}")
    return left_out, *notes
