"""Mistakes of the reference's mounting too large for a linear effect: axes turned or mirrored, a sensor elsewhere."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.effects import Effect
from calib.gap.effects.reference import ReferenceLatency, ReferenceLeverArm, ReferenceYaw
from calib.gap.observations import POSE, Channel, Observations
from calib.gap.predict import Path, residuals
from calib.types import ComplexArray, FloatArray, StrArray

#: a smaller angle is left to `ReferenceYaw`, linear in it: at 0.1 rad it errs by a two-hundredth
MIN_TURN_RAD: Final = 0.1
#: a turned reference keeps lengths
MAX_STRETCH: Final = 0.2
#: a turn and a place are unknown: with fewer runs they explain anything
MIN_TURNED_RUNS: Final = 4
#: shares of what the angle explains: what it leaves, and what bends the heading, at most
TURN_RESIDUAL_SHARE: Final = 0.2
#: of an end's heading where none is measured: radii unequal by a hundredth, over ten tracks
HEADING_ERROR_RAD: Final = 0.1
MIRRORED: Final = 0.999  #: confidence at which the scatter of ends tells mirrored axes from turned ones


@dataclass(frozen=True, slots=True)
class TurnedReference:
    """The angle by which the sensor's axes are turned, beyond what the campaign states."""

    effect = ReferenceYaw
    yaw_rad: float
    sd_rad: float  #: standard uncertainty of the angle
    mirrored: bool = False  #: whether y has to be mirrored first
    clockwise: bool = False  #: and headings
    probability: ClassVar[float] = 1.0

    @property
    def label(self) -> str:
        """What is wrong with the axes."""
        if self.clockwise:
            return "y and headings are mirrored" if self.mirrored else "headings are clockwise"
        if not self.mirrored:
            return "the sensor is mounted turned"
        quarter = abs(abs(self.yaw_rad) - np.pi / 2.0) < MIN_TURN_RAD
        return "x and y are exchanged" if quarter else "the axes are mirrored"

    @property
    def remark(self) -> str:
        """What to do about it."""
        state = f"state sensor_yaw_rad = {self.yaw_rad:.4f} in [reference] of campaign.toml"
        if self.clockwise and not self.mirrored:
            return "left turns are positive: change the sign of ref_theta_rad, then diagnose again"
        if not self.mirrored:
            return f"{state}, then diagnose again"
        if self.clockwise:
            return "y is positive to the right: change the signs of ref_y_m and ref_theta_rad, then diagnose again"
        if "exchanged" in self.label:
            signs = "" if self.yaw_rad > 0.0 else ", both with the other sign"
            return f"{self.label}{signs}: correct ref_x_m and ref_y_m, then diagnose again"
        also = "" if abs(self.yaw_rad) < MIN_TURN_RAD else f", {state}"
        return f"y is positive to the right: change the sign of ref_y_m{also}, then diagnose again"

    @property
    def sizes(self) -> Mapping[str, tuple[float, tuple[float, float], str]]:
        """Value, 95 % interval and unit of its parameter."""
        value, half = self.yaw_rad, 2.0 * self.sd_rad
        return {"yaw": (value, (value - half, value + half), "rad")}

    def refined(self, turned_rad: float, sd_rad: float) -> "TurnedReference":
        """Return the mounting turned by so much more, as a fit beside the other causes found."""
        return replace(self, yaw_rad=self.yaw_rad - turned_rad, sd_rad=sd_rad)

    def correct(self, campaign: Campaign) -> Campaign:
        """Return the campaign with the sensor's yaw stated, y mirrored where that is needed."""
        if self.mirrored or self.clockwise:
            runs, logs = campaign.runs, campaign.logs
            mirrored = ("ref_y_m",) * self.mirrored + ("ref_theta_rad",) * self.clockwise
            numbers, columns = (
                {name: -values if name in mirrored else values for name, values in each.items()}
                for each in (runs.numbers, logs.columns)
            )
            campaign = replace(campaign, runs=replace(runs, numbers=numbers), logs=replace(logs, columns=columns))
        reference = campaign.reference
        yaw_rad = float(np.angle(np.exp(1j * (reference.sensor_yaw_rad + self.yaw_rad))))
        return replace(campaign, reference=replace(reference, sensor_yaw_rad=yaw_rad))


