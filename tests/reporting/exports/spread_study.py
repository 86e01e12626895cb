"""Predicted against true spread of end poses over many campaigns of a plant in plain numpy whose noise is known.

``python -m tests.reporting.exports.spread_study [CAMPAIGNS]`` prints, for each kind of noise, true over predicted
standard deviation (mean over campaigns), how much it scatters from campaign to campaign, which is the chance of few
runs, how often its 95 % interval holds it, and what AMCL's form alone makes of it. Last come bounds, by a linear
programme over all alphas that are not negative (`form_bound`): by how much the worst of the three standard deviations
is off at the least, on all runs, on corridors and squares each by alphas of their own, and on both kinds by the same
alphas; with AMCL's differential model at several steps of the filter, and with its omnidirectional one.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np

from calib.reporting.exports import nav2
from calib.reporting.exports.nav2 import MODELS, Spread, amcl_components, fitted, form_ratios
from tests.reporting.exports.form_bound import least_deviation

#: a pose every so often
STEP_M = 0.05
CORRIDOR_M, SIDE_M, CORNER_RADIUS_M = 20.0, 4.0, 0.5
#: standard uncertainty of the reference: along, lateral (m), heading (rad)
REFERENCE = np.array([2e-3, 2e-3, 7e-4])
#: runs of a campaign: about those of `sample_runs/yard`
RUNS = {"corridor": 32, "square_ccw": 16, "square_cw": 16}
#: runs that the true spread is taken from: 1 % of a standard deviation
TRUE_RUNS = 5000
#: runs of the whole campaign that the ratio by AMCL's form is taken from
FORM_RUNS = 20


@dataclass(frozen=True)
class Noise:
    """Random walks of way and heading a root metre, errors constant in a run, degrees of freedom of the latter."""

    walk_m: float = 0.0
    walk_rad: float = 0.0
    scale: float = 0.0
    curvature: float = 0.0
    turn_scale: float = 0.0
    dof: float = np.inf

    def constant(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Errors of each run that stay the same, shape (3, n, 1); heavy tails have the same standard deviation."""
        sizes = np.array([self.scale, self.curvature, self.turn_scale])[:, None, None]
        if np.isinf(self.dof):
            return sizes * rng.normal(size=(3, n, 1))
        return sizes * rng.standard_t(self.dof, size=(3, n, 1)) * np.sqrt((self.dof - 2.0) / self.dof)


#: white: what AMCL's model is made for; the others add errors that stay during a run
NOISES = {
    "walks": Noise(4e-4, 3.5e-4),
    "walks and a quarter constant": Noise(3.5e-4, 3e-4, 4e-5, 4e-5, 1e-4),
    "the same, heavy tails": Noise(3.5e-4, 3e-4, 4e-5, 4e-5, 1e-4, 4.5),
    "constant alone": Noise(0.0, 0.0, 1.2e-4, 8e-5, 3e-4),
}


def route(kind: str) -> np.ndarray:
    """Way and turn of each step, shape (n, 2)."""
    if kind == "corridor":
        return np.tile([STEP_M, 0.0], (round(CORRIDOR_M / STEP_M), 1))
    sign = 1.0 if kind == "square_ccw" else -1.0
    n = round(CORNER_RADIUS_M * np.pi / 2 / STEP_M)
    corner = np.tile([CORNER_RADIUS_M * np.pi / 2 / n, sign * np.pi / 2 / n], (n, 1))
    return np.vstack([np.tile([STEP_M, 0.0], (round(SIDE_M / STEP_M), 1)), corner] * 4)


def poses(steps: np.ndarray) -> np.ndarray:
    """Poses along steps (..., n, 2), from the origin, shape (..., n + 1, 3)."""
    heading = np.cumsum(steps[..., 1], axis=-1)
    middle = heading - 0.5 * steps[..., 1]
    x, y = (np.cumsum(steps[..., 0] * f(middle), axis=-1) for f in (np.cos, np.sin))
    path = np.stack((x, y, heading), axis=-1)
    return np.concatenate((np.zeros_like(path[..., :1, :]), path), axis=-2)


def residuals(kind: str, noise: Noise, n: int, rng: np.random.Generator) -> np.ndarray:
    """Measured minus predicted end of n runs: along and left of the predicted heading, and heading, shape (n, 3)."""
    steps = route(kind)
    root = np.sqrt(steps[:, 0])
    scale, curvature, turns = noise.constant(rng, n)
    way = steps[:, 0] * (1.0 + scale) + noise.walk_m * root * rng.normal(size=(n, len(steps)))
    turn = steps[:, 1] * (1.0 + turns) + curvature * steps[:, 0] + noise.walk_rad * root * rng.normal(size=way.shape)
    end, true = poses(steps)[-1], poses(np.stack((way, turn), axis=-1))[:, -1]
    off = true - end
    c, s = np.cos(end[2]), np.sin(end[2])
    turned = np.column_stack((c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0], off[:, 2]))
    return turned + REFERENCE * rng.normal(size=(n, 3))


COMPONENTS = {model: {kind: make(poses(route(kind))) for kind in RUNS} for model, (_, make) in MODELS.items()}


def spread(model: str, kinds: np.ndarray) -> Spread:
    """Components of a model on runs of these kinds."""
    reference = np.tile(np.diag(REFERENCE**2), (len(kinds), 1, 1))
    return Spread(MODELS[model][0], np.stack([COMPONENTS[model][kind] for kind in kinds], axis=1), reference)


@dataclass(frozen=True)
class Outcome:
    """True over predicted standard deviation by group and channel, (n_campaigns, 3, 3): all, corridors, squares."""

    ratios: np.ndarray
    #: whether the interval held the ratio of all runs (n_campaigns, 3)
    held: np.ndarray
    #: ratio by the form of AMCL's model as a campaign of many runs states it (3,)
    form: np.ndarray


