"""What a verdict's fix is worth: tried, as it stands, on a fresh campaign of the same truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign

if TYPE_CHECKING:
    from calib.gap.data.observations import Observations
    from calib.gap.diagnosis import Diagnosis
    from calib.gap.effects.effect import Form


def achieved(diagnosis: Diagnosis, fresh: Campaign, exclude: tuple[str, ...] = ()) -> dict[str, Any] | None:
    """Return the gap of a fresh campaign of the same truth under the model alone and under the fitted fix.

    Nothing is refitted. ``before_rms_m``, ``after_rms_m`` of the end position (else of the distance);
    ``before_over_floor``, ``after_over_floor``, all channels against their noise; the closure ``fraction`` of whitened
    squares. None where the verdict names no cause, or a form of its causes cannot be had there.
    """
    from calib.gap.data.from_campaign import observations_of
    from calib.gap.evidence.fit import hypothesis_path
    from calib.gap.evidence.marginal import rows
    from calib.gap.predict.path import predict
    from calib.gap.predict.residuals import residuals

    if not diagnosis.verdict.causes:
        return None
    there = observations_of(fresh)
    forms = _forms_there(diagnosis, there, fresh, exclude)
    if forms is None or len(there) != len(diagnosis.observations):
        return None
    nominal = predict(there)
    fixed = hypothesis_path(there, diagnosis.fitted.calibration, forms, diagnosis.fitted.theta, nominal)
    before, after = residuals(nominal, nominal), residuals(fixed, nominal)
    white = rows(nominal, diagnosis.noise, np.stack([before, after], axis=2))
    squares, floor = np.sum(white**2, axis=0), float(len(white))
    gap = float(squares[0]) - floor
    fraction = None if gap < 0.5 * floor else float(np.clip(1 - max(float(squares[1]) - floor, 0.0) / gap, -1.0, 1.0))
    norms = np.sqrt(squares / max(floor, 1.0))
    return {
        "before_rms_m": _rms(there, before),
        "after_rms_m": _rms(there, after),
        "before_over_floor": float(norms[0]),
        "after_over_floor": float(norms[1]),
        "fraction": fraction,
    }


def _forms_there(
    diagnosis: Diagnosis, there: Observations, fresh: Campaign, exclude: tuple[str, ...]
) -> tuple[Form, ...] | None:
    """Return the verdict's forms on another campaign, found again by effect, label and settings."""
    from calib.gap.effects.applied import matching_form
    from calib.gap.effects.library import library

    effects = {e.id: e for e in library(there, exclude=exclude, declared=fresh.extra.get("effects", ()))}
    matches = []
    for wanted in diagnosis.fitted.forms:
        effect = effects.get(wanted.effect)
        offered = [] if effect is None else effect.forms(there)
        alike = [form for form in offered if len(form.parameters) == len(wanted.parameters)]
        nearest = matching_form(alike, wanted.label, wanted.settings)
        if nearest is None:
            return None
        # the fitted fix as it stands: nought where it was nought on the runs it was fitted to
        matches.append(nearest.centred_at(wanted.centre))
    return tuple(matches)


def _rms(there: Observations, values: FloatArray) -> float | None:
    pose = there.usable[:, 1] & there.usable[:, 2]
    if pose.any():
        return float(np.sqrt(np.mean(values[pose, 1] ** 2 + values[pose, 2] ** 2)))
    if there.usable[:, 0].any():
        return float(np.sqrt(np.mean(values[there.usable[:, 0], 0] ** 2)))
    return None