def find_turned(nominal: Path) -> TurnedReference | None:
    """Return the large angle by which the reference is turned; None where it explains too little.

    A sensor at the place l on the vehicle and turned by psi sees the end z of a run that turned by theta as
    ``exp(-i psi) (z + (exp(i theta) - 1) l)``: mirrored axes see the conjugate.
    """
    from scipy.special import fdtri

    observations = nominal.s
    on = observations.usable[:, POSE].all(axis=1)
    if on.sum() < MIN_TURNED_RUNS or np.isfinite(observations.simulated).any():
        return None
    headed = observations.usable[:, Channel.HEADING]
    heading = np.where(headed, residuals(nominal, nominal)[:, Channel.HEADING], 0.0)
    # radii that bend a path evenly turn its end by half of what they turn the heading
    end = (nominal.end[on, 0] + 1j * nominal.end[on, 1]) * np.exp(0.5j * heading[on])
    seen = observations.measured[on, Channel.ALONG] + 1j * observations.measured[on, Channel.LATERAL]
    turned = np.exp(1j * (nominal.end[on, 2] + heading[on])) - 1.0
    turn, left_m2 = _turn(end, turned, seen)
    # on a map, start headings are right
    mirrored_seen = seen.conj() * np.exp(-2j * np.nan_to_num(observations.start_pose[on, 2]))
    mirror, mirrored_left_m2 = _turn(end, turned, mirrored_seen)
    # wrong radii leave as much in both, but for the direction of an end
    aimed = np.exp(1j * np.angle(end)) * np.abs(seen)
    aside, mirrored_aside = (_turn(aimed, turned, each)[1] for each in (seen, mirrored_seen))
    by_chance = mirrored_aside * fdtri(len(seen), len(seen), MIRRORED)
    mirrored = mirrored_left_m2 < TURN_RESIDUAL_SHARE**2 * left_m2 or bool(aside > by_chance)
    if mirrored:
        turn, left_m2 = mirror, mirrored_left_m2
    yaw_rad = -float(np.angle(turn))
    if abs(abs(turn) - 1.0) > MAX_STRETCH:
        return None
    by_place = turned.conj() @ (seen - end) / (turned.conj() @ turned + 1e-3)
    before_m2 = float(np.sum(np.abs(seen - end - by_place * turned) ** 2))
    bent_rad = float(np.sqrt(np.mean(heading[headed] ** 2))) if headed.any() else HEADING_ERROR_RAD
    # swapped wheels mirror the headings too, and turn nothing
    angle_rad = max(abs(yaw_rad), float(np.sqrt(np.mean(nominal.end[on, 2] ** 2))) if mirrored else 0.0)
    if angle_rad < max(MIN_TURN_RAD, bent_rad / TURN_RESIDUAL_SHARE) or left_m2 > TURN_RESIDUAL_SHARE**2 * before_m2:
        return None
    sd_rad = float(np.sqrt(left_m2 / (2 * (len(seen) - 2)) / np.sum(np.abs(end) ** 2)))
    return TurnedReference(yaw_rad, sd_rad, mirrored)


def _turn(end: ComplexArray, turned: ComplexArray, seen: ComplexArray) -> tuple[complex, float]:
    # a place within a metre, ends good to some centimetres
    columns, prior = np.stack([end, turned], axis=1), np.diag([1e-9, 1e-3])
    turn, place = np.linalg.solve(columns.conj().T @ columns + prior, columns.conj().T @ seen)
    return complex(turn), float(np.sum(np.abs(seen - turn * end - place * turned) ** 2))


