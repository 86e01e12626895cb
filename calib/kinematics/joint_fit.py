"""Joint estimation of the parameters that the data determine; the others are held at nominal and named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.wheels import mecanum_model
from calib.errors import RefusedError
from calib.kinematics.drives import (
    GYRO_SCALE,
    SENSOR,
    Differential,
    Drive,
    FrontWheel,
    MeanHeld,
    Mecanum,
    Parameters,
    first_scales,
    parameters_of,
)
from calib.kinematics.model import Model, Segments, rear_shaft
from calib.kinematics.recording import Recording
from calib.kinematics.solve import Solution, planned, solve
from calib.kinematics.uncertainty import Clustering, clustered, expected, whitened
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.campaign.model import Campaign

#: a direction in which data leave more than this part of the prior spread is not determined
TOLERATED: Final = 0.5
#: how well the scale of radii and track is known beforehand, relative
NOMINAL_STD: Final = 0.01
#: part that each of three parameters has in a direction in which all grow alike; 0.58 where they do so exactly
ALIKE: Final = 0.3


def weakest(solution: Solution, parameters: Parameters) -> str | None:
    """Return the parameter that the least determined direction is mostly made of; None where all are determined.

    `solution`: its whitened Jacobian, in units of the prior spread of each parameter, is decomposed; `parameters`:
    which are free, and their prior spread.
    """
    singular, directions = _directions(solution, parameters)
    if singular[-1] * TOLERATED >= 1.0:
        return None
    return parameters.free_names[int(np.argmax(np.abs(directions[-1])))]


def scale_is_open(covariance: FloatArray, values: FloatArray) -> bool:
    """Return whether data know the common scale of radii and track less well than their nominal values do.

    `covariance` (shape (3, 3)): of both radii and the track; `values` (shape (3,)).
    """
    return bool(np.mean(covariance / np.outer(values, values)) > NOMINAL_STD**2)


def scale_is_weakest(solution: Solution, parameters: Parameters) -> bool:
    """Return whether the least determined direction is that in which radii and track grow alike.

    `solution`: of two wheels on one axle; `parameters`: both radii and the track come first and are free.
    """
    return bool(np.min(np.abs(_directions(solution, parameters)[1][-1, :3])) > ALIKE)


def loosest(std: FloatArray, parameters: Parameters) -> str | None:
    """Return the parameter whose standard deviation is largest beside its prior spread, where that is too large.

    `std` (shape (n_free,)): standard deviations that allow for shared noise; `parameters`: which are free, and their
    prior spread.
    """
    ratio = std / parameters.prior_std[parameters.free]
    at = int(np.argmax(ratio))
    return parameters.free_names[at] if ratio[at] > TOLERATED else None


def _directions(solution: Solution, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """Return singular values of the whitened Jacobian in units of the prior spread, and its directions as rows."""
    free = parameters.free
    jacobian = whitened(solution, free)[0] * parameters.prior_std[free]
    _, singular, directions = np.linalg.svd(jacobian.reshape(-1, int(free.sum())), full_matrices=False)
    return singular, directions


#: a delay is sought where samples are at most so far apart
LONGEST_STEP_S: Final = 0.25
#: loads that vary by less than this part of their mean say nothing of a slope
LOADS_VARY: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class OwnZeros:
    """Steering zeros of single recordings, which the angles of the fit's recording are corrected for."""

    #: with the angles as they were logged
    logged: Recording
    #: standard deviation of the zeros about the common one
    spread_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A fit: model, parameters, solution and covariance."""

    model: Model
    parameters: Parameters
    solution: Solution
    clustering: Clustering
    dropped: tuple[str, ...]
    #: where each recording has a steering zero of its own
    own_zeros: OwnZeros | None = None

    @property
    def logged(self) -> Recording:
        """The recording with the steering angles as they were logged."""
        return self.own_zeros.logged if self.own_zeros else self.model.recording

    @property
    def spread(self) -> float:
        """Mean logarithm of the drive parameters' standard deviations beside their prior ones."""
        n_drive = len(self.parameters.items) - len(SENSOR)
        free = self.parameters.free
        std = self.parameters.prior_std.copy()
        std[free] = self.clustering.uncertainty.apart
        if isinstance(self.model.drive, MeanHeld):
            # holding the mean does not improve the knowledge of it
            std[:n_drive] = np.hypot(std[:n_drive], NOMINAL_STD * self.solution.values[:n_drive])
        return float(np.mean(np.log(std[:n_drive] / self.parameters.prior_std[:n_drive])))


