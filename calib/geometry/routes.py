"""How well each route is met before and after the calibration."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from calib.arrays import FloatArray
from calib.errors import BadInputError
from calib.geometry.parts import RouteResidual
from calib.geometry.recording import Recording
from calib.geometry.segments import Segments

if TYPE_CHECKING:
    from calib.campaign.model import Campaign


def rms(residuals: FloatArray) -> tuple[float, float, float]:
    """Return the root mean square of each channel, shape (n, 3) in, three numbers out."""
    x, y, theta = np.sqrt(np.mean(np.square(residuals), axis=0)) if len(residuals) else np.zeros(3)
    return float(x), float(y), float(theta)


def route_table(
    recording: Recording, segments: Segments, before: FloatArray, after: FloatArray
) -> tuple[RouteResidual, ...]:
    """Return the residuals by kind of route; where no kind is given, by the sense of the turn.

    `before`, `after` (shape (n, 3)): residuals of the nominal and the calibrated vehicle.
    """
    kind = recording.kind[segments.run]
    if (kind == "").all():
        turn = segments.measured[:, 2]
        kind = np.where(turn > 1.0, "turns left", np.where(turn < -1.0, "turns right", "hardly turns"))
    rows = []
    for name in np.unique(kind):
        part = kind == name
        x, y, theta = after[part].mean(axis=0)
        rows.append(
            RouteResidual(
                str(name), int(part.sum()), rms(before[part]), rms(after[part]), (float(x), float(y), float(theta))
            )
        )
    return tuple(rows)


def of_kinds(campaign: Campaign, kinds: Iterable[str]) -> Campaign:
    """Return the campaign with the runs of some kinds of routes; of all where none is named.

    `kinds`: labels in its column ``kind``. Raises BadInputError where no run has such a label.
    """
    wanted = set(kinds)
    if not wanted:
        return campaign
    kind = campaign.runs.label("kind")
    missing = wanted - set(kind)
    if missing:
        raise BadInputError(
            f"kinds: found {', '.join(sorted(missing))}; expected some of {', '.join(sorted(set(kind)))}; correct them"
        )
    return campaign.select(np.isin(kind, sorted(wanted)))
