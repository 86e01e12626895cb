"""Held-out validation: how far the gap shrinks on runs not fitted on, and where the correction helps."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from calib.documents import plain_fields
from calib.gap.inference import FULL_CLOSURE, NEGLIGIBLE_GROWTH, NOISE_LEVELS
from calib.gap.inference.fit import squares_by_unit
from calib.gap.inference.least_squares import HeldOutFit
from calib.gap.inference.noise import Noise
from calib.gap.observations import POSE, Channel, Observations
from calib.gap.predict import Path, measured_gap, residuals
from calib.types import BoolArray, FloatArray, IntArray

#: of a closure: nothing held out, the user's simulator ran again with the fix
RERUN: Final = "none"
#: resamples of conditions: the interval's ends vary by a few per cent of its width
BOOTSTRAPS: Final = 400
#: folds of conditions or runs: five sixths of the runs stay
MOST_FOLDS: Final = 6
#: sessions that are folds of their own; more are joined
MOST_SESSION_FOLDS: Final = 8
#: sessions held out whole; of two, one would have to predict the other
FEWEST_SESSIONS: Final = 3
#: conditions that can predict one another
FEWEST_CONDITIONS: Final = 4
#: gap, over the noise level, below which a closure would be a share of noise
LEAST_GAP: Final = 0.5
#: least gap of a bootstrap sample over its noise level: keeps closures finite
LEAST_RESAMPLED_GAP: Final = 0.05


@dataclass(frozen=True, slots=True)
class ChannelClosure:
    """How far the gap shrinks in one channel on held-out runs; root mean squares in the channel's unit."""

    channel: Channel = field(metadata={"json": False})
    before_rms: float  #: gap of the model alone
    after_rms: float
    floor_rms: float
    #: closed share of the squares above the noise level; None for a gap below half of it
    fraction: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(self, unit=self.channel.unit)


@dataclass(frozen=True, slots=True)
class Closure:
    """How far the gap shrinks on held-out runs; root mean squares of end positions, else distances."""

    before_rms_m: float | None = None  #: gap of the model alone
    after_rms_m: float | None = None
    floor_rms_m: float | None = None
    #: closed share over all channels, weighed by noise; None for a gap below half of it
    fraction: float | None = None
    ci95: tuple[float, float] | None = None  #: by bootstrap over conditions
    held_out: str = "condition"  #: in turn: ``session``, ``condition``, ``run``; `RERUN`
    channels: tuple[ChannelClosure, ...] = ()

    @property
    def moved(self) -> tuple[ChannelClosure, ...]:
        """Channels whose gap is above the noise level, the largest ratio first."""
        above = [line for line in self.channels if line.fraction is not None]
        return tuple(sorted(above, key=lambda line: -line.before_rms / line.floor_rms))

    @property
    def largest_residual(self) -> float:
        """Largest residual with the causes over the noise level of its channel, as stated; 0 without channels."""
        ratios = (line.after_rms / line.floor_rms for line in self.channels if line.floor_rms > 0.0)
        return round(max(ratios, default=0.0), 1)

    @property
    def leaves_part(self) -> bool:
        """Whether part of the gap is left, beyond the closure's interval."""
        return (self.ci95[1] if self.ci95 else 1.0) < FULL_CLOSURE or self.largest_residual > NOISE_LEVELS

    @property
    def rests_on_few(self) -> bool:
        """Whether few of the conditions driven show it: drawn anew, others may get worse."""
        return self.ci95 is not None and self.ci95[0] < -NEGLIGIBLE_GROWTH

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return plain_fields(
            self,
            by_channel={line.channel.label: line.fraction for line in self.channels},
            channels={line.channel.label: line for line in self.channels},
        )


