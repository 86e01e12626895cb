"""The plant's noise: floor texture, runs that differ, instruments; its tails and its proportions vary by case."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from calib.types import FloatArray


@dataclass(frozen=True, slots=True)
class Noise:
    """Scales of the noise, all as standard deviations."""

    texture_m: float = 1.5e-4  #: random walk of each wheel's rolled path, metres per square root of a metre
    #: common, differential: a run's own relative change of both radii, and of their difference
    common: float = 4e-5
    differential: float = 1.5e-5
    start_heading_rad: float = 2e-4  #: error of the reference frame's heading at the start of a run
    #: laser_m, ref_xy_m, ref_theta_rad: instruments, as they truly are
    laser_m: float = 0.0015
    ref_xy_m: float = 0.002
    ref_theta_rad: float = 0.0008
    stated_ratio: float = 1.0  #: what the campaign file states of the reference's uncertainty, over the truth
    #: steer_rad, front: a run's own steering angle zero, and relative front radius
    steer_rad: float = 1e-3
    front: float = 3e-4
    reading_rad: float = 2e-3  #: one reading of the steering angle
    tail: float = 5.0  #: degrees of freedom of Student's t over the runs; above 2, infinite is normal

    def times(self, factor: float) -> Noise:
        """Return the noise with every scale times a factor, to four digits."""
        scales = [field.name for field in fields(self) if field.name not in ("stated_ratio", "tail")]
        return replace(self, **{name: float(f"{getattr(self, name) * factor:.4g}") for name in scales})


@dataclass(frozen=True, slots=True, eq=False)
class NoiseDraw:
    """One draw of everything random about n runs."""

    texture_m: FloatArray  #: shape (n_runs,): texture of each run
    #: scale_left, scale_right: shape (n_runs,): factors on the true radii
    scale_left: FloatArray
    scale_right: FloatArray
    #: shape (3, n_runs): where the counters (left, right, front) stand between two counts at the start, 0 to 1
    phase: FloatArray
    #: laser_m, start_heading_rad, steer_rad, front: shape (n_runs,): errors of instruments and sensors
    laser_m: FloatArray
    start_heading_rad: FloatArray
    steer_rad: FloatArray
    front: FloatArray
    pose: FloatArray  #: shape (n_runs, 3): errors of the reference end pose: x, y in m, theta in rad
    seed: int  #: of the texture along the way and of the reference trace
    reading_rad: float = 0.0  #: scale of one reading of the steering angle
    copies: int = 1  #: how often the same runs stand end to end

    def tile(self, times: int) -> NoiseDraw:
        """Return the same draw for `times` copies of the runs, end to end."""
        values = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "pose"}
        tiled: dict[str, Any] = {name: np.tile(x, times) for name, x in values.items() if isinstance(x, np.ndarray)}
        return replace(self, pose=np.tile(self.pose, (times, 1)), copies=times * self.copies, **tiled)


def _tailed(rng: np.random.Generator, shape: tuple[int, ...], tail: float) -> FloatArray:
    """Draw from Student's t scaled to unit variance; the normal where `tail` is infinite."""
    if np.isinf(tail):
        return rng.standard_normal(shape)
    drawn: FloatArray = rng.standard_t(tail, shape) * np.sqrt((tail - 2.0) / tail)
    return drawn


def draw_noise(noise: Noise, n_runs: int, rng: np.random.Generator) -> NoiseDraw:
    """Draw the noise of `n_runs` runs."""
    tail = noise.tail
    common = noise.common * _tailed(rng, (n_runs,), tail)
    differential = noise.differential * _tailed(rng, (n_runs,), tail)
    # a run's texture is itself random: the mixture over runs has the heavy tail, and unit mean square
    mixing = np.ones(n_runs) if np.isinf(tail) else np.sqrt((tail - 2.0) / rng.chisquare(tail, n_runs))
    axes = np.array([noise.ref_xy_m, noise.ref_xy_m, noise.ref_theta_rad])
    return NoiseDraw(
        texture_m=noise.texture_m * mixing,
        scale_left=1.0 + common - 0.5 * differential,
        scale_right=1.0 + common + 0.5 * differential,
        phase=rng.random((3, n_runs)),
        laser_m=noise.laser_m * _tailed(rng, (n_runs,), tail),
        start_heading_rad=noise.start_heading_rad * _tailed(rng, (n_runs,), tail),
        steer_rad=noise.steer_rad * _tailed(rng, (n_runs,), tail),
        front=noise.front * _tailed(rng, (n_runs,), tail),
        pose=axes * _tailed(rng, (n_runs, 3), tail),
        seed=int(rng.integers(2**62)),
        reading_rad=noise.reading_rad,
    )


def quiet(n_runs: int) -> NoiseDraw:
    """Return a draw without any noise."""
    zero, one = np.zeros(n_runs), np.ones(n_runs)
    return NoiseDraw(zero, one, one, np.zeros((3, n_runs)), zero, zero, zero, zero, np.zeros((n_runs, 3)), seed=0)


def random_noise(rng: np.random.Generator, **fixed: Any) -> Noise:
    """Draw a case's noise: each source's scale over a factor of about four, the tails from t(3.5) to normal."""

    def within(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    drawn = {
        "texture_m": within(7e-5, 3e-4),
        "common": within(1e-5, 8e-5),
        "differential": within(4e-6, 3e-5),
        "start_heading_rad": within(5e-5, 6e-4),
        "laser_m": within(8e-4, 3e-3),
        "ref_xy_m": within(1e-3, 4e-3),
        "ref_theta_rad": within(3e-4, 1.5e-3),
        "stated_ratio": within(0.6, 1.6),
        "steer_rad": within(3e-4, 2e-3),
        "front": within(1e-4, 5e-4),
        "reading_rad": within(8e-4, 4e-3),
        "tail": float(rng.choice([3.5, 5.0, 8.0, np.inf])),
    }
    return Noise(**{**drawn, **fixed})
