"""What not knowing the noise costs: the diagnosis with the floor it estimates, and with the true one handed to it.

``python -m tests.challenge.known_floor [--each 3] [--empty 100] [--workers 2]``

Cases of development, drawn anew and never scored: every effect of the library at a signal of 5, `each` times, and empty
campaigns. The *own ceiling* is what the best rule of all reaches on them behind a gate for 5 % of false alarms.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

import numpy as np

from calib.challenge import Seeds, each, recipes
from calib.challenge.cases import Recipe, Truth, campaigns_of, case_design, truth_of
from calib.gap import diagnose as diagnosis
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.inference.marginal_likelihood import ScaleEvidence
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.predict import Path
from calib.plant import build_world, quiet
from calib.plant.drive import drive
from calib.plant.signal import covariance
from calib.types import FloatArray

SEED = 771155
SIGNAL = 5.0
MAX_RUNS = 160


def cases(per_effect: int, empty: int) -> list[Recipe]:
    """Return singles, each at a signal of 5, and empty cases."""
    listed = recipes(Seeds("development", SEED, {"single": 10_000, "empty": empty}))
    by_effect: dict[str, list[Recipe]] = {}
    for recipe in sorted((r for r in listed if r.group == "single"), key=lambda r: r.number):
        name = recipe.effects[0].partition("/")[0]
        of_this = by_effect.setdefault(name, [])
        if np.isfinite(recipe.targets[0]) and len(of_this) < per_effect:
            of_this.append(replace(recipe, targets=(SIGNAL,)))
    return [r for same in by_effect.values() for r in same] + [r for r in listed if r.group == "empty"]


def true_covariance(truth: Truth) -> FloatArray:
    """Return the covariance of the noise, shape (n_runs, 6, 6): along and lateral in the frame of the end's heading."""
    design = case_design(truth.recipe, truth.seed, truth.max_runs, truth.redraw)
    world = build_world(design, truth.model)
    record = drive(world, quiet(len(design)), quantise=False, step_s=0.04)
    cov = covariance(world, truth.noise, record)
    heading = record.last(record.odo)[2]
    turn = np.tile(np.eye(6), (len(cov), 1, 1))
    turn[:, 1, 1] = turn[:, 2, 2] = np.cos(heading)
    turn[:, 1, 2], turn[:, 2, 1] = np.sin(heading), -np.sin(heading)
    return np.asarray(turn @ cov @ turn.transpose(0, 2, 1))


@contextmanager
def floor_known(truth: Truth) -> Iterator[None]:
    """Hand the diagnosis the true noise in place of what it estimates."""
    cov = true_covariance(truth)

    def known(path: Path, gap: FloatArray) -> Noise:
        usable = path.s.usable
        # a run without anything measured is no unit
        held = cov[path.s.run]
        both = usable[:, :, None] & usable[:, None, :]
        estimated = estimate_noise(path, gap)
        exact = np.where(both, held, np.where(np.eye(6, dtype=bool), 1.0, 0.0))
        return replace(estimated, covariance=exact, weight=np.ones(len(held)), supported=True)

    # and nothing of it is integrated over
    with (
        mock.patch.object(diagnosis, "estimate_noise", known),
        mock.patch.object(ScaleEvidence, "is_open", return_value=False),
    ):
        yield


def answers(recipe: Recipe) -> tuple[str, float, tuple[bool, bool], tuple[bool, bool]]:
    """Return the group, the own ceiling, and by each floor whether a gap is reported and the truth named first."""
    truth = truth_of(recipe, SEED, MAX_RUNS)
    campaign, _ = campaigns_of(truth)
    estimated = diagnosis.diagnose_in_full(campaign, plan=False)
    with floor_known(truth):
        known = diagnosis.diagnose_in_full(campaign, plan=False)
    true = {cause.effect for cause in truth.causes}
    own = float("nan") if truth.own_ceiling is None else truth.own_ceiling[1]
    verdicts = (estimated, known)
    gap = [verdict.kind is not VerdictKind.NO_GAP for verdict in verdicts]
    first = [bool(verdict.causes) and verdict.causes[0].effect in true for verdict in verdicts]
    return recipe.group, own, (gap[0], gap[1]), (first[0], first[1])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=re.sub(r"\s+", " ", (__doc__ or "").partition("\n")[0]))
    parser.add_argument("--each", type=int, default=3)
    parser.add_argument("--empty", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    given_answers = each(answers, cases(given.each, given.empty), given.workers, lambda _done: None)
    singles = [(own, first) for group, own, _, first in given_answers if group == "single" and np.isfinite(own)]
    alarms = [gap for group, _, gap, _ in given_answers if group == "empty"]
    ceiling = sum(own for own, _ in singles)
    for place, name in enumerate(("estimated", "the true one")):
        named = sum(first[place] for _, first in singles)
        sys.stdout.write(
            f"floor {name}: first {named} of {len(singles)} at a signal of {SIGNAL:.0f}, own ceiling {ceiling:.1f}, "
            f"{named / ceiling:.2f} of it; false alarms {sum(gap[place] for gap in alarms)} of {len(alarms)}\n"
        )


if __name__ == "__main__":
    main()