@dataclass(frozen=True, slots=True)
class Improvement:
    """What the correction does on held-out runs, paired; root mean squares over the noise."""

    before_rms: float  #: of the model alone
    after_rms: float
    #: of the difference, by noise and unexplained residual
    improvement_ci95: tuple[float, float]
    #: as a share of the squares above the noise, at every signal
    closed_ci95: tuple[float, float]

    @property
    def leaves_some(self) -> bool:
        """Whether part of the gap is certainly left: the interval ends below all of it."""
        return self.closed_ci95[1] < 1.0


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Residuals on held-out runs, each shape (n_units, n_channels)."""

    before: FloatArray
    after: FloatArray  #: of the model with the causes fitted on the other runs
    floor: FloatArray  #: standard deviation of each channel by replicates
    closure: Closure
    improvement: Improvement | None = None  #: None where no run was held out
    #: of other residuals (n_units, n_channels) in place of `after`, with what was held out in turn
    closing: Callable[[FloatArray, str], Closure] | None = None


def folds(observations: Observations, *, sessions: bool = True) -> tuple[IntArray, str]:
    """Return each observation's fold, (n_units,), and what folds are."""
    number = np.arange(len(observations))
    labels, session = np.unique(observations.labels["session"], return_inverse=True)
    if sessions and len(labels) >= FEWEST_SESSIONS:
        return np.asarray(session % MOST_SESSION_FOLDS), "session"
    if sessions:
        # neighbours in time together, as in sessions
        return number * MOST_FOLDS // len(observations), "run"
    names, condition = np.unique(observations.condition, return_inverse=True)
    if len(names) >= FEWEST_CONDITIONS:
        return np.asarray(condition % min(MOST_FOLDS, len(names))), "condition"
    return _of_each_condition(observations), "run"


def _of_each_condition(observations: Observations) -> IntArray:
    fold = np.zeros(len(observations), dtype=np.int64)
    fold[np.argsort(observations.condition, kind="stable")] = np.arange(len(observations)) % MOST_FOLDS
    return fold


def measure_closure(
    left_out: HeldOutFit,
    rng: np.random.Generator,
    *,
    sessions: bool = True,
    floor_factor: float = 1.0,
    as_counted: FloatArray | None = None,
) -> HeldOut:
    """Fit on the other folds, predict the held-out one, and compare with the model alone.

    Parameters
    ----------
    left_out, rng
    sessions
        Hold sessions out where there are three or more; else conditions.
    floor_factor
        Variance of the noise level over `noise`'s, where the fit's residual counts as noise.
    as_counted : shape (n_units, n_channels)
        Gap to state instead: before a blunder was corrected.
    """
    nominal, noise = left_out.nominal, left_out.noise
    before = residuals(nominal, nominal)
    after, by = left_with_others(left_out, sessions=sessions)
    stated = measured_gap(nominal, nominal) if as_counted is None else as_counted

    def closing(after: FloatArray, by: str) -> HeldOut:
        return closure_of(nominal, noise, before, after, rng, floor_factor=floor_factor, stated=stated, by=by)

    improvement = improvement_of(left_out, before if as_counted is None else as_counted, after, floor_factor)
    return replace(closing(after, by), improvement=improvement, closing=lambda *other: closing(*other).closure)


def left_with_others(left_out: HeldOutFit, *, sessions: bool) -> tuple[FloatArray, str]:
    """Return residuals with the other folds' correction (n_units, n_channels), and what folds are."""
    observations = left_out.observations
    fold, by = folds(observations, sessions=sessions)
    if by != "run" and not all(left_out.is_predictive(fold == number) for number in np.unique(fold)):
        fold, by = _of_each_condition(observations), "run"
    held = np.ones(len(fold), dtype=np.bool_)
    for number in np.unique(fold) if by == "run" else ():
        if not left_out.is_predictive(fold == number):
            # what one run shows alone no other predicts
            runs = np.flatnonzero(fold == number)
            held[[run for run in runs if not left_out.is_predictive(np.arange(len(fold)) == run)]] = False
    held |= 2 * held.sum() < len(held)
    after = left_out.fitted.left.copy()
    for number in np.unique(fold):
        out = held & (fold == number)
        after[out] = left_out.after(out)[out]
    return after, by


