"""Items are shared out whole, in order, and so that workers end together."""

from __future__ import annotations

import numpy as np
import pytest

from calib.fleet.workers import batches

LARGEST = 16


@pytest.mark.parametrize("workers", [1, 2, 7])
@pytest.mark.parametrize("n_items", [0, 1, 9, 500])
def test_every_item_is_in_one_batch(n_items: int, workers: int) -> None:
    """In order, no batch empty, none heavier than it may be unless it is a single item."""
    weights = np.random.default_rng(3).integers(0, 20, n_items)
    cut = batches(range(n_items), lambda item: int(weights[item]), LARGEST, workers)
    assert [item for batch in cut for item in batch] == list(range(n_items))
    assert all(len(batch) == 1 or sum(max(weights[item], 1) for item in batch) <= LARGEST for batch in cut)


def test_the_last_batches_are_single_items() -> None:
    """A worker that takes the last batch keeps the others waiting for one item only, and for many items few are."""
    cut = batches(range(2000), lambda _: 1, LARGEST, 2)
    assert {len(batch) for batch in cut[-4:]} == {1}
    assert len(cut) < 2 * 2000 / LARGEST


def test_batches_are_cut_no_smaller_than_handing_over_is_worth() -> None:
    """None but the last holds less than the least, no matter what would be left for the others."""
    cut = batches(range(2000), lambda _: 1, 256, 2, smallest=8)
    assert all(len(batch) >= 8 for batch in cut[:-1])
    assert len(cut[-2]) == 8
    assert len(cut) < 25
