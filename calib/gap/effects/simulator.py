"""Parameters of the user's own simulator as effects: what a step of each changed in its end poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Perturbation
from calib.gap.observations.arrays import N_CHANNELS, Channel
from calib.gap.predict import predict
from calib.types import FloatArray

SIMULATOR_PREFIX: Final = "simulator:"
#: Gauss-Newton steps from which wheels reproduce a change; of a per cent the third is at rounding
_STEPS: Final = 3
#: what is left is at rounding below this share of a change's squares
_ROUNDING: Final = 1e-8
#: a further step is taken where it promises, linear, to leave no more than this share
_PROMISED_SHARE: Final = 0.2
#: wheels are followed in proportion to a quantity, or alike in a run, where the first step promises to leave no more
_FOLLOWS_SHARE: Final = 0.01
#: radii and track alike in all runs that leave less than this share are all that there is to a change
_ALL_BUT: Final = 1e-4
#: wheels carry a change where they leave no more than this share of its squares
_LEFT_SHARE: Final = 0.1
#: a remainder is more than the simulator's noise where noise exceeds it less often than this
_NOISE_TAIL: Final = 1e-3
#: a channel repeats itself within this share of an instrument's stated uncertainty
_REPEATED_SHARE: Final = 0.02


def simulator_title(name: str) -> str:
    """Return the title of a parameter's effect."""
    return f"{name} of the simulator"