def improvement_of(
    left_out: HeldOutFit, before: FloatArray, after: FloatArray, floor_factor: float = 1.0
) -> Improvement:
    """Return what a correction does on held-out runs to a gap (n_units, n_channels); see `measure_closure`."""
    from scipy.special import stdtrit

    squares = [float(left_out.squares(values).sum()) for values in (before, after)]
    expected = floor_factor * float(left_out.observations.usable.sum())
    every = np.ones(len(left_out.observations), dtype=np.bool_)
    # of squares r^2 - (r - d)^2 = 2 r d - d^2 the noise of r makes 2 sd(r d)
    half = 2.0 * float(stdtrit(max(left_out.noise.dof, 3.0), 0.975)) * left_out.spread(after - before, every)
    gain, gap = squares[0] - squares[1], max(squares[0] - expected, 1.0)
    rms = [float(np.sqrt(square / expected)) for square in squares]
    ends = [rms[0] - float(np.sqrt(max(squares[0] - end, 0.0) / expected)) for end in (gain - half, gain + half)]
    return Improvement(rms[0], rms[1], (ends[0], ends[1]), ((gain - half) / gap, (gain + half) / gap))


def closure_of(
    nominal: Path,
    noise: Noise,
    before: FloatArray,
    after: FloatArray,
    rng: np.random.Generator,
    *,
    floor_factor: float = 1.0,
    stated: FloatArray | None = None,
    by: str = RERUN,
) -> HeldOut:
    """Return how far the gap shrinks from residuals `before` to `after`.

    `stated`: the gap to state in place of `before`; `by`: what was held out in turn.
    For others see `measure_closure`.
    """
    observations, stated = nominal.s, before if stated is None else stated
    usable = observations.usable
    squares = np.stack([squares_by_unit(nominal, noise, left) for left in (before, after)], axis=1)
    expected = floor_factor * usable.sum(axis=1).astype(np.float64)
    fraction = _fraction(squares, expected)
    floor = np.where(usable, np.sqrt(floor_factor) * noise.floor, 0.0)
    channels = []
    for channel in (channel for channel in Channel if usable[:, channel].any()):
        on = usable[:, channel]
        scaled = np.stack([before[on, channel], after[on, channel]], axis=1) / floor[on, channel, None]
        rms = [float(np.sqrt(np.mean(values[on, channel] ** 2))) for values in (stated, after, floor)]
        channels.append(ChannelClosure(channel, rms[0], rms[1], rms[2], _fraction(scaled**2, np.ones(len(scaled)))))
    closure = Closure(
        before_rms_m=end_rms_m(stated, observations),
        after_rms_m=end_rms_m(after, observations),
        floor_rms_m=end_rms_m(floor, observations),
        fraction=fraction,
        ci95=None if fraction is None else _interval(squares, expected, observations.condition, rng),
        held_out=by,
        channels=tuple(channels),
    )
    return HeldOut(stated, after, floor, closure)


def _fraction(squares: FloatArray, expected: FloatArray) -> float | None:
    before, after = squares.sum(axis=0) - expected.sum()
    if before < LEAST_GAP * expected.sum():
        return None
    return float(1.0 - max(after, 0.0) / before)


def _interval(
    squares: FloatArray, expected: FloatArray, condition: IntArray, rng: np.random.Generator
) -> tuple[float, float]:
    names, number = np.unique(condition, return_inverse=True)
    n = len(names)
    by_condition = np.stack([np.bincount(number, values, n) for values in (*squares.T, expected)], axis=1)
    before, after, noise = by_condition[rng.integers(0, n, (BOOTSTRAPS, n))].sum(axis=1).T
    gap = np.maximum(before - noise, LEAST_RESAMPLED_GAP * np.maximum(noise, 1.0))
    low, high = np.quantile(np.minimum(1.0 - (after - noise) / gap, 1.0), (0.025, 0.975))
    return float(low), float(high)


def end_rms_m(values: FloatArray, observations: Observations, units: BoolArray | None = None) -> float | None:
    """Return the root mean square of end positions, else of distances; None without either.

    `values`: (n_units, n_channels), residuals or a noise level; `units`: all by default.
    """
    on = observations.usable if units is None else observations.usable & units[:, None]
    pose = on[:, POSE].all(axis=1)
    if pose.any():
        return float(np.sqrt(np.mean((values[pose][:, POSE] ** 2).sum(axis=1))))
    if on[:, Channel.DISTANCE].any():
        return float(np.sqrt(np.mean(values[on[:, Channel.DISTANCE], Channel.DISTANCE] ** 2)))
    return None
