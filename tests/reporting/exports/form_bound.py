"""How near AMCL's alphas can come to the spread of recorded runs: ``python -m tests.reporting.exports.form_bound``.

AMCL's motion model predicts variances along, lateral and in heading that are linear in four alphas, none below zero. A
linear programme finds the alphas whose predicted standard deviations deviate least from those observed, in the worst of
the three channels: no fit can do better. Beside that stands what chance does: campaigns drawn by AMCL's own sampler on
the same paths (particles, one a run, by no code of calib's), with the alphas of the export as the truth, and fitted
again. Ratios within the central 95 % of these are what few runs show of a model that is right. A bound beyond what the
draws show is the form's: errors that stay the same during a run.

The sample campaigns `corridor_crossed` and `yard`, and the OptiOdom recordings of the folder `shared`; `yard N` makes
the yard again with N other seeds of its noise.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import linprog

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.diagnose import diagnose_in_full
from calib.plant.make import make_campaign
from calib.reporting.exports.nav2 import (
    POSE,
    UPDATE_MIN_A_RAD,
    UPDATE_MIN_D_M,
    fitted,
    motion_noise,
    spread_of,
)
from tests.real.recordings import optiodom_differential

ROOT = Path(__file__).parents[3]
RECORDINGS = ROOT.parent / "shared" / "data"
#: campaigns drawn by AMCL's sampler
DRAWN = 200
#: halvings of the interval in which the bound lies
HALVINGS = 30


def least_deviation(components: np.ndarray, reference: np.ndarray, square: np.ndarray) -> float:
    """Return the smallest worst |log ratio| of standard deviations that any alphas, none negative, leave, as a factor.

    `components` (4, 3), `reference` (3,) and `square` (3,): mean variances for an alpha of 1, of the reference, and as
    observed.
    """
    share = components / square
    # one that these paths do not ask for has no part
    share = (share / np.maximum(share.max(axis=1, keepdims=True), 1e-30)).T
    low, high = 1.0, 1e3
    for _ in range(HALVINGS):
        factor = np.sqrt(low * high)
        upper, lower = factor**2 - reference / square, reference / square - factor**-2
        found = linprog(np.zeros(len(components)), np.vstack([share, -share]), np.concatenate([upper, lower]))
        low, high = (low, factor) if found.status == 0 else (factor, high)
    return float(high)


def ends(poses: np.ndarray, alpha: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return ends of particles (count, 3) in the frame of the path's end, as nav2_amcl draws them between updates."""
    kept = [0]
    for at, pose in enumerate(poses):
        off = pose - poses[kept[-1]]
        if np.hypot(off[0], off[1]) >= UPDATE_MIN_D_M or abs(off[2]) >= UPDATE_MIN_A_RAD or at == len(poses) - 1:
            kept.append(at)
    x, y, heading = np.zeros(count), np.zeros(count), np.zeros(count)
    for old, new in pairwise(poses[kept]):
        way = np.hypot(*(new - old)[:2])
        first = 0.0 if way < 0.01 else _wrapped(np.arctan2(new[1] - old[1], new[0] - old[0]) - old[2])
        second = _wrapped(new[2] - old[2] - first)
        noisy = [min(abs(turn), abs(_wrapped(turn - np.pi))) for turn in (first, second)]
        sd = [np.sqrt(alpha[0] * turn**2 + alpha[1] * way**2) for turn in noisy]
        gone = way + rng.normal(0.0, np.sqrt(alpha[2] * way**2 + alpha[3] * (noisy[0] ** 2 + noisy[1] ** 2)), count)
        heading = heading + first + rng.normal(0.0, sd[0], count)
        x, y = x + gone * np.cos(heading), y + gone * np.sin(heading)
        heading = heading + second + rng.normal(0.0, sd[1], count)
    c, s = np.cos(poses[-1, 2]), np.sin(poses[-1, 2])
    dx, dy = x - poses[-1, 0], y - poses[-1, 1]
    return np.column_stack((c * dx + s * dy, c * dy - s * dx, _wrapped(heading - poses[-1, 2])))


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True)
class Bound:
    """Observed over predicted along, lateral, in heading; the bound by the form; both in campaigns that AMCL drew."""

    ratios: np.ndarray  #: as exported (3,)
    interval: np.ndarray  #: (3, 2)
    least: float  #: factor, see `least_deviation`
    drawn_ratios: np.ndarray  #: central 95 % (2, 3)
    drawn_least: float  #: 95th percentile

    def __str__(self) -> str:
        """The figures in three lines."""
        low, high = self.drawn_ratios
        by_chance = ", ".join(f"{a:.2f} to {b:.2f}" for a, b in zip(low, high, strict=True))
        intervals = ", ".join(
            f"{r:.2f} ({a:.2f} to {b:.2f})" for r, (a, b) in zip(self.ratios, self.interval, strict=True)
        )
        return (
            f"  observed over predicted along, lateral, in heading: {intervals}\n"
            f"  if AMCL's model were right, 95 % of such campaigns: {by_chance}\n"
            f"  no alphas bring all three within {100 * (self.least - 1):.1f} %; if the model were right, 95 % of such "
            f"campaigns below {100 * (self.drawn_least - 1):.1f} %\n"
        )


