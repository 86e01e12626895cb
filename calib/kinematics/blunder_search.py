"""Search for blunders: each hypothesis corrects the recording, and the one that explains the data is named.

A hypothesis (other units, axes, columns, wraps) changes the recording, and the vehicle's parameters are fitted again
within plausible bounds. Residuals are compared relative to the distance travelled, so that no unit makes them small by
itself; a blunder is named only where its correction leaves a small part of the uncorrected residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.errors import CalibError
from calib.kinematics.adequacy import FEW_OUTLIERS, travelled
from calib.kinematics.blunders import Fault
from calib.kinematics.drives import STEERING_SCALE, Drive, Parameters, first_scales, parameters_of
from calib.kinematics.joint_fit import drive_of
from calib.kinematics.model import Model, Segments
from calib.kinematics.readings import Change, Reading, readings, unchanged
from calib.kinematics.recording import Recording
from calib.kinematics.solve import solve
from calib.types import FloatArray

if TYPE_CHECKING:
    from calib.campaign.model import Campaign

#: a reading is named where it leaves less than this part of what the recording as it stands leaves: a quarter of its
#: mean square
CLEARLY_LESS: Final = 0.5
#: and less than this share of the distance travelled: what a calibrated vehicle may leave
SMALL_SHARE: Final = 0.03
#: a right reading's displacements are as long as those of the wheels, within this factor, and point their way, in rad:
#: lengths and mounting angles stay within it
SAME_LENGTH: Final = 1.3
SAME_WAY_RAD: Final = 0.3
#: linearisations of a trial: a right reading is near its end after four, a wrong one never
TRIAL_ROUNDS: Final = 6
#: of these, those that estimate the noise: it only weighs position against heading, and costs most of a trial
TRIAL_NOISE_ROUNDS: Final = 1
#: readings that leave no more than this much of the least are alike: the first of them, the simplest, is named
ALIKE: Final = 1.3
#: lengths further from nominal are no calibration
PLAUSIBLE_CHANGE: Final = 0.2
#: turns of less say little: added to the total absolute rotation that heading residuals are taken relative to
LEAST_TURN_RAD: Final = 0.2
Divide = Callable[["Campaign", Recording], Segments]


@dataclass(frozen=True, slots=True)
class Trial:
    """Residuals under a hypothesis, and whether it is plausible."""

    #: residual, root mean square, as a share of the distance and rotation
    share: float
    #: lengths are near nominal, and displacements as long as those of the wheels and of their direction
    plausible: bool
    #: angle by which the reference's displacements are turned against those of the wheels
    turned_rad: float
    #: fitted mean radius over the nominal one, and scale of the steering angle
    scales: tuple[float, float] = (1.0, 1.0)


def find_blunder(
    campaign: Campaign, recording: Recording, source: str, divide: Divide
) -> tuple[Campaign, Recording, Fault] | None:
    """Return settings and recording corrected, and the blunder; None where no reading explains the data.

    Parameters
    ----------
    campaign
        States vehicle, encoder and noise of the reference.
    recording
        As it stands.
    source : {"rear", "front", "wheels", "shaft"}
        Which wheels drive the odometry.
    divide
        Cuts a recording into the segments that are compared, by the nominal vehicle of a campaign.
    """
    per_rev = float(campaign.encoder.counts_per_rev_left or campaign.encoder.front)
    drive = drive_of(campaign, source, recording)

    def tried(change: Change, setting: Callable[[Campaign], Campaign] | None = None) -> Trial:
        stated = setting(campaign) if setting else campaign
        return _tried(stated, change(recording), drive_of(stated, source, recording) if setting else drive, divide)

    as_it_stands = tried(unchanged)
    # a fit of lengths that no vehicle has explains nothing
    enough = min(SMALL_SHARE, CLEARLY_LESS * as_it_stands.share if as_it_stands.plausible else SMALL_SHARE)
    best: list[tuple[Trial, Reading]] = []
    for reading in readings(recording, per_rev, drive, as_it_stands.turned_rad, plausible=as_it_stands.plausible):
        trial = tried(reading.change, reading.setting)
        if not trial.plausible or trial.share >= enough:
            continue
        without = tried(reading.zeroed) if reading.zeroed else None
        if without is None or not without.plausible or trial.share < CLEARLY_LESS * without.share:
            best.append((trial, reading))
    if not best:
        return None
    least = min(trial.share for trial, _ in best)
    trial, chosen = next(each for each in best if each[0].share <= ALIKE * least)
    if chosen.refined is not None:
        chosen = chosen.refined(trial.scales)
    return chosen.setting(campaign) if chosen.setting else campaign, chosen.change(recording), chosen.blunder


def _tried(campaign: Campaign, recording: Recording, drive: Drive, divide: Divide) -> Trial:
    """Return the residuals of a fit of the drive's parameters to a recording."""
    items = parameters_of(drive, campaign.reference)
    parameters = Parameters.of(items, [item.name for item in drive.parameters])
    try:
        segments = divide(campaign, recording)
        model = Model(drive, recording, segments)
        with np.errstate(all="ignore"):
            scales = first_scales(campaign.reference)
            values = solve(model, parameters, parameters.nominal, scales, TRIAL_ROUNDS, TRIAL_NOISE_ROUNDS).values
            residuals = model.predict(values).residuals
            path, rotation = travelled(model, values)
    except (CalibError, np.linalg.LinAlgError, ValueError):
        return Trial(np.inf, False, 0.0)
    share = np.square(np.hypot(residuals[:, 0], residuals[:, 1]) / np.maximum(path, 1e-9))
    share += np.square(residuals[:, 2] / (rotation + LEAST_TURN_RAD))
    change = np.array(
        [
            value / item.nominal - 1.0
            for value, item in zip(values, drive.parameters, strict=False)
            if item.nominal and not item.name.startswith("steering") and not item.name.startswith("slope")
        ]
    )
    told = segments.measured - residuals
    ahead, seen = told[:, 0] + 1j * told[:, 1], segments.measured[:, 0] + 1j * segments.measured[:, 1]
    turned = float(np.angle(np.vdot(ahead, seen)))
    stretched = float(np.sum(np.abs(seen)) / max(float(np.sum(np.abs(ahead))), 1e-12))
    near = bool((np.abs(change) < PLAUSIBLE_CHANGE).all()) and 1.0 / SAME_LENGTH < stretched < SAME_LENGTH
    found = dict(zip(parameters.names, values.tolist(), strict=True))
    radii = [found[item.name] / item.nominal for item in drive.parameters if "radius" in item.name]
    near = near and abs(turned) < SAME_WAY_RAD
    return Trial(_trimmed(share), near, turned, (float(np.mean(radii)), found.get(STEERING_SCALE, 1.0)))


def _trimmed(squares: FloatArray) -> float:
    """Return the root of the mean of squares without the largest, so that few bad runs do not hide a reading."""
    if not len(squares) or not np.isfinite(squares).all():
        return np.inf
    kept = len(squares) - max(1, int(FEW_OUTLIERS * len(squares)))
    return float(np.sqrt(np.mean(np.sort(squares)[: max(kept, 1)])))
