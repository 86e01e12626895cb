"""Search for blunders that explain a recording.

A blunder (units, axes, columns, wraps) is named where its correction, parameters fitted again, leaves a small part of
the residuals.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.errors import CalibError
from calib.kinematics import Recording, drives
from calib.kinematics.adequacy import FEW_OUTLIERS, travelled
from calib.kinematics.blunders import Fault
from calib.kinematics.joint_fit import drive_of
from calib.kinematics.model import Model, Segments
from calib.kinematics.readings import Change, Reading, Setting, implausible, readings, unchanged
from calib.kinematics.solve import LONGEST, RIDGE, solve
from calib.types import FloatArray

#: a reading is named that leaves less than this part of what the recording leaves: a quarter in squares
CLEARLY_LESS: Final = 0.5
#: and less than this share of the distance travelled: what a calibrated vehicle may leave
SMALL_SHARE: Final = 0.03
#: a right reading's displacements are as long as the wheels' within this factor, and point their way (rad)
SAME_LENGTH: Final = 1.3
SAME_WAY_RAD: Final = 0.3
#: axes turned by less are a sensor's mounting, which is estimated
LEAST_ANGLE_RAD: Final = 0.02
#: by whole runs it is not, and a smaller turn moves their ends by less than the usual drift
LEAST_OF_RUNS_RAD: Final = 0.003
#: linearisations of a trial: a right reading is near its end after four, a wrong one never
TRIAL_ROUNDS: Final = 6
#: of these, those that estimate the noise, which costs most of a trial
TRIAL_NOISE_ROUNDS: Final = 1
#: and up to a step of less log likelihood
TRIAL_STEADY: Final = 0.1
#: a reading twice as far off in a rough fit is not tried: a wrong one leaves ten times as much
SCREENED: Final = 2.0
#: spread over all runs, these tell as well: a reading holds for every run
SCREENED_RUNS: Final = 24
#: readings within this factor of the least are alike: the first, the simplest, is named
ALIKE: Final = 1.3
#: lengths further from nominal are no calibration
PLAUSIBLE_CHANGE: Final = 0.2
#: of the sensor, found beside the lengths; its yaw would be a reading's
PLACE: Final = ("sensor_x_m", "sensor_y_m", "delay_s")
MOUNTED: Final = (*PLACE, "sensor_yaw_rad")
Divide = Callable[["Campaign", Recording], Segments]


@dataclass(frozen=True, slots=True)
class Trial:
    """Residuals under a hypothesis."""

    #: rms residual as a share of the distance and rotation
    share: float
    #: lengths near nominal, displacements of the wheels' length and direction
    plausible: bool
    #: the reference's displacements against the wheels'
    turned_rad: float
    #: fitted mean radius over the nominal one, and scale of the steering angle
    scales: tuple[float, float] = (1.0, 1.0)


def find_blunder(
    campaign: Campaign, recording: Recording, source: str, divide: Divide
) -> tuple[Campaign, Recording, Fault] | None:
    """Return corrected settings and recording, and the blunder; None where none explains the data.

    `source`: one of `WHEEL_COLUMNS`; `divide` cuts a recording into segments by a campaign's nominal vehicle.
    """
    try:
        whole = divide(campaign, recording).are_runs_of(recording)
    except CalibError:
        return None
    per_rev = float(campaign.encoder.counts_per_rev_left or campaign.encoder.front)
    drive = drive_of(campaign, source, recording)
    few = recording.select(np.linspace(0, len(recording) - 1, min(SCREENED_RUNS, len(recording)), dtype=np.int64))

    def tried(
        change: Change, setting: Setting | None = None, sensor: tuple[str, ...] = PLACE, *, screened: bool = False
    ) -> Trial:
        stated = setting(campaign) if setting else campaign
        driven = drive_of(stated, source, recording) if setting else drive
        if screened and _hopeless(stated, change(few), driven, divide):
            return Trial(np.inf, False, 0.0)
        return _tried(stated, change(recording), driven, divide, sensor)

    as_it_stands, without = tried(unchanged), cache(partial(tried, screened=True))
    turned = as_it_stands if whole else tried(unchanged, sensor=MOUNTED, screened=True)
    enough = min([SMALL_SHARE, *(CLEARLY_LESS * trial.share for trial in (as_it_stands, turned) if trial.plausible)])
    best: list[tuple[Trial, Reading]] = []
    turned_rad = as_it_stands.turned_rad
    if abs(turned_rad) < (LEAST_OF_RUNS_RAD if whole else LEAST_ANGLE_RAD):
        turned_rad = 0.0
    for reading in readings(recording, per_rev, drive, turned_rad, plausible=as_it_stands.plausible):
        trial = tried(reading.change, reading.setting, screened=True)
        if trial.plausible and trial.share >= enough and not whole:
            trial = tried(reading.change, reading.setting, MOUNTED)
        if not trial.plausible or trial.share >= enough:
            continue
        zeroed = without(reading.zeroed) if reading.zeroed else None
        if zeroed is None or not zeroed.plausible or trial.share < CLEARLY_LESS * zeroed.share:
            best.append((trial, reading))
    if not best:
        return None
    least = min(trial.share for trial, _ in best)
    trial, chosen = next(each for each in best if each[0].share <= ALIKE * least)
    if chosen.refined is not None:
        chosen = chosen.refined(trial.scales)
    return chosen.setting(campaign) if chosen.setting else campaign, chosen.change(recording), chosen.blunder


def _model_of(
    campaign: Campaign, recording: Recording, drive: drives.Drive, divide: Divide, sensor: tuple[str, ...]
) -> tuple[Model, drives.Parameters]:
    model = Model(drive, recording, divide(campaign, recording))
    # whole runs do not tell a lever arm from other readings
    placed = () if model.segments.are_runs_of(recording) else sensor
    items = drives.parameters_of(drive, campaign.reference)
    return model, drives.Parameters.of(items, [*(item.name for item in drive.parameters), *placed])


def _hopeless(campaign: Campaign, recording: Recording, drive: drives.Drive, divide: Divide) -> bool:
    try:
        model, parameters = _model_of(campaign, recording, drive, divide, MOUNTED)
        if not model.segments.seen[:, 2].all():
            return False
        with np.errstate(all="ignore"):
            values, share = _rough_fit(model, parameters, SCREENED * SMALL_SHARE)
    except (CalibError, np.linalg.LinAlgError, ValueError):
        return True
    return not (_near_nominal(campaign, drive, values, SCREENED * PLAUSIBLE_CHANGE) and share < SCREENED * SMALL_SHARE)


def _near_nominal(campaign: Campaign, drive: drives.Drive, values: FloatArray, most: float) -> bool:
    return not any(
        implausible(item.name, float(value) / item.nominal, most, campaign.vehicle.drive)
        for item, value in zip(drive.parameters, values, strict=False)
        if item.nominal and not item.name.startswith(("steering", "slope"))
    )


def _tried(
    campaign: Campaign, recording: Recording, drive: drives.Drive, divide: Divide, sensor: tuple[str, ...]
) -> Trial:
    scales = drives.first_scales(campaign.reference)
    rounds = (TRIAL_ROUNDS, TRIAL_NOISE_ROUNDS, TRIAL_STEADY)
    try:
        model, parameters = _model_of(campaign, recording, drive, divide, sensor)
        with np.errstate(all="ignore"):
            solution = solve(model, parameters, parameters.nominal, scales, *rounds)
            values, residuals = solution.values, solution.prediction.residuals
            share = _trimmed(np.square(residuals / _sizes(model, values)).sum(axis=1))
    except (CalibError, np.linalg.LinAlgError, ValueError):
        return Trial(np.inf, False, 0.0)
    measured = model.segments.measured
    ahead, seen = (part[:, 0] + 1j * part[:, 1] for part in (measured - residuals, measured))
    turned = float(np.angle(np.vdot(ahead, seen)))
    stretched = float(np.sum(np.abs(seen)) / max(float(np.sum(np.abs(ahead))), 1e-12))
    by_name = dict(zip(parameters.names, values.tolist(), strict=True))
    near = 1.0 / SAME_LENGTH < stretched < SAME_LENGTH and abs(turned) < SAME_WAY_RAD
    near = near and _near_nominal(campaign, drive, values, PLAUSIBLE_CHANGE)
    scale = float(np.mean([by_name[item.name] / item.nominal for item in drive.parameters if "radius" in item.name]))
    return Trial(share, near, turned, (scale, by_name.get(drives.STEERING_SCALE, 1.0)))


#: turns of less say little: added to the rotation
LEAST_TURN_RAD: Final = 0.2
#: solutions of each step, weighed by what the last one leaves
REWEIGHTED: Final = 6


def _rough_fit(model: Model, parameters: drives.Parameters, most: float) -> tuple[FloatArray, float]:
    # turns first, nearly linear; nominal values where a step leaves more than a share `most`
    values, free, spread = parameters.nominal, parameters.free, parameters.prior_std[parameters.free]
    sizes = _sizes(model, values)
    for turns in (True, True, False):
        if turns:
            residuals, jacobian = (each[:, None] for each in model.turns(values))
        else:
            residuals, jacobian = (prediction := model.predict(values)).residuals, prediction.jacobian
        size = sizes[:, -residuals.shape[1] :]
        step, share = _step(residuals / size, jacobian[:, :, free] * spread / size[:, :, None], most)
        if not share < most:
            return parameters.nominal, share
        values[free] += spread * step / (max(float(np.abs(step).max()) / LONGEST, 1.0) if turns else 1.0)
    return values, share


def _sizes(model: Model, values: FloatArray) -> FloatArray:
    path, rotation = travelled(model, values)
    path = np.maximum(path, 1e-9)
    return np.stack([path, path, rotation + LEAST_TURN_RAD], axis=1)


def _step(residuals: FloatArray, jacobian: FloatArray, most: float) -> tuple[FloatArray, float]:
    flat, left = jacobian.reshape(-1, jacobian.shape[2]), residuals
    for _ in range(REWEIGHTED):
        weights = 1.0 / (1.0 + np.square(left / most).sum(axis=1))
        scaled = flat * np.repeat(weights, residuals.shape[1])[:, None]
        normal = scaled.T @ flat
        normal.flat[:: len(normal) + 1] += RIDGE * max(float(np.trace(normal)), 1e-9)
        step = np.linalg.solve(normal, residuals.ravel() @ scaled)
        left = residuals - jacobian @ step
    return step, _trimmed(np.square(left).sum(axis=1))


def _trimmed(squares: FloatArray) -> float:
    if not len(squares) or not np.isfinite(squares).all():
        return np.inf
    kept = len(squares) - max(1, int(FEW_OUTLIERS * len(squares)))
    return float(np.sqrt(np.mean(np.sort(squares)[: max(kept, 1)])))
