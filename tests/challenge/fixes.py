"""How often a right fix is recommended, and a wrong one: ``python -m tests.challenge.fixes [--seed 515151] [--of 40]``.

Cases of development, drawn anew and never scored. Of each group: verdicts that are right and whose correction holds for
other journeys, how many of these are recommended, and fixes recommended with a cause that is not at work.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from functools import partial

from calib.challenge import Seeds, each, recipes
from calib.challenge.cases import Recipe, campaigns_of, truth_of
from calib.challenge.judge import Judged, judge
from calib.challenge.score import wilson
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import effect_class

MAX_RUNS = 160
#: singles below this signal show too little for a fix
LEAST_SIGNAL = 5.0
CASES = {"single": 212, "pair": 32, "empty": 24, "deleted": 24, "outside": 24, "calibration": 14}


def answer(recipe: Recipe, seed: int) -> tuple[Judged, bool]:
    """Return how a case went, and whether what it names holds for other journeys."""
    truth = truth_of(recipe, seed, MAX_RUNS)
    campaign, _ = campaigns_of(truth)
    exclude = (recipe.deleted,) if recipe.deleted else ()
    diagnosis = diagnose_in_full(campaign, plan=False, exclude=exclude)
    return judge(truth, diagnosis.to_dict()), not any(
        effect_class(cause.effect).not_transferable for cause in diagnosis.causes
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seed", type=int, default=515151)
    parser.add_argument("--of", type=int, default=400, help="cases at most")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    drawn = recipes(Seeds("development", given.seed, CASES))
    # a target of NaN is the effect at its typical size
    strong = [one for one in drawn if one.group != "single" or not one.targets[0] < LEAST_SIGNAL]
    answers = each(partial(answer, seed=given.seed), strong[: given.of], given.workers, lambda _done: None)
    by_group: dict[str, list[tuple[Judged, bool]]] = defaultdict(list)
    for judged, holds in answers:
        by_group[judged.group].append((judged, holds))
    sys.stdout.write("| group | cases | right, and it holds elsewhere | of these recommended | 95 % | wrong fixes |\n")
    sys.stdout.write("|---|---|---|---|---|---|\n")
    for group, of in by_group.items():
        right = [judged for judged, holds in of if judged.right and holds and judged.named]
        fixed = sum(judged.recommended for judged in right)
        low, high = wilson(fixed, len(right))
        wrong = sum(judged.wrong_fix for judged, _ in of)
        share = f"{100 * low:.0f} to {100 * high:.0f} %" if right else ""
        sys.stdout.write(f"| {group} | {len(of)} | {len(right)} | {fixed} | {share} | {wrong} |\n")


if __name__ == "__main__":
    main()
