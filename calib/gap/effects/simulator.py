"""Parameters of the user's own simulator as effects: what a step of each changed in its end poses; its integration."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from calib.gap import Perturbation
from calib.gap.effects import Effect, Family, Form, Parameter, Perturbations
from calib.gap.observations import N_CHANNELS, POSE, Channel, Observations
from calib.gap.predict import Path, predict
from calib.types import FloatArray

SIMULATOR_PREFIX: Final = "simulator:"
#: steps from which wheels reproduce a change
_STEPS: Final = 3
#: below this share of a change's squares the rest is linear enough
_ROUNDING: Final = 1e-6
#: a further step is taken that promises to leave no more than this share
_PROMISED_SHARE: Final = 0.2
#: wheels are followed in proportion to a quantity, or alike, where that leaves no more
_FOLLOWS_SHARE: Final = 0.01
#: radii and track alike in all runs that leave a smaller share are all of a change
_ALL_BUT: Final = 1e-4
#: wheels carry a change where they leave no more than this share of its squares
_LEFT_SHARE: Final = 0.1
#: a remainder that noise exceeds less often is no noise
_NOISE_TAIL: Final = 1e-3
#: a channel repeats itself within this share of an instrument's stated uncertainty
_REPEATED_SHARE: Final = 0.02


def simulator_title(name: str) -> str:
    """Return the title of a parameter's effect."""
    return f"{name} of the simulator"


#: relative changes of the wheels (n_obs, 3), and what of a change they leave (n_obs, 4)
_Sought = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """What a step of a parameter does, per unit: as far as wheels can do it a motion, the rest on the readings."""

    run_ids: tuple[str, ...]
    wheels: FloatArray  #: shape (n_obs, 3): relative change of the left and right wheel's travel and of the track
    reading: FloatArray  #: shape (n_obs, 4): the rest, of (distance, x, y, heading), in the frame of the run's start

    def motion(self, size: float) -> Perturbation:
        """Return the motion that the parameter off by a size makes."""
        return Perturbation(*(self.wheels * size).T)


class SimulatorParameter(Effect):
    """A parameter of the simulator is off: readings change as a step of it showed.

    `parameter`: sizes are its deviation from the nominal value; `carried`: what it does on the runs driven; `family`:
    that of the library's effect that it stands for.
    """

    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    implausible = "a cause that this parameter imitates"
    family: Family  # type: ignore[misc]
    needs = "runs whose end the parameter changes in the simulator"
    separates = "runs whose ends it changes otherwise than what looks alike"

    def __init__(self, parameter: Parameter, carried: Carried, family: Family = Family.SIMULATOR) -> None:
        self.parameter, self.carried, self.family = parameter, carried, family
        self.id = SIMULATOR_PREFIX + parameter.name
        self.title = simulator_title(parameter.name)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        carried, driven = self.carried, tuple(observations.labels["run_id"])
        if driven != carried.run_ids or not (carried.wheels.any() or carried.reading.any()):
            return []

        def pushed(path: Path) -> list[Perturbation]:
            return [replace(carried.motion(1.0), reading=in_end_frame(path, carried.reading))]

        return [Form(self.id, "", (self.parameter,), pushed)]


class _Basis:
    # relative change of left, right and track by each number, (n_obs, 3, k); a step is taken where it promises to leave
    # no more than the share `most`, and is worth it where it leaves no more than `enough`
    def __init__(self, wheels: FloatArray, by_wheels: FloatArray, groups: int, most: float, enough: float) -> None:
        self.wheels, self.most, self.enough = wheels, most, enough
        #: weighted readings by each number, shape (n_groups, n_readings, k)
        self.columns = (by_wheels @ wheels).reshape(groups, -1, wheels.shape[2])
        turned = np.swapaxes(self.columns, 1, 2)
        #: shape (n_groups, k, n_readings)
        self.inverse = np.linalg.solve(np.eye(wheels.shape[2]) + turned @ self.columns, turned)


