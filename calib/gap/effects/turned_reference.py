"""A reference whose sensor is mounted turned by a large angle: found in closed form before anything finer is asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.data.channels import POSE, Channel
from calib.gap.effects.reference_yaw import ReferenceYaw
from calib.gap.predict.path import Path
from calib.gap.predict.residuals import residuals

#: a smaller angle is left to `ReferenceYaw`, whose form is linear in it: at 0.1 rad it errs by a two-hundredth
LEAST_RAD: Final = 0.1
#: a turned reference keeps lengths; one that stretches them by more is another fault
STRETCH: Final = 0.2
#: a turn and a place are two unknowns of each run's two: with fewer runs they explain anything
FEWEST: Final = 4
#: what the angle leaves is less than this share of what it explains, and what bends the heading less than this of it
CLOSES: Final = 0.2
#: by how much the end's heading may be off where none is measured: radii unequal by a hundredth, over ten tracks
BENT_RAD: Final = 0.1
#: of an angle, two standard uncertainties are 95 %
COVERAGE: Final = 2.0


@dataclass(frozen=True, slots=True)
class TurnedReference:
    """The angle by which the sensor's axes are turned against the vehicle's, beyond what the campaign states."""

    effect = ReferenceYaw
    label = "the sensor is mounted turned"
    #: yaw_rad, sd_rad: the angle and its standard uncertainty
    yaw_rad: float
    sd_rad: float

    @property
    def remark(self) -> str:
        """What to do about it."""
        return f"state sensor_yaw_rad = {self.yaw_rad:.4f} in [reference] of campaign.toml, then diagnose again"

    @property
    def sizes(self) -> Mapping[str, tuple[float, tuple[float, float], str]]:
        """Value, 95 % interval and unit of its parameter."""
        half = COVERAGE * self.sd_rad
        return {"yaw": (self.yaw_rad, (self.yaw_rad - half, self.yaw_rad + half), "rad")}

    def put_right(self, campaign: Campaign) -> Campaign:
        """Return the campaign with the sensor's yaw stated."""
        reference = campaign.reference
        yaw_rad = float(np.angle(np.exp(1j * (reference.sensor_yaw_rad + self.yaw_rad))))
        return replace(campaign, reference=replace(reference, sensor_yaw_rad=yaw_rad))


def find_turned(nominal: Path) -> TurnedReference | None:
    """Return the large angle by which the reference is turned; None where there is none, or it explains too little.

    A sensor at the place l on the vehicle and turned by psi sees the end z of a run that turned by theta as
    ``exp(-i psi) (z + (exp(i theta) - 1) l)``: least squares in two complex unknowns.
    """
    observations = nominal.s
    on = observations.usable[:, POSE].all(axis=1)
    if on.sum() < FEWEST or np.isfinite(observations.simulated).any():
        return None
    end = nominal.end[on, 0] + 1j * nominal.end[on, 1]
    seen = observations.measured[on, Channel.ALONG] + 1j * observations.measured[on, Channel.LATERAL]
    turned = np.exp(1j * nominal.end[on, 2]) - 1.0
    # a place within a metre, ends good to some centimetres; without turns there is nothing to see of it
    columns, prior = np.stack([end, turned], axis=1), np.diag([0.0, 1e-3])
    turn, place = np.linalg.solve(columns.conj().T @ columns + prior, columns.conj().T @ seen)
    yaw_rad = -float(np.angle(turn))
    if abs(abs(turn) - 1.0) > STRETCH:
        return None
    left_m2 = float(np.sum(np.abs(seen - turn * end - place * turned) ** 2))
    by_place = turned.conj() @ (seen - end) / (turned.conj() @ turned + 1e-3)
    before_m2 = float(np.sum(np.abs(seen - end - by_place * turned) ** 2))
    headed = observations.usable[:, Channel.HEADING]
    # radii that bend the path turn its end, and the heading there by twice as much: a mounting leaves that alone
    heading = residuals(nominal, nominal)[headed, Channel.HEADING]
    bent_rad = float(np.sqrt(np.mean(heading**2))) if headed.any() else BENT_RAD
    if abs(yaw_rad) < max(LEAST_RAD, bent_rad / CLOSES) or left_m2 > CLOSES**2 * before_m2:
        return None
    sd_rad = float(np.sqrt(left_m2 / (2 * (len(seen) - 2)) / np.sum(np.abs(end) ** 2)))
    return TurnedReference(yaw_rad, sd_rad)
