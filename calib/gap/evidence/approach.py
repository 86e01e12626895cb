"""Coming near enough: where more is left than the search can weigh, the linear picture about the calibration misleads.

With a heading off by half a radian the ends of runs no longer follow the sizes of effects in proportion, and whichever
effect bends like the difference looks likeliest. Fitted by its own re-simulated path, the cause of it stands out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.gap.effects.effect import Form
from calib.gap.evidence.fit import Fitted, fit
from calib.gap.evidence.noise import Noise
from calib.gap.predict.path import Path

#: what is left on average, in floors, beyond which the search is not begun there: of the rests that it weighs, the
#: largest but one, so that there is room for what the linear picture leaves
_FAR: Final = 30.0
#: Gauss-Newton steps of each trial; an effect that explains the gap is near its size by then
_STEPS: Final = 4
#: an effect that leaves more than this share of the squares is not what makes them so many
_LEFT_AT_MOST: Final = 0.5


def is_far(fitted: Fitted) -> bool:
    """Return whether too much is left for the linear picture about this path."""
    n_rows = int(fitted.path.s.usable.sum())
    return fitted.chi_square > n_rows * _FAR**2


def approached(nominal: Path, noise: Noise, base: Fitted, forms: Sequence[Form], most_effects: int) -> Fitted:
    """Return a hypothesis near which the gap is linear: from the calibration, effects added one by one as they fit.

    Parameters
    ----------
    nominal : Path
        The model alone.
    noise : Noise
        Covariance of each unit.
    base : Fitted
        The recalibration alone.
    forms : sequence of Form
        On offer.
    most_effects : int
        Effects added, at most.

    Returns
    -------
    Fitted
        Where it is not far off already, or no effect takes half of it away, what was given.
    """
    fitted = base
    while is_far(fitted) and len(fitted.forms) < most_effects:
        held = {form.effect for form in fitted.forms}
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            trials = [
                fit(nominal, noise, (*fitted.forms, form), start=fitted, steps=_STEPS)
                for form in forms
                if form.effect not in held
            ]
        trials = [trial for trial in trials if trial.chi_square <= _LEFT_AT_MOST * fitted.chi_square]
        if not trials:
            break
        fitted = min(trials, key=lambda trial: trial.chi_square)
    return fitted