@dataclass(frozen=True, eq=False)
class Restated:
    """A size of the mounting to be stated otherwise, where positions alone tell the heading, too."""

    effect: ClassVar[type[Effect]]
    unit: ClassVar[str]
    label: str  #: of the effect's form
    names: tuple[str, ...]  #: of its parameters
    size: FloatArray  #: shape (n_names,)
    sd: FloatArray  #: standard uncertainties
    probability: float = 1.0

    @property
    def sizes(self) -> Mapping[str, tuple[float, tuple[float, float], str]]:
        """Value, 95 % interval and unit of its parameters."""
        each = zip(self.names, self.size.tolist(), self.sd.tolist(), strict=True)
        return {name: (value, (value - 2.0 * sd, value + 2.0 * sd), self.unit) for name, value, sd in each}

    @property
    def is_shown(self) -> bool:
        """Whether its interval leaves zero out."""
        return bool((np.abs(self.size) > 2.0 * self.sd).any())

    def moved(self, further: FloatArray, sd: FloatArray) -> Self:
        """Return it with what a fit about it found further."""
        return replace(self, size=self.size + further, sd=sd)


class DisplacedSensor(Restated):
    """How far the sensor is from its stated place, where its positions tell the heading, too."""

    effect = ReferenceLeverArm
    unit = "m"

    @property
    def remark(self) -> str:
        """What to do about it."""
        x_m, y_m = self.size.tolist()
        return f"add {x_m:+.4f} to sensor_x_m and {y_m:+.4f} to sensor_y_m in [reference], then diagnose again"

    def correct(self, campaign: Campaign) -> Campaign:
        """Return the campaign with the sensor stated there."""
        (x_m, y_m), stated = self.size.tolist(), campaign.reference
        reference = replace(stated, sensor_x_m=stated.sensor_x_m + x_m, sensor_y_m=stated.sensor_y_m + y_m)
        return replace(campaign, reference=reference)

    def bent_rad(self, observations: Observations) -> FloatArray:
        """Return what it does to the course at start and end, shape (n_obs, 2)."""
        return np.asarray(observations.course_error[:, :, :2] @ self.size)


class LateReference(Restated):
    """How old the reference's readings are, where its positions tell the heading, too; in each session or in all."""

    effect = ReferenceLatency
    unit = "s"

    @property
    def remark(self) -> str:
        """What to do about it."""
        of = [name.replace(ReferenceLatency.DELAY, "", 1).replace("_", " in ", 1) for name in self.names]
        each = ", ".join(f"{size:.3f} s{session}" for size, session in zip(self.size, of, strict=True))
        return f"its readings are {each} old: take that off their times, then diagnose again"

    def correct(self, campaign: Campaign) -> Campaign:
        """Return the campaign with what the wheels did as long before each time: they are logged more often."""
        logs, moved = campaign.logs, {}
        if "t_s" not in logs.columns:
            return campaign
        delay_s = self._of_sessions(campaign.runs.label("session"))
        for name in (name for name in logs.columns if name.startswith(_OF_WHEELS)):
            moved[name] = logs.columns[name].copy()
            for run, log in logs.each(2, "t_s", name):
                known = np.isfinite(log[name])
                before = np.interp(log["t_s"] - delay_s[run], log["t_s"][known], log[name][known])
                moved[name][logs.offsets[run] : logs.offsets[run + 1]] = np.where(known, before, np.nan)
        return replace(campaign, logs=replace(logs, columns={**logs.columns, **moved}))

    def bent_rad(self, observations: Observations) -> FloatArray:
        """Return what it does to the course at start and end, shape (n_obs, 2)."""
        return observations.course_error[:, :, 2] * self._of_sessions(observations.labels["session"])[:, None]

    def _of_sessions(self, sessions: StrArray) -> FloatArray:
        own, name = dict(zip(self.names, self.size.tolist(), strict=True)), ReferenceLatency.DELAY
        return np.array([own.get(f"{name}_{session}", own.get(name, 0.0)) for session in sessions])


#: columns of a log that the vehicle measures
_OF_WHEELS: Final = ("counts_", "steer_", "gyro_", "speed_", "omega_", "v_")


#: forms that a reference of positions alone is restated by
RESTATED: Final[dict[tuple[str, str], type[DisplacedSensor | LateReference]]] = {
    (ReferenceLeverArm.id, ""): DisplacedSensor,
    (ReferenceLatency.id, ReferenceLatency.OF_POSE): LateReference,
    (ReferenceLatency.id, ReferenceLatency.BY_SESSION): LateReference,
}

Mounting = TurnedReference | DisplacedSensor | LateReference