def bound(campaign: Campaign, drawn: int = DRAWN) -> Bound:
    """Diagnose a campaign, fit the alphas, and hold both the fit and its form against chance."""
    diagnosis = diagnose_in_full(campaign, plan=False)
    exported = motion_noise(diagnosis)
    observations = diagnosis.observations
    units = np.asarray(observations.usable[:, POSE].all(axis=1))
    kinds, residuals = observations.labels["kind"][units], diagnosis.arrays.held_out.after[units][:, POSE]
    spread = spread_of(diagnosis.correction.path, units, "amcl")
    mean = np.einsum("cuii->ci", spread.components) / len(residuals)
    reference = np.einsum("uii->i", spread.reference) / len(residuals)
    alpha = fitted(spread, residuals, kinds).sizes
    rng = np.random.default_rng(1)
    sigma = np.sqrt(np.einsum("uii->ui", spread.reference))
    traces = [trace for trace, on in zip(diagnosis.correction.path.traces(), units, strict=True) if on]
    every = np.stack([ends(path, alpha, drawn, rng) for path in traces], axis=1)
    every += rng.normal(size=every.shape) * sigma
    ratios = [fitted(spread, seen, kinds).ratios for seen in every]
    least = [least_deviation(mean, reference, np.mean(seen**2, axis=0)) for seen in every]
    return Bound(
        exported.held_out.ratios,
        exported.held_out.interval,
        least_deviation(mean, reference, np.mean(residuals**2, axis=0)),
        np.percentile(ratios, [2.5, 97.5], axis=0),
        float(np.percentile(least, 95.0)),
    )


def yard_again(seeds: int) -> str:
    """Return mean and scatter of the yard's ratios over other seeds of its noise."""
    from sample_runs import make_yard

    found = []
    for seed in range(1, seeds + 1):
        rng = np.random.default_rng([make_yard.SEED + seed, 1])
        model, noise = make_yard.MODEL, make_yard.NOISE
        made = make_campaign(make_yard.design(), make_yard.truth(), rng, noise=noise, model=model, name="yard")
        found.append(motion_noise(diagnose_in_full(made, plan=False)).held_out.ratios)
    mean, sd = np.mean(found, axis=0), np.std(found, axis=0)
    return f"yard, {seeds} other seeds: mean ratios {mean.round(3)}, standard deviation {sd.round(3)}\n"


CAMPAIGNS: dict[str, Callable[[], Campaign]] = {
    "corridor_crossed": lambda: read_campaign(ROOT / "sample_runs" / "corridor_crossed"),
    "yard": lambda: read_campaign(ROOT / "sample_runs" / "yard"),
    "optiodom": lambda: optiodom_differential(RECORDINGS),
}

if __name__ == "__main__":
    if len(sys.argv) == 3:
        sys.stdout.write(yard_again(int(sys.argv[2])))
    else:
        for name in sys.argv[1:] or CAMPAIGNS:
            sys.stdout.write(f"{name}\n{bound(CAMPAIGNS[name]())}")
            sys.stdout.flush()
