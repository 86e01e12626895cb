"""What no named cause explains: its share of the gap, how strongly it shows, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from calib.gap.data.channels import Channel
from calib.gap.evidence.marginal import rows
from calib.gap.evidence.search import EVEN
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.evidence import Evidence
from calib.gap.verdict.outcome import Rest
from calib.gap.verdict.result import Cause

#: a rest is stated where it is at least so probable
STATED: Final = 0.5
#: a mean residual this many standard deviations from nought says where
SHOWS: Final = 4.0
#: places named at most
MOST_PLACES: Final = 3
#: a rest, or causes that cannot be told apart, that carry a larger share of the gap are part of the verdict's word
SMALL: Final = 0.05


def explained_share(evidence: Evidence) -> tuple[float, float]:
    """Return the share of the gap beyond its floor that the best hypothesis explains, 0 to 1, and its uncertainty."""
    nominal, chi_square = evidence.nominal, evidence.fitted.chi_square
    before = rows(nominal, evidence.noise, residuals(nominal, nominal)[:, :, None])[:, 0]
    excess = max(float(before @ before) - len(before), 1.0)
    share = float(np.clip(1.0 - max(chi_square - len(before), 0.0) / excess, 0.0, 1.0))
    # what noise alone leaves scatters as chi-square does
    return share, float(np.sqrt(2.0 * len(before)) / excess)


def rest_of(evidence: Evidence) -> Rest | None:
    """Return the rest beside the named causes; None where none is probable."""
    if evidence.search.rest < STATED:
        return None
    n_rows = int(evidence.observations.usable.sum())
    signal = float(np.sqrt(max(evidence.fitted.chi_square - n_rows, 0.0)))
    share = 1.0 - explained_share(evidence)[0]
    return Rest(share=share, signal=signal, where=_places(evidence)) if signal > 0 else None


def faint_beside(rest: Rest | None, causes: Sequence[Cause]) -> list[Cause]:
    """Return the causes, those fainter than a rest beside them with even odds at most.

    What left so much that no effect explains may have left that little, too. Of 33 such causes in development campaigns
    with an effect that no library has, or that the library was denied, named at up to 0.96, none was at work; of 10 in
    crowds, whose rest is fainter than most of what is at work, 9 were.
    """
    if rest is None or rest.share <= SMALL:
        return list(causes)
    return [
        replace(cause, probability=min(cause.probability, EVEN)) if cause.signal < rest.signal else cause
        for cause in causes
    ]


def _places(evidence: Evidence) -> tuple[str, ...]:
    """Return the kinds and channels whose mean residual stands out, and what the rest goes with."""
    observations, left = evidence.observations, evidence.fitted.left
    kinds = observations.labels["kind"]
    found = []
    for kind in np.unique(kinds):
        for channel in Channel:
            on = (kinds == kind) & observations.usable[:, channel]
            if on.sum() > 1:
                scaled = left[on, channel] / evidence.noise.floor[on, channel]
                mean = float(scaled.mean() * np.sqrt(on.sum()))
                found.append((abs(mean), f"kind {kind}, {channel.label}" if kind else channel.label))
    found.sort(reverse=True)
    places = [words for size, words in found[:MOST_PLACES] if size > SHOWS]
    rest = evidence.where.rest
    if rest is not None:
        places += [line.name.replace("_", " ") for line in rest.significant[:2]]
    return tuple(dict.fromkeys(places))
