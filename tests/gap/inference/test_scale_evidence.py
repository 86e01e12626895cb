"""Evidence over the scales of the noise: Laplace's method against draws of the scales from their prior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from calib.gap.effects.load import LoadRadius
from calib.gap.inference.fit import fit
from calib.gap.inference.least_squares import LinearSystem
from calib.gap.inference.local_search import LocalSearch
from calib.gap.inference.marginal_likelihood import ScaleEvidence, log_marginal
from calib.gap.inference.model_search import _weighed
from calib.gap.inference.noise import estimate_noise
from calib.gap.inference.noise_components import COMPONENTS, PRIOR_MEDIANS, NoiseComponents
from calib.gap.inference.repeatability import PRIOR_SPREADS
from calib.gap.observations import Channel
from calib.gap.predict import predict, residuals
from calib.types import FloatArray
from tests.gap import noise_bias
from tests.gap.effects.making import Motion, Run, situation

#: draws of the scales from their prior; of these some thousand count, a standard error of 0.03
DRAWS = 200_000
#: Laplace's method about the most likely scales, and the draws
LAPLACE = 0.15


def system_of(scatter: float, n_runs: int, load_slope: float) -> LinearSystem:
    """Runs along a corridor at three loads, whose radii scatter, with a law of the load or none."""
    rng = np.random.default_rng(4)

    def truth(run: Run, now: Motion) -> None:
        now.laser_m = rng.normal(0, 0.0015)
        now.left, now.right = scatter * rng.standard_normal(2) + load_slope * (run.load_left_N - 500.0)

    loads = [300.0 + 200.0 * (k % 3) for k in range(n_runs)]
    runs = [Run([(12.0, 0.0)], steps=30, kind="corridor", load_left_N=x, load_right_N=x) for x in loads]
    for run in runs:
        run.front = False
    observations = situation(runs, truth=truth)
    # the laser alone: matrices of as many rows as runs
    laser = np.arange(observations.measured.shape[1]) == Channel.DISTANCE
    observations = replace(observations, usable=observations.usable & laser)
    nominal = predict(observations)
    noise = estimate_noise(nominal, residuals(nominal, nominal))
    return LinearSystem(fit(nominal, noise), nominal, noise, LoadRadius().forms(observations)[:1])


def drawn_ratio(system: LinearSystem, models: tuple[FloatArray, FloatArray]) -> float:
    """Return the log evidence of the second model over the first, scales drawn from their prior, dense matrices."""
    shapes, noise, unit = NoiseComponents.about(system.path), system.noise, system.blocks.unit
    # out of units of the estimated noise
    deviation = noise.floor[unit, Channel.DISTANCE]
    gap, moved = deviation * system.gap, [deviation[:, None] * model for model in models]
    z = np.random.default_rng(5).standard_normal((DRAWS, len(COMPONENTS)))
    variance = (PRIOR_MEDIANS * np.exp(PRIOR_SPREADS * z)) ** 2
    of_scales = shapes.kernels[:, unit, Channel.DISTANCE, Channel.DISTANCE]
    diagonal = (variance @ of_scales + shapes.fixed[unit, Channel.DISTANCE, Channel.DISTANCE]) / noise.weight[unit]
    totals = []
    for columns in moved:
        # by the matrix inversion lemma, which the package does not use for this
        inner = np.eye(columns.shape[1]) + np.einsum("ri,dr,rj->dij", columns, 1 / diagonal, columns)
        along = (gap / diagonal) @ columns
        square = (gap**2 / diagonal).sum(axis=1) - (along * np.linalg.solve(inner, along[:, :, None])[:, :, 0]).sum(
            axis=1
        )
        log_det = np.log(diagonal).sum(axis=1) + np.linalg.slogdet(inner)[1]
        totals.append(float(logsumexp(-0.5 * (square + log_det))))
    return totals[1] - totals[0]


def ratios(scatter: float, load_slope: float) -> tuple[float, float, float]:
    """Return log p(y | law) - log p(y | none): beside the estimated scales, by Laplace's method, and by draws."""
    system = system_of(scatter, 12, load_slope)
    models = system.calibration, np.concatenate([system.calibration, 0.3 * system.of(0)], axis=1)
    evidence, estimated = ScaleEvidence(system), []
    for columns in models:
        whole = np.eye(len(columns)) + columns @ columns.T
        square = float(system.gap @ np.linalg.solve(whole, system.gap))
        estimated.append(float(log_marginal(square, float(np.linalg.slogdet(whole)[1]), len(columns))))
    beside = estimated[1] - estimated[0]
    return beside, beside + evidence.gain(models[1]) - evidence.gain(models[0]), drawn_ratio(system, models)


@pytest.mark.parametrize(("scatter", "load_slope"), [(1e-4, 0.0), (4e-4, 3e-6)])
def test_the_integral_over_the_scales_is_that_of_draws_from_their_prior(scatter: float, load_slope: float) -> None:
    """Radii that scatter as the prior has them, and eight times as much, where the estimate is 10 units of log off."""
    _, integrated, drawn = ratios(scatter, load_slope)
    assert integrated == pytest.approx(drawn, abs=LAPLACE)


def test_a_law_that_scatter_explains_too_is_less_probable_than_beside_the_estimate() -> None:
    """Three components explain such a gap nearly alike, each a mode of its own; the integral takes the best."""
    estimated, integrated, drawn = ratios(1e-4, 1.5e-6)
    assert drawn < integrated < estimated


def test_noise_estimated_too_small_makes_no_gap() -> None:
    """Noise alone is integrated however little it weighs beside the estimate: it gains most where that is too small."""
    right = system_of(1e-4, 24, 6e-7)
    small = replace(
        right.noise,
        covariance=right.noise.covariance / 9.0,
        scales={name: scale / 3.0 for name, scale in right.noise.scales.items()},
    )
    nothing = []
    for noise in (right.noise, small):
        system = LinearSystem(fit(right.path, noise), right.path, noise, right.forms)
        nothing.append(_weighed(LocalSearch(system), {}).nothing)
    assert nothing[1] > 0.5 * nothing[0] > 0.0


@pytest.mark.parametrize(("off", "seeds", "believed"), [(0.0, 30, True), (3e-3, 5, False)])
def test_a_reference_coarser_than_stated_makes_no_radius_wrong(off: float, seeds: int, believed: bool) -> None:
    """Two dozen runs, positions three times as coarse, which replicates take for a heading's walk in some campaigns.

    The calibration as believed is integrated over the scales as well; radii that are off stay so.
    """
    for seed in range(seeds):
        walk = noise_bias.truth_of("heading walk", np.random.default_rng([5, seed]))

        def truth(run: Run, now: Motion, walk: Callable[[Run, Motion], None] = walk) -> None:
            walk(run, now)
            now.end_x_m, now.end_y_m, now.yaw_rad = 3.0 * now.end_x_m, 3.0 * now.end_y_m, 3.0 * now.yaw_rad
            now.left = now.right = off

        seen = situation(noise_bias.runs_of("mixed", 24), truth=truth)
        no_laser = np.arange(seen.measured.shape[1]) != Channel.DISTANCE
        nominal = predict(replace(seen, usable=seen.usable & no_laser))
        noise = estimate_noise(nominal, residuals(nominal, nominal))
        local = LocalSearch(LinearSystem(fit(nominal, noise), nominal, noise, ()))
        assert (_weighed(local, {}).as_believed > 0.5) is believed