def drive_of(campaign: Campaign, source: str, recording: Recording) -> Drive:
    """Return the drive with its nominal values.

    `campaign`: its vehicle, and its model of the wheels; `source` (one of `WHEEL_COLUMNS`); `recording`: says
    whether the loads varied, so that radii have slopes.
    """
    vehicle, model = campaign.vehicle, campaign.model
    if source == "front":
        return FrontWheel(vehicle.front_radius_m, vehicle.wheelbase_m)
    if source == "shaft":
        return rear_shaft(vehicle.wheel_radius_m, vehicle.wheelbase_m, recording.steps)
    if source == "wheels":
        wheels = mecanum_model(campaign)
        return Mecanum(wheels.radius_m, wheels.arm_m)
    loads = recording.steps.load_offset_N
    varied = loads is not None and bool(np.all(np.ptp(loads, axis=1) > LOADS_VARY * max(model.reference_load_N, 1.0)))
    return Differential(
        model.radius_left_m,
        model.radius_right_m,
        model.track_m,
        slopes=varied,
        slope_left_m_per_N=model.slope_left_m_per_N,
        slope_right_m_per_N=model.slope_right_m_per_N,
    )


def fit_parameters(
    campaign: Campaign,
    drive: Drive,
    recording: Recording,
    segments: Segments,
    sensor: bool,
    start: Fitted | None = None,
    known: FloatArray | None = None,
) -> Fitted:
    """Estimate, and leave out what the data cannot determine, one parameter at a time; see `Fitted`.

    `sensor`: estimate the pose of the reference's sensor and its delay, too; `start`: a fit to begin from;
    `known`: variances of the noise, shape (4,), for runs that are not driven yet.
    """
    free = [item.name for item in drive.parameters]
    dropped: list[str] = []
    if segments.gyro.any():
        free.append(GYRO_SCALE)
    if sensor:
        free += [name for name in SENSOR if name != GYRO_SCALE]
        if float(np.median(np.diff(recording.t_s))) > LONGEST_STEP_S:
            free.remove("delay_s")
            dropped.append("delay_s")
    parameters = Parameters.of(parameters_of(drive, campaign.reference), free)
    model = Model(drive, recording, segments)
    values = parameters.nominal
    if start is not None and start.model.drive == drive:
        values = np.where(parameters.free, start.solution.values, values)
    while True:
        if not parameters.free.any():
            raise RefusedError(
                f"geometry of {campaign.name!r}: found nothing that these runs determine; expected runs with turns and "
                "straights and a reference of their end poses; drive squares both ways"
            )
        solution = (
            solve(model, parameters, values, first_scales(campaign.reference))
            if known is None
            else planned(model, values, known)
        )
        loose = weakest(solution, parameters)
        wheels = drive if isinstance(drive, Differential) and not drive.slopes and parameters.free[:3].all() else None
        if loose is not None and wheels is not None and scale_is_weakest(solution, parameters):
            return fit_parameters(campaign, MeanHeld(wheels), recording, segments, sensor, known=known)
        if loose is None:
            clustering = (
                clustered(solution, parameters, recording, segments)
                if known is None
                else Clustering("run", expected(solution, parameters.free, segments.run))
            )
            loose = loosest(clustering.uncertainty.std, parameters)
            covariance = clustering.uncertainty.covariance[:3, :3]
            if wheels is not None and scale_is_open(covariance, solution.values[:3]):
                return fit_parameters(campaign, MeanHeld(wheels), recording, segments, sensor, known=known)
            if loose is None:
                return Fitted(model, parameters, solution, clustering, tuple(dropped))
        dropped.append(loose)
        parameters = parameters.without([loose])
        values = np.where(parameters.free, solution.values, parameters.nominal)
