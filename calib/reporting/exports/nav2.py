"""Parameters of a navigation stack from the measured noise of the corrected odometry: AMCL's alphas, and covariances.

The residuals of runs that the correction was not fitted on are what AMCL's motion model, and the process behind an
extended Kalman filter's twist, have to spread over. How each number follows: `calib.reporting.exports.pose_spread`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calib.coefficients.formats import Artifact, ascii_line, number
from calib.documents import templates_of
from calib.errors import RefusedError
from calib.gap.decision.diagnosis import Diagnosis
from calib.reporting.exports import diagnosed, pose_spread
from calib.reporting.exports.pose_spread import ALPHAS, DEFAULT_ALPHA, POSE, form_ratios, sizes_of, undetermined
from calib.types import FloatArray, Progress, StrArray

#: fewer end poses do not show a spread: its standard error is then beyond a sixth
FEWEST_RUNS: Final = 20
#: rate and speed at which the variances of a twist are stated
RATE_HZ: Final = 50.0
SPEED_MPS: Final = 1.0
#: names of the three ratios
CHANNELS: Final = ("along", "lateral", "heading")
#: a ratio by the form of AMCL's model that is further from 1 is pointed out
FORM_TOLERANCE: Final = 0.1
#: digits of a variance
DIGITS: Final = 4


def is_beyond(form: FloatArray) -> bool:
    """Return whether ratios by the form of the model (3,) are further from 1 than `FORM_TOLERANCE`."""
    return bool(np.abs(np.log(form)).max() > np.log(1.0 + FORM_TOLERANCE))


@dataclass(frozen=True, slots=True, eq=False)
class KindNoise:
    """Alphas for runs of one kind, and their ratios by the form of AMCL's model alone, shape (3,)."""

    kind: str
    n_runs: int
    alphas: dict[str, float]
    form: FloatArray


def kind_noise(models: Sequence[pose_spread.Spread], residuals: FloatArray, kinds: StrArray) -> tuple[KindNoise, ...]:
    """Return the alphas of each kind (n_obs,) of enough runs by itself, where there are several kinds.

    `models`: the spreads of `MODELS` on these runs; `residuals`: (n_obs, 3).
    """
    found = []
    for kind in sorted(set(kinds)) if len(set(kinds)) > 1 else ():
        on = kinds == kind
        if on.sum() >= FEWEST_RUNS:
            amcl, *others = (model.of(on) for model in models)
            sizes = sizes_of(amcl, residuals[on])
            alphas = dict(zip(ALPHAS, map(float, sizes), strict=True))
            alphas |= dict.fromkeys(undetermined(amcl, sizes), DEFAULT_ALPHA)
            found.append(KindNoise(str(kind), int(on.sum()), alphas, form_ratios(amcl, others, residuals[on])))
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class MotionNoise:
    """The noise of the corrected odometry on held-out runs."""

    n_runs: int
    length_m: float  #: median length of the runs
    turn_rad: float  #: median of what they turn in all, to and fro
    alphas: dict[str, float]
    undetermined: tuple[str, ...]  #: alphas that these runs say nothing of
    walks: dict[str, float]  #: variance a metre of distance (m) and of heading (rad^2/m)
    held_out: pose_spread.Fitted  #: observed over predicted standard deviation of runs held out, with intervals
    form: FloatArray  #: the same ratios by the form of AMCL's model alone, shape (3,)
    by_kind: tuple[KindNoise, ...] = ()  #: where no alphas spread as all runs do

    @property
    def beyond_form(self) -> bool:
        """Whether no alphas spread as the runs do."""
        return is_beyond(self.form)

    @property
    def cover(self) -> float:
        """Factor of the alphas with which the form of the model understates none of the three."""
        return float(self.form.max() ** 2)


