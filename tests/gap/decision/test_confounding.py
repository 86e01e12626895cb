"""That nothing is off is one probability: no effect, and beside no effect no calibration parameter."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from calib.gap.decision.confounding import credible_sets, gap_probability
from calib.gap.inference.recalibration import NAMES, SUBSETS

OFF = np.array([float(subset == (2,)) for subset in SUBSETS])


def evidence(beside_nothing: np.ndarray) -> SimpleNamespace:
    """A track off, or scrub beside which none is: equally likely, so none is off with 0.5 in their mean."""
    names = [tuple(NAMES[k] for k in subset) for subset in SUBSETS]
    mean = 0.5 * OFF + 0.5 * np.eye(len(SUBSETS))[0]
    return SimpleNamespace(
        situation=SimpleNamespace(faults=()),
        effects=dict.fromkeys([*NAMES, "curve_scrub"]),
        search=SimpleNamespace(
            models=((), ("curve_scrub",)),
            probabilities=np.array([0.5, 0.5]),
            nothing=0.5,
            beside_nothing=beside_nothing,
        ),
        recalibration=SimpleNamespace(subsets=names, probabilities=mean),
    )


def test_a_track_that_scrub_may_be_instead_leaves_no_doubt_that_there_is_a_gap() -> None:
    """Half the hypotheses have no effect, half leave the track: none of them does both."""
    certain = evidence(OFF)
    assert gap_probability(certain) == 1.0  # type: ignore[arg-type]
    assert () not in credible_sets(certain, ())  # type: ignore[arg-type]
    # where the track is as believed beside no effect, too, half a gap is left
    open_ = evidence(np.eye(len(SUBSETS))[0])
    assert gap_probability(open_) == 0.5  # type: ignore[arg-type]
    assert () in credible_sets(open_, ())  # type: ignore[arg-type]
