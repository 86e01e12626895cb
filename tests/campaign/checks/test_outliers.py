"""Single runs far from the line of the others by load are named, also where no other run has their load."""

from __future__ import annotations

import numpy as np
import pytest

from calib.campaign.check import check_campaign
from calib.campaign.checks.settings import far_from_line
from calib.campaign.model import Campaign
from tests.campaign.making import with_numbers
from tests.radius.campaigns import campaign_of

N = 30
SIGMA_M = 0.0015


def driven(
    seed: int, *, lengths_m: tuple[float, float] = (25.0, 40.0), heavy: bool = False, days: float = 0.0
) -> Campaign:
    """Runs of loads of their own that scatter by a tenth of a per mille; `heavy`: one of twice the others' load."""
    rng = np.random.default_rng(seed)
    load = rng.uniform(300.0, 700.0 if heavy else 1300.0, (2, N))
    load[:, 12] = 1300.0 if heavy else load[:, 12]
    length = rng.uniform(*lengths_m, N)
    shift = np.repeat(days * rng.standard_normal(3), N // 3)
    numbers = {"distance_m": length + SIGMA_M * rng.standard_normal(N), "speed_mps": rng.uniform(0.3, 0.6, N)}
    for side, own in zip(("left", "right"), load, strict=True):
        radius = (0.1 - 1.2e-6 * (own - 300.0)) * (1.0 + 1e-4 * rng.standard_normal(N) + shift)
        numbers |= {f"load_{side}_N": own, f"counts_{side}": np.floor(length / (2 * np.pi * radius) * 4096)}
    labels = {"session": np.repeat(["d1", "d2", "d3"], N // 3), "kind": np.full(N, "corridor")}
    return campaign_of(numbers, labels=labels)


@pytest.mark.parametrize(
    ("column", "by"), [("counts_left", -4096.0), ("distance_m", 0.1), ("distance_m", -0.1), ("distance_m", 0.7)]
)
def test_a_run_off_is_named_without_repeats(column: str, by: float) -> None:
    """A turn lost, a digit, a mark 10 cm off: at any load, the lightest and the heaviest, too."""
    for seed in range(5):
        made = driven(seed)
        for run in (int(made.runs.number("load_left_N").argmin()), int(made.runs.number("load_left_N").argmax()), 7):
            spoilt = with_numbers(made, **{column: made.runs.number(column) + by * (np.arange(N) == run)})
            assert {note.run_id for note in far_from_line(spoilt)} == {f"r{run}"}


@pytest.mark.parametrize(
    "kind", [{}, {"lengths_m": (3.0, 40.0)}, {"heavy": True}, {"days": 3e-4}], ids=["usual", "short", "heavy", "days"]
)
def test_sound_runs_are_left_alone(kind: dict[str, float]) -> None:
    """Short runs scatter by more of their radius, and one load far from all others is no outlier."""
    named = [list(far_from_line(driven(seed, **kind))) for seed in range(40)]  # type: ignore[arg-type]
    assert sum(map(bool, named)) <= 1
    assert not check_campaign(driven(1)).wrong