def render(path: Path, accept: str, progress: Progress) -> tuple[Artifact, ...]:  # noqa: ARG001
    """Diagnose a campaign and return the parameters; see `export_from`.

    Raises BadInputError where `path` is a result folder, which has no runs; RefusedError where too few end poses with
    headings were measured, or the vehicle moves sideways.
    """
    campaign, diagnosis = diagnosed(path, progress)
    noise = motion_noise(diagnosis)
    named = ", ".join(cause.effect for cause in diagnosis.corrected_causes) or "nothing"
    notes = [f"the odometry is taken as corrected by: {named}; on the vehicle, correct it likewise"]
    if diagnosis.causes and not diagnosis.recommended:
        notes.append("this correction is not recommended: see calib diagnose")
    if noise.undetermined:
        listed = ", ".join(noise.undetermined)
        notes.append(
            f"these runs say nothing of {listed}: the default of {DEFAULT_ALPHA:g} stands; drive turns and ways"
        )
    if noise.beyond_form:
        notes.append(
            f"AMCL's model cannot spread as these runs do, observed over predicted is {_listed(noise.form)}: errors "
            f"stay the same during a run and differ between runs; look for their cause with calib diagnose, or set all "
            f"alphas {noise.cover:.2f} times as large, so that none of the three is understated"
        )
        near = ", ".join(each.kind for each in noise.by_kind if not is_beyond(each.form))
        if near:
            notes.append(f"alphas of their own meet the runs of {near} alone; the file has them by kind of run")
    text = parameters_text(noise, campaign.name, named, simulated=campaign.simulated)
    return (Artifact("nav2_odometry.yaml", text.encode(), tuple(notes)),)


def motion_noise(diagnosis: Diagnosis) -> MotionNoise:
    """Return the noise of the odometry corrected by a diagnosis, from the end poses of held-out runs."""
    observations = diagnosis.observations
    if observations.aside_m is not None:
        raise RefusedError(
            f"{diagnosis.campaign}: found a vehicle that moves sideways; expected two wheels on an axle, whose "
            "motion model is AMCL's differential one; set the omnidirectional model by hand"
        )
    units = np.asarray(observations.usable[:, POSE].all(axis=1))
    if units.sum() < FEWEST_RUNS:
        raise RefusedError(
            f"{diagnosis.campaign}: found {int(units.sum())} end poses with a heading; expected {FEWEST_RUNS} at "
            "least; a spread needs them: measure ref_x_m, ref_y_m and ref_theta_rad at the end of each run"
        )
    residuals, kinds = diagnosis.held_out.after[units][:, POSE], observations.labels["kind"][units]
    path = diagnosis.correction.path
    models = amcl, walk, constant = tuple(pose_spread.spread_of(path, units, model) for model in pose_spread.MODELS)
    found, form = pose_spread.fitted(amcl, residuals, kinds), form_ratios(amcl, (walk, constant), residuals)
    unknown = undetermined(amcl, found.sizes)
    alphas = dict(zip(ALPHAS, map(float, found.sizes), strict=True))
    return MotionNoise(
        n_runs=int(units.sum()),
        length_m=float(np.median(observations.length_m[units])),
        turn_rad=float(np.median(observations.total(np.abs(diagnosis.correction.path.steps.turn_rad))[units])),
        alphas={**alphas, **dict.fromkeys(unknown, DEFAULT_ALPHA)},
        undetermined=unknown,
        walks=dict(zip(walk.names, map(float, sizes_of(walk, residuals)), strict=True)),
        held_out=found,
        form=form,
        by_kind=kind_noise(models, residuals, kinds) if is_beyond(form) else (),
    )


def parameters_text(noise: MotionNoise, campaign: str, corrected: str, *, simulated: bool) -> str:
    """Return the parameter file of a noise; `corrected`: by what the odometry is corrected."""
    held_out = zip(CHANNELS, noise.held_out.ratios, noise.held_out.interval, strict=True)
    return (
        templates_of(__package__)
        .get_template("nav2.yaml.j2")
        .render(
            noise=noise,
            campaign=campaign,
            corrected=corrected,
            simulated=simulated,
            ratios=[f"{name} {ratio:.2f} ({low:.2f} to {high:.2f})" for name, ratio, (low, high) in held_out],
            listed=_listed,
            rounded=lambda value: number(float(f"{value:.{DIGITS}g}")),
            ascii_line=ascii_line,
            filter=pose_spread,
            speed_mps=SPEED_MPS,
            rate_Hz=RATE_HZ,
        )
    )


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in zip(CHANNELS, values, strict=True))
