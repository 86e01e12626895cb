"""The table of covariates is held to one error by Holm's steps, as statsmodels takes them."""

from __future__ import annotations

import numpy as np
import pytest
from statsmodels.stats.multitest import multipletests

from calib.gap.data.channels import Channel
from calib.gap.where.locate import FALSE_FINDING, held_to_one_error
from calib.gap.where.result import CovariateLine


def line(p_value: float, share: float = 0.5) -> CovariateLine:
    return CovariateLine(f"p{p_value}", Channel.ALONG, share, None, p_value, significant=False)


@pytest.mark.parametrize("seed", range(20))
def test_the_lines_that_stand_are_those_of_statsmodels(seed: int) -> None:
    """Same p values, same decisions, whatever order they come in."""
    rng = np.random.default_rng(seed)
    p_values = rng.uniform(size=rng.integers(1, 15)) ** rng.integers(1, 8)
    table = held_to_one_error([line(float(p)) for p in p_values])
    assert [entry.p_value for entry in table] == sorted(p_values)
    stands = multipletests([entry.p_value for entry in table], alpha=FALSE_FINDING, method="holm")[0]
    assert [entry.significant for entry in table] == stands.tolist()


def test_an_empty_table_stays_empty() -> None:
    assert held_to_one_error([]) == ()


def test_of_equal_p_the_larger_share_stands_first() -> None:
    assert [entry.share for entry in held_to_one_error([line(0.2, 0.1), line(0.2, 0.7)])] == [0.7, 0.1]
