"""How far the gap shrinks on runs that the fit has not seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.gap.data.channels import N_CHANNELS, POSE, Channel
from calib.gap.data.observations import Observations
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.left_out import LeftOut
from calib.gap.evidence.marginal import rows
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.outcome import ChannelClosure, Closure

BOOTSTRAPS: Final = 400
MAX_FOLDS: Final = 6
#: sessions are left out whole where there are so many
FEWEST_SESSIONS: Final = 3
#: fewer conditions cannot foretell one another
FEWEST_CONDITIONS: Final = 4


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Residuals before and after, on runs that the fit has not seen.

    Parameters
    ----------
    before, after : array of float, shape (n_units, n_channels)
        Residuals of the model alone, and of the model with the effect fitted on the other runs.
    floor : array of float, shape (n_units, n_channels)
        Standard deviation that repeats give each channel.
    fraction : float or None
        1 - (mean square after - floor) / (mean square before - floor), in units of the noise; None where the gap is
        below half the floor.
    ci95 : tuple of float or None
        Its bootstrap interval over conditions.
    by_channel : mapping of Channel to float or None
        The same for each channel.
    left_out : str
        What was left out in turn: ``session`` or ``condition``.
    """

    before: FloatArray
    after: FloatArray
    floor: FloatArray
    fraction: float | None
    ci95: tuple[float, float] | None
    by_channel: dict[Channel, float | None]
    left_out: str


def folds(observations: Observations, *, sessions: bool = True) -> tuple[IntArray, str]:
    """Return the number of the fold that each unit is left out in, shape (n_units,), and what the folds are."""
    number = np.arange(len(observations))
    labels, session = np.unique(observations.labels["session"], return_inverse=True)
    if sessions and len(labels) >= FEWEST_SESSIONS:
        return np.asarray(session % 8), "session"
    if sessions:
        # in the order driven: neighbours in time are left out together, as sessions are
        return number * MAX_FOLDS // len(observations), "run"
    names, condition = np.unique(observations.condition, return_inverse=True)
    if len(names) >= FEWEST_CONDITIONS:
        return np.asarray(condition % min(MAX_FOLDS, len(names))), "condition"
    return number % MAX_FOLDS, "run"


def measure_closure(
    nominal: Path,
    noise: Noise,
    fitted: Fitted,
    rng: np.random.Generator,
    *,
    sessions: bool = True,
    floor_factor: float = 1.0,
    left_out: LeftOut | None = None,
) -> HeldOut:
    """Fit on the other folds, predict the one left out, and compare with the model alone.

    Parameters
    ----------
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    fitted : Fitted
        The hypothesis, fitted on all runs.
    rng : numpy.random.Generator
        For the bootstrap.
    sessions : bool
        Leave sessions out where there are three or more; else conditions.
    floor_factor : float
        By which the floor's variance is larger than `noise` says, where what the fit leaves is held to be noise.
    left_out : LeftOut, optional
        What leaves runs out of the fit; by default beside no rest.

    Returns
    -------
    HeldOut
    """
    observations = nominal.s
    fold, by = folds(observations, sessions=sessions)
    left_out = left_out or LeftOut(fitted, nominal, noise)
    if by == "session" and not all(left_out.foretells(fold == number) for number in np.unique(fold)):
        # a session that alone drove its kind of route is foretold by none of the others
        fold, by = np.arange(len(observations)) % MAX_FOLDS, "run"
    before = residuals(nominal, nominal)
    after = np.zeros_like(before)
    for number in np.unique(fold):
        out = fold == number
        after[out] = left_out.after(out)[out]
    usable = observations.usable
    white = rows(nominal, noise, np.stack([before, after], axis=2))
    unit = np.repeat(np.arange(len(observations))[:, None], N_CHANNELS, axis=1)[usable]
    per_unit = np.stack([np.bincount(unit, white[:, k] ** 2, len(observations)) for k in range(2)], axis=1)
    dims = floor_factor * usable.sum(axis=1).astype(np.float64)
    fraction = _fraction(per_unit.astype(np.float64), dims)
    ci95 = None
    if fraction is not None:
        _, condition = np.unique(observations.condition, return_inverse=True)
        n = int(condition.max()) + 1
        by_condition = np.stack([np.bincount(condition, per_unit[:, k], n) for k in range(2)], axis=1)
        dims_condition = np.bincount(condition, dims, n)
        pick = rng.integers(0, n, (BOOTSTRAPS, n))
        sums, total = by_condition[pick].sum(axis=1), dims_condition[pick].sum(axis=1)
        gap = np.maximum(sums[:, 0] - total, 0.05 * np.maximum(total, 1.0))
        fractions = np.clip(1.0 - (sums[:, 1] - total) / gap, -1.0, 1.0)
        ci95 = (float(np.quantile(fractions, 0.025)), float(np.quantile(fractions, 0.975)))
    floor = np.sqrt(floor_factor) * noise.floor
    by_channel: dict[Channel, float | None] = {}
    for channel in Channel:
        on = usable[:, channel]
        if on.any():
            scaled = np.stack([before[on, channel], after[on, channel]], axis=1) / floor[on, channel, None]
            by_channel[channel] = _fraction(scaled**2, np.ones(int(on.sum())))
    return HeldOut(before, after, np.where(usable, floor, 0.0), fraction, ci95, by_channel, by)


def _fraction(squares: FloatArray, dims: FloatArray) -> float | None:
    """Return the closure of whitened squares (n, 2) whose floor is `dims`; None where the gap is below half of it."""
    gap = squares[:, 0].sum() - dims.sum()
    if gap < 0.5 * dims.sum():
        return None
    rest = squares[:, 1].sum() - dims.sum()
    return float(np.clip(1.0 - max(rest, 0.0) / gap, -1.0, 1.0))


def closure_of(held_out: HeldOut, observations: Observations) -> Closure:
    """Return the closure in figures: root mean squares of the end positions, else of the distance.

    Parameters
    ----------
    held_out : HeldOut
        Residuals before and after.
    observations : Observations
        The same units.
    """
    everything = np.ones(len(observations), dtype=bool)
    residuals_of = (held_out.before, held_out.after, held_out.floor)
    channels = []
    for channel, fraction in held_out.by_channel.items():
        on = observations.usable[:, channel]
        before, after, floor = (float(np.sqrt(np.mean(values[on, channel] ** 2))) for values in residuals_of)
        channels.append(ChannelClosure(channel, before, after, floor, fraction))
    return Closure(
        before_rms_m=end_rms_m(held_out.before, observations, everything),
        after_rms_m=end_rms_m(held_out.after, observations, everything),
        floor_rms_m=end_rms_m(held_out.floor, observations, everything),
        fraction=held_out.fraction,
        ci95=held_out.ci95,
        held_out=held_out.left_out,
        channels=tuple(channels),
    )


def end_rms_m(values: FloatArray, observations: Observations, units: BoolArray) -> float | None:
    """Return the root mean square of end positions, else of distances, of some units; None where neither was measured.

    Parameters
    ----------
    values : array of float, shape (n_units, n_channels)
        Residuals, or a floor.
    observations : Observations
        The same units.
    units : array of bool, shape (n_units,)
        Which of them.
    """
    on = observations.usable & units[:, None]
    pose = on[:, POSE].all(axis=1)
    if pose.any():
        return float(np.sqrt(np.mean((values[pose][:, POSE] ** 2).sum(axis=1))))
    if on[:, Channel.DISTANCE].any():
        return float(np.sqrt(np.mean(values[on[:, Channel.DISTANCE], Channel.DISTANCE] ** 2)))
    return None