class WheelMotion:
    """What wheels that are off do to the ends of runs.

    `noise`: (n_obs, 4), of a change of (distance, x, y, heading); zero where the simulator repeats itself.
    """

    def __init__(self, nominal: Path, noise: FloatArray) -> None:
        s = nominal.s
        self.nominal, self.noisy, self.on = nominal, bool(noise.any()), s.usable[:, :4]
        spread = np.maximum(noise, _REPEATED_SHARE * s.sigma) if self.noisy else s.sigma
        self.weight = np.where(self.on, 1.0 / spread, 0.0)
        by_wheels = nominal.calibration[:, :4, :3] * self.weight[:, :, None]
        ones, each = np.ones((len(s), 3)), np.broadcast_to(np.eye(3), (len(s), 3, 3))

        def in_all(numbers: list[FloatArray], most: float, enough: float) -> _Basis:
            wheels = np.concatenate([number[:, :, None] * each for number in numbers], axis=2)
            return _Basis(wheels, by_wheels, 1, most, enough)

        follows = 1.0 if self.noisy else _FOLLOWS_SHARE
        self.together = [in_all([ones], _PROMISED_SHARE, _LEFT_SHARE)]
        self.together += [in_all([ones, one], follows, _ALL_BUT) for one in _quantities(s)]
        # alike where that will do: a closed square hardly tells the wheels apart
        alike = _Basis(each[:, :, :2].sum(axis=2, keepdims=True), by_wheels, len(s), _FOLLOWS_SHARE, _ALL_BUT)
        both = _Basis(each[:, :, :2], by_wheels, len(s), _PROMISED_SHARE, _LEFT_SHARE)
        self.by_run = [both] if self.noisy else [alike, both]

    def carried(self, change: FloatArray, step: float, *, both_ways: bool = False) -> Carried:
        """Split what a step of a parameter changed, (n_obs, 4) as `Carried.reading`, into motion and readings.

        `both_ways`: the change is half of what lies between a step up and one down. What wheels do is sought in few
        numbers first: of a noisy change the first that leaves no more than noise is taken.
        """
        from scipy.special import chdtrc

        unmoved = np.zeros((len(change), 3)), change
        best, whole = unmoved, self._squares(change).sum()
        for number, basis in enumerate(self.together):
            split = self._sought(change, unmoved, basis, both_ways)
            square = self._squares(split[1]).sum()
            if self.noisy and chdtrc(int(self.on.sum()), square) > _NOISE_TAIL:
                best = split[0], np.zeros_like(change)
                break
            if not self.noisy and square < _ALL_BUT * whole:
                best = split
                break
            if number == 0 and square < basis.enough * whole:
                best = split
        else:
            for basis in self.by_run if self._squares(best[1]).sum() > _ALL_BUT * whole else ():
                split = self._sought(change, best, basis, both_ways)
                good = (self._squares(split[1]) < basis.enough * self._squares(best[1]))[:, None]
                best = np.where(good, split[0], best[0]), np.where(good, split[1], best[1])
        labels = tuple(self.nominal.s.labels["run_id"])
        return Carried(labels, best[0] / step, np.where(self.on, best[1], 0.0) / step)

    def _squares(self, left: FloatArray) -> FloatArray:
        return np.asarray(((left * self.weight) ** 2).sum(axis=1))

    def _sought(self, change: FloatArray, start: _Sought, basis: _Basis, both_ways: bool) -> _Sought:
        wheels, left = start
        rounding = _ROUNDING * self._squares(change).sum()
        for _ in range(_STEPS):
            gap = (in_end_frame(self.nominal, left)[:, :4] * self.weight).reshape(len(basis.columns), -1, 1)
            sizes = basis.inverse @ gap
            now, promised = (gap**2).sum(axis=(1, 2)), ((gap - basis.columns @ sizes) ** 2).sum(axis=(1, 2))
            gains = (now > promised) if self.noisy else (promised < basis.most * now)
            if now[gains].sum() <= rounding:
                break
            wheels = wheels + (basis.wheels @ sizes)[:, :, 0]
            up = self._moved(wheels)
            left = change - (0.5 * (up - self._moved(-wheels)) if both_ways else up)
        return wheels, left

    def _moved(self, wheels: FloatArray) -> FloatArray:
        return (predict(self.nominal.s, [Perturbation(*wheels.T)]).reading - self.nominal.reading)[:, :4]


def _quantities(s: Observations) -> list[FloatArray]:
    numbers = [s.number(name) for name in ("speed_mps", "temperature_C")]
    each = [(*s.wheel_loads_N, s.wheel_loads_N.mean(axis=0)), *((number,) * 3 for number in numbers)]
    tables = [np.stack(columns, axis=1) for columns in each]
    return [(table - table.mean()) / table.std() for table in tables if np.isfinite(table).all() and table.std() > 0.0]


def in_end_frame(path: Path, change: FloatArray) -> FloatArray:
    """Turn changes of (distance, x, y, heading), shape (n_obs, 4), into those of the channels, (n_obs, n_channels)."""
    reading = np.zeros((len(change), N_CHANNELS))
    reading[:, Channel.DISTANCE], reading[:, Channel.HEADING] = change[:, 0], change[:, 3]
    reading[:, Channel.ALONG], reading[:, Channel.LATERAL] = path.to_end_frame(change[:, 1], change[:, 2])
    return reading


def as_simulated(observations: Observations, noise: FloatArray | float = 0.0) -> Observations:
    """Return the observations with wheels that travel as an outside simulator's do, by its ends.

    What bends a path is not linear: it is taken about the simulator's path, not the model's, nor its `noise`'s.
    """
    nominal = predict(observations)
    change = (observations.simulated - nominal.reading)[:, :4]
    if not np.isfinite(change[observations.usable[:, :4]]).all():
        return observations
    change[:, 3] = (change[:, 3] + np.pi) % (2 * np.pi) - np.pi
    carried = WheelMotion(nominal, np.broadcast_to(noise, change.shape)).carried(np.nan_to_num(change), 1.0)
    model, (left, right, track) = observations.model, 1.0 + carried.wheels.T
    return replace(
        observations,
        roll_left_rad=observations.roll_left_rad * left[observations.unit],
        roll_right_rad=observations.roll_right_rad * right[observations.unit],
        model=replace(model, track_m=model.track_m * float(track.mean())),
    )


