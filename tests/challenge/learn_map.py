"""Learn the map of stated probabilities from diagnosed sets: ``python -m tests.challenge.learn_map SET...``.

Prints, for bins of the model's own probability (what is stated, taken back through the present map), how many causes
were named so and how many of them were at work. A cause that the plant's own measure cannot tell from a deleted truth
is omitted: no diagnosis could.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from calib.challenge.judge import RESOLVED_SIGMAS, judge
from calib.challenge.score import open_truth
from calib.gap.decision.confounding import TABLE

EDGES = (0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 0.99, 1.0)


def statements(folder: Path) -> list[tuple[float, bool]]:
    """Return the model's probability of each named cause of a set, and whether it was at work."""
    truths, _ = open_truth(folder)
    listed = []
    for path in sorted((folder / "verdicts").glob("*.json")):
        verdict, truth = json.loads(path.read_text(encoding="utf-8")), truths[path.stem]
        if truth.recipe.group == "alias":
            continue
        near = {name for name, distance in truth.rivals if distance < RESOLVED_SIGMAS}
        for (stated, held), cause in zip(judge(truth, verdict).statements, verdict.get("causes", ()), strict=True):
            if held or cause["effect"] not in near:
                listed.append((float(np.interp(stated, TABLE[1], TABLE[0])), held))
    return listed


def main(folders: list[str]) -> None:
    """Print the table."""
    pairs = np.array([pair for folder in folders for pair in statements(Path(folder))])
    for number, low in enumerate(EDGES[:-1]):
        inside = (pairs[:, 0] >= low) & ((pairs[:, 0] < EDGES[number + 1]) | (number == len(EDGES) - 2))
        if inside.any():
            model, held = pairs[inside].mean(axis=0)
            sys.stdout.write(f"{low:.2f}: {inside.sum()} named, model {model:.3f}, held {held:.3f}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