def study(noise: Noise, campaigns: int, seed: int) -> Outcome:
    """Fit AMCL's alphas to many campaigns and hold what they predict against the true spread."""
    rng = np.random.default_rng(seed)
    true = {kind: np.mean(residuals(kind, noise, TRUE_RUNS, rng) ** 2, axis=0) for kind in RUNS}
    kinds = np.repeat(list(RUNS), list(RUNS.values()))
    amcl = spread("amcl", kinds)
    groups = (kinds != "", kinds == "corridor", kinds != "corridor")
    found, held = [], []
    for _ in range(campaigns):
        seen = np.vstack([residuals(kind, noise, n, rng) for kind, n in RUNS.items()])
        result = fitted(amcl, seen, kinds)
        predicted = np.einsum("uii->ui", amcl.covariance(result.sizes))
        exact = np.array([true[kind] for kind in kinds])
        found.append([np.sqrt(exact[on].mean(axis=0) / predicted[on].mean(axis=0)) for on in groups])
        held.append((result.interval[:, 0] <= found[-1][0]) & (found[-1][0] <= result.interval[:, 1]))
    many = np.repeat(list(RUNS), [FORM_RUNS * n for n in RUNS.values()])
    seen = np.vstack([residuals(kind, noise, FORM_RUNS * n, rng) for kind, n in RUNS.items()])
    form = form_ratios(spread("amcl", many), (spread("walk", many), spread("constant", many)), seen)
    return Outcome(np.array(found), np.array(held), form)


def omni_components(path: np.ndarray) -> np.ndarray:
    """Return the covariance of a path's end that each alpha of 1 makes in nav2_amcl's OmniMotionModel, (5, 3, 3).

    Between two updates the way has the variance alpha3 way^2 + alpha1 turn^2, the turn alpha4 turn^2 + alpha2 way^2,
    and the motion aside alpha1 turn^2 + alpha5 way^2.
    """
    knots = path[nav2._updates(path)]
    step, end = np.diff(knots, axis=0), knots[-1]
    way2, turn2 = step[:, 0] ** 2 + step[:, 1] ** 2, step[:, 2] ** 2
    course = np.where(way2 > 0.0, np.arctan2(step[:, 1], step[:, 0]), knots[:-1, 2])
    along, aside = (nav2._directions(course + turned, end) for turned in (0.0, 0.5 * np.pi))
    # as the filter adds them: the way along the direction before the turn is drawn, the turn at the end of the step
    turned = nav2._levers(knots[1:], end)
    outer = nav2._outer
    return np.stack(
        (
            outer(along, turn2) + outer(aside, turn2),
            outer(turned, way2),
            outer(along, way2),
            outer(turned, turn2),
            outer(aside, way2),
        )
    )


#: model and steps of the filter (m, rad) for the bounds
FORMS = {
    "differential": (amcl_components, (0.25, 0.2)),
    "differential, 0.1 m, 0.1 rad": (amcl_components, (0.1, 0.1)),
    "differential, 1 m, 0.8 rad": (amcl_components, (1.0, 0.8)),
    "differential, 2 m, 1.6 rad": (amcl_components, (2.0, 1.6)),
    "omnidirectional": (omni_components, (0.25, 0.2)),
    "omnidirectional, 1 m, 0.8 rad": (omni_components, (1.0, 0.8)),
}


def bounds(noise: Noise) -> list[str]:
    """Return a line for each form of the model: the least worst deviation that any alphas leave."""
    rng = np.random.default_rng(2)
    true = {kind: np.mean(residuals(kind, noise, TRUE_RUNS, rng) ** 2, axis=0) for kind in ("corridor", "square_ccw")}
    share = np.array([RUNS["corridor"], RUNS["square_ccw"] + RUNS["square_cw"]]) / sum(RUNS.values())
    lines = []
    for name, (components, steps) in FORMS.items():
        with patch.multiple(nav2, UPDATE_MIN_D_M=steps[0], UPDATE_MIN_A_RAD=steps[1]):
            made = [np.einsum("cii->ci", components(poses(route(kind)))) for kind in true]
        seen, known = list(true.values()), REFERENCE**2
        mixed = least_deviation(np.einsum("k,kci->ci", share, made), known, share @ seen)
        each = [least_deviation(one, known, square) for one, square in zip(made, seen, strict=True)]
        both = least_deviation(np.concatenate(made, axis=1), np.tile(known, 2), np.concatenate(seen))
        listed = ", ".join(f"{100 * (factor - 1):.1f} %" for factor in (mixed, *each, both))
        lines.append(f"  at the least, {name}: all, corridors, squares, each of both: {listed}")
    return lines


def table(campaigns: int) -> list[str]:
    """Return the lines of the table."""
    lines = [f"{campaigns} campaigns of {sum(RUNS.values())} runs; true over predicted: along, lateral, heading"]
    for name, noise in NOISES.items():
        outcome = study(noise, campaigns, seed=1)
        lines.append(name)
        for at, group in enumerate(("all runs", "corridors", "squares")):
            mean, chance = outcome.ratios[:, at].mean(axis=0), outcome.ratios[:, at].std(axis=0)
            lines.append(f"  {group:10s} mean {mean.round(3)}  standard deviation by chance {chance.round(3)}")
        held = outcome.held.mean(axis=0)
        lines.append(f"  interval held it in {held.round(3)}; by AMCL's form {outcome.form.round(3)}")
        lines += bounds(noise)
    return lines


if __name__ == "__main__":
    sys.stdout.write("\n".join(table(int(sys.argv[1]) if len(sys.argv) > 1 else 50)) + "\n")