class HeldCalibration(Effect):
    """An effect of the calibration as one among others, where no recalibration is free beside them.

    `sign`: of its size, where the other sign is left to parameters of the simulator, 0 where either counts.
    """

    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    family = Family.CALIBRATION

    def __init__(self, effect: Effect, sign: int = 0) -> None:
        self.effect, self.sign = effect, sign
        for name in ("id", "title", "implausible", "needs", "separates", "of_rear_wheels"):
            setattr(self, name, getattr(effect, name))

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        forms = self.effect.forms(observations)
        signed = [[replace(one, sign=self.sign or one.sign) for one in form.parameters] for form in forms]
        return [replace(form, parameters=tuple(group)) for form, group in zip(forms, signed, strict=True)]


def of_at_most(n: int, effect: Effect, observations: Observations) -> bool:
    """Return whether no form of an effect has more than `n` parameters, where `n` is not 0."""
    return n > 0 and all(len(form.parameters) <= n for form in effect.forms(observations))


def without_forms(effect: Effect, labels: Sequence[str]) -> Effect:
    """Return an effect without the forms of these labels."""
    other = copy(effect)
    other.forms = lambda observations: [form for form in effect.forms(observations) if form.label not in labels]  # type: ignore[method-assign]
    return other


def with_zero(effect: Effect, zeros: Mapping[HeldCalibration, float], reach: Mapping[str, float]) -> Effect:
    """Return an effect whose zero point is free where it is counted from a mean and the calibration is held.

    Else radii off on average would pass for a parameter. `zeros`: what another zero point looks like, and how much of
    it moves the readings by a standard deviation; `reach`: by how many of these each form moves them, by label.
    """

    def forms(observations: Observations) -> list[Form]:
        offsets = [(form, share) for zero, share in zeros.items() for form in zero.forms(observations)]

        def beside(perturbations: Perturbations) -> Perturbations:
            return lambda path: [
                *perturbations(path),
                *(one for form, _ in offsets for one in form.perturbations(path)),
            ]

        def shifted(form: Form) -> Form:
            if (form.centre is None and not effect.per_session) or not offsets:
                return form
            sizes = [(offset, offset.parameters[0].typical * share * reach[form.label]) for offset, share in offsets]
            named = [
                replace(zero.parameters[0], name=f"zero_{zero.effect}", typical=size, largest=3.0 * size, shift=True)
                for zero, size in sizes
            ]
            moved = form.about
            about = None if moved is None else lambda centre: beside(moved(centre))
            parameters, perturbations = (*form.parameters, *named), beside(form.perturbations)
            return replace(form, parameters=parameters, perturbations=perturbations, about=about, by_parts=False)

        return [shifted(form) for form in effect.forms(observations)]

    other = copy(effect)
    other.forms = forms  # type: ignore[method-assign]
    return other


class IntegrationScheme(Effect):
    """Exact arcs less steps along the heading at their end (Eq. 7 as printed) or start (Euler): e_n ~ v dt theta / 2.

    Calib's own odometry integrates exact arcs, so only an outside simulator's poses can have it. The difference is
    computed on the log's steps and grows with them: a share of 1 means that the simulator takes the log's steps.
    """

    id = "integration_scheme"
    title = "a simulator that integrates the heading coarsely"
    implausible = "latency, or a start heading that differs"
    family = Family.PATH
    needs = "poses of an outside simulator on runs that turn"
    separates = "none: it is computed from the logs"

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        posed = np.isfinite(observations.simulated[:, POSE]).all(axis=1) & observations.usable[:, Channel.ALONG]
        outside = observations.from_log & posed
        if not outside.any():
            return []
        parameter = Parameter("share", "1", typical=1.0, largest=2.0, sign=1)

        def coarse(path: Path, back: float) -> list[Perturbation]:
            heading = observations.cumulative(path.steps.turn_rad) - back * path.steps.turn_rad
            end_x, end_y = path.end[:, 0], path.end[:, 1]
            x = np.where(outside, end_x - observations.total(path.steps.ds_m * np.cos(heading)), 0.0)
            y = np.where(outside, end_y - observations.total(path.steps.ds_m * np.sin(heading)), 0.0)
            along, lateral = path.to_end_frame(x, y)
            # a laser's simulated distance was taken from the same pose
            chord = (end_x * x + end_y * y) / np.maximum(np.hypot(end_x, end_y), 1e-9)
            axis = observations.axis
            laser = np.where(np.abs(axis) == 1, axis * x, np.where(axis == 2, chord, 0.0))
            distance = np.where(np.isfinite(observations.simulated[:, 0]), laser, 0.0)
            return [Perturbation.on_readings(observations, distance=distance, along=along, lateral=lateral)]

        schemes = [("end-point heading", 0.0), ("start heading (Euler)", 1.0)]
        forms = self.offer([(label, (parameter,), partial(coarse, back=back)) for label, back in schemes])
        reading = coarse(predict(observations), 0.0)[0].reading
        return forms if reading is not None and float(np.abs(reading).max()) > 1e-5 else []