#: relative changes of the wheels (n_obs, 3), the path with them, and what of a change they leave (n_obs, 4)
_Sought = tuple[FloatArray, Path, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """What a step of a parameter does, per unit: as far as wheels can do it a motion, the rest on the readings."""

    run_ids: tuple[str, ...]
    #: left, right, track: shape (n_obs,): relative change of both wheels' travel and of the track
    left: FloatArray
    right: FloatArray
    track: FloatArray
    reading: FloatArray  #: shape (n_obs, 4): the rest, of (distance, x, y, heading), in the frame of the run's start


class SimulatorParameter(Effect):
    """A parameter of the simulator is off: the change of the readings is what the simulator showed for a step of it.

    Parameters
    ----------
    parameter : Parameter
        Named as the simulator calls it; sizes are its deviation from the nominal value, in its unit.
    carried : Carried
        What it does on the runs driven.
    family : Family
        That of the library's effect which it is declared to stand for.
    """

    # an instance's own, unlike the class attributes of the other effects
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
        """Return the single form; none where it moves nothing, or on runs that the simulator was not asked for."""
        carried = self.carried
        moves = any(part.any() for part in (carried.left, carried.right, carried.track, carried.reading))
        if not moves or tuple(observations.labels["run_id"]) != carried.run_ids:
            return []

        def pushed(path: Path) -> list[Perturbation]:
            reading = in_end_frame(path, carried.reading)
            return [Perturbation(left=carried.left, right=carried.right, track=carried.track, reading=reading)]

        return [Form(self.id, "", (self.parameter,), pushed)]


def carried_by_wheels(nominal: Path, change: FloatArray, step: float, noise: FloatArray) -> Carried:
    """Split what a step of a parameter changed, (n_obs, 4) as `Carried.reading`, into motion and readings.

    A change that wheels make bends the path, so that it is not linear in its size. It is sought as radii and track that
    are off alike in all runs, or in proportion to a quantity of the runs, then as both wheels off in each run by
    itself, alike if that will do; what explains little of it is omitted. If the change has noise, (4,), the first that
    leaves no more than the noise is taken: few numbers from all runs, in which little of the noise is left.
    """
    s, noisy = nominal.s, bool(noise.any())
    on = s.usable[:, :4]
    sigma = np.stack([s.sigma_distance_m, s.sigma_xy_m, s.sigma_xy_m, s.sigma_theta_rad], axis=1)
    spread = np.maximum(noise, _REPEATED_SHARE * sigma) if noisy else sigma
    seen = _Seen(nominal, change, np.where(on, 1.0 / spread, 0.0), noisy)
    ones, unmoved = np.ones((len(s), 3, 1)), (np.zeros((len(s), 3)), nominal, change)
    best, whole = unmoved, seen.squares(change).sum()
    for basis in [ones, *(np.concatenate([ones, one[:, :, None]], axis=2) for one in _quantities(s))]:
        found = seen.sought(unmoved, basis, _PROMISED_SHARE if basis is ones else _FOLLOWS_SHARE)
        square = seen.squares(found[2]).sum()
        if noisy and _is_noise(square, int(on.sum())):
            best = found[0], found[1], np.zeros_like(change)
            break
        if not noisy and square < _ALL_BUT * whole:
            best = found
            break
        if basis is ones and square < _LEFT_SHARE * whole:
            best = found
    else:
        # alike only where that will do: a closed square hardly tells the wheels apart
        ways = [(False, _LEFT_SHARE)] if noisy else [(True, _ALL_BUT), (False, _LEFT_SHARE)]
        for alike, share in ways if seen.squares(best[2]).sum() > _ALL_BUT * whole else ():
            found = seen.sought(best, None, _FOLLOWS_SHARE if alike else _PROMISED_SHARE, alike=alike)
            good = (seen.squares(found[2]) < share * seen.squares(best[2]))[:, None]
            if good.any():
                best = found if good.all() else seen.moved(np.where(good, found[0], best[0]))
    wheels, _, remaining = best
    left, right, track = wheels.T / step
    return Carried(tuple(s.labels["run_id"]), left, right, track, np.where(on, remaining, 0.0) / step)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A change of the readings (n_obs, 4) about a path, and how it is weighted."""

    nominal: Path
    change: FloatArray
    weight: FloatArray
    noisy: bool

    def squares(self, left: FloatArray) -> FloatArray:
        """Return the weighted squares of what is left of each observation, shape (n_obs,)."""
        return np.asarray(((left * self.weight) ** 2).sum(axis=1))

    def moved(self, wheels: FloatArray) -> _Sought:
        """Return wheels with the path that they make, and what they leave."""
        path = predict(self.nominal.s, [Perturbation(left=wheels[:, 0], right=wheels[:, 1], track=wheels[:, 2])])
        return wheels, path, self.change - (path.reading - self.nominal.reading)[:, :4]

    def sought(self, start: _Sought, basis: FloatArray | None, most: float, *, alike: bool = False) -> _Sought:
        """Return the wheels of a basis, see `_correction`, by steps that promise to leave no more than a share."""
        now, rounding = start, _ROUNDING * self.squares(self.change).sum()
        for _ in range(_STEPS):
            wheels, path, left = now
            gap = in_end_frame(path, left)[:, :4] * self.weight
            columns = path.calibration[:, :4, :3] * self.weight[:, :, None]
            step = _correction(columns, gap, basis, alike=alike)
            promised = ((gap - np.einsum("nck,nk->nc", columns, step)) ** 2).sum(axis=1)
            square = self.squares(left)
            if basis is not None:
                square, promised = square.sum(keepdims=True), promised.sum(keepdims=True)
            # little by little a noisy change adds up over the runs
            gains = (square > promised) if self.noisy else (promised < most * square)
            if square[gains].sum() <= rounding:
                break
            now = self.moved(wheels + step)
        return now


def _quantities(s: Observations) -> list[FloatArray]:
    """Return what the wheels may follow, of (left, right, track), each (n_obs, 3), that are known and vary."""
    numbers = [s.number(name) for name in ("speed_mps", "temperature_C")]
    each = [(*s.wheel_loads_N, s.wheel_loads_N.mean(axis=0)), *((number,) * 3 for number in numbers)]
    tables = [np.stack(columns, axis=1) for columns in each]
    return [(table - table.mean()) / table.std() for table in tables if np.isfinite(table).all() and table.std() > 0.0]


def _is_noise(square: float, count: int) -> bool:
    """Return whether the squares of so many readings over their noise are no more than noise."""
    from scipy.special import chdtrc

    return bool(chdtrc(count, square) > _NOISE_TAIL)


def _correction(columns: FloatArray, gap: FloatArray, basis: FloatArray | None, *, alike: bool) -> FloatArray:
    """Return the change (n_obs, 3) of left, right wheel and track that columns (n_obs, 4, 3) ask for of a gap.

    Of a few numbers for all runs, by a basis (n_obs, 3, k); without one both wheels of each run by itself.
    """
    found = np.zeros((len(columns), 3))
    # of unit prior: what runs do not determine stays at zero
    if basis is None:
        wheels = columns[:, :, :2].sum(axis=2, keepdims=True) if alike else columns[:, :, :2]
        normal = np.eye(wheels.shape[2]) + np.einsum("nck,ncl->nkl", wheels, wheels)
        right = np.einsum("nck,nc->nk", wheels, gap)
        found[:, :2] = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        return found
    whole = (columns[:, :, :, None] * basis[:, None]).reshape(gap.size, -1)
    sizes = np.linalg.solve(np.eye(whole.shape[1]) + whole.T @ whole, whole.T @ gap.ravel())
    return np.asarray(np.einsum("njk,jk->nj", basis, sizes.reshape(3, -1)))


def in_end_frame(path: Path, change: FloatArray) -> FloatArray:
    """Turn changes of (distance, x, y, heading), shape (n_obs, 4), into those of the channels, (n_obs, n_channels)."""
    reading = np.zeros((len(change), N_CHANNELS))
    c, s = path.frame_turned
    reading[:, Channel.DISTANCE], reading[:, Channel.HEADING] = change[:, 0], change[:, 3]
    reading[:, Channel.ALONG] = c * change[:, 1] + s * change[:, 2]
    reading[:, Channel.LATERAL] = c * change[:, 2] - s * change[:, 1]
    return reading


class HeldCalibration(Effect):
    """An effect of the calibration as one among others, where no recalibration is free beside them.

    Parameters
    ----------
    effect : Effect
        One of the calibration's own three.
    """

    # an instance's own, unlike the class attributes of the other effects
    id: str  # type: ignore[misc]
    title: str  # type: ignore[misc]
    family = Family.CALIBRATION

    def __init__(self, effect: Effect) -> None:
        self.effect = effect
        for name in ("id", "title", "implausible", "needs", "separates", "of_rear_wheels"):
            setattr(self, name, getattr(effect, name))

    def forms(self, observations: Observations) -> list[Form]:
        """Return the forms of the effect itself."""
        return self.effect.forms(observations)
