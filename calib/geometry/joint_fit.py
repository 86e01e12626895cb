"""The parameters that data determine, found together: one division into stretches, one fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.wheels import mecanum_model
from calib.errors import RefusedError
from calib.geometry.clusters import Clustering, clustered
from calib.geometry.drives import Differential, Drive, FrontWheel, MeanHeld, Mecanum
from calib.geometry.identifiability import NOMINAL_STD, loosest, scale_is_open, scale_is_weakest, weakest
from calib.geometry.model import Model
from calib.geometry.parameters import SENSOR, Parameters, sensor_parameters
from calib.geometry.recording import Recording
from calib.geometry.segments import Segments
from calib.geometry.solve import Solution, solve

if TYPE_CHECKING:
    from calib.campaign.model import Campaign

#: random walks of heading and distance to begin with, per metre
WALKS: Final = (2.5e-7, 2.5e-7)
#: a delay is sought where samples are at most so far apart
LONGEST_STEP_S: Final = 0.25
#: loads that vary by less than this part of their mean say nothing of a slope
LOADS_VARY: Final = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One estimate with what stands behind it."""

    model: Model
    parameters: Parameters
    solution: Solution
    clustering: Clustering
    dropped: tuple[str, ...]

    @property
    def spread(self) -> float:
        """Mean logarithm of the drive parameters' standard deviations beside their prior ones."""
        n_drive = len(self.parameters.items) - len(SENSOR)
        free = self.parameters.free
        std = self.parameters.prior_std.copy()
        std[free] = self.clustering.uncertainty.apart
        if isinstance(self.model.drive, MeanHeld):
            # what is held is no better known for that
            std[:n_drive] = np.hypot(std[:n_drive], NOMINAL_STD * self.solution.values[:n_drive])
        return float(np.mean(np.log(std[:n_drive] / self.parameters.prior_std[:n_drive])))


def drive_of(campaign: Campaign, source: str, recording: Recording) -> Drive:
    """Return the drive with its nominal values.

    `campaign`: its vehicle, and its model of the wheels; `source` ({"rear", "front", "wheels"}); `recording`: says
    whether the loads varied, so that radii have slopes.
    """
    vehicle, model = campaign.vehicle, campaign.model
    if source == "front":
        return FrontWheel(vehicle.front_radius_m, vehicle.wheelbase_m)
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
) -> Fitted:
    """Estimate, and leave out what the data cannot determine, one parameter at a time; see `Fitted`.

    `sensor`: estimate the pose of the reference's sensor and its delay, too; `start`: a fit to begin from.
    """
    reference = campaign.reference
    place = sensor_parameters(reference.sensor_x_m, reference.sensor_y_m, reference.sensor_yaw_rad)
    items = (*drive.parameters, *place)
    free = [item.name for item in drive.parameters]
    dropped: list[str] = []
    if sensor:
        free += list(SENSOR)
        if float(np.median(np.diff(recording.t_s))) > LONGEST_STEP_S:
            free.remove("delay_s")
            dropped.append("delay_s")
    parameters = Parameters.of(items, free)
    model = Model(drive, recording, segments)
    scales = np.array([reference.sigma_xy_m**2, reference.sigma_theta_rad**2, *WALKS])
    values = parameters.nominal
    if start is not None and start.model.drive == drive:
        values = np.where(parameters.free, start.solution.values, values)
    while True:
        if not parameters.free.any():
            raise RefusedError(
                f"geometry of {campaign.name!r}: found nothing that these runs determine; expected runs with turns and "
                "straights and a reference of their end poses; drive squares both ways"
            )
        solution = solve(model, parameters, values, scales)
        loose = weakest(solution, parameters)
        wheels = drive if isinstance(drive, Differential) and not drive.slopes and parameters.free[:3].all() else None
        if loose is not None and wheels is not None and scale_is_weakest(solution, parameters):
            return fit_parameters(campaign, MeanHeld(wheels), recording, segments, sensor)
        if loose is None:
            clustering = clustered(solution, parameters, recording, segments)
            loose = loosest(clustering.uncertainty.std, parameters)
            covariance = clustering.uncertainty.covariance[:3, :3]
            if wheels is not None and scale_is_open(covariance, solution.values[:3]):
                return fit_parameters(campaign, MeanHeld(wheels), recording, segments, sensor)
            if loose is None:
                return Fitted(model, parameters, solution, clustering, tuple(dropped))
        dropped.append(loose)
        parameters = parameters.without([loose])
        values = np.where(parameters.free, solution.values, parameters.nominal)
