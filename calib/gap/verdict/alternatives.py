"""What these runs cannot tell apart: effects whose signatures at the fitted size lie nearer than the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.gap.effects.effect import Form
from calib.gap.evidence.marginal import Nuisance, project
from calib.gap.evidence.whitened import WhitenedSystem

#: signatures nearer than this (in standard deviations) count as alike
NEAR: Final = 3.0
#: an alternative may not need a size beyond this many times its largest plausible one
STRETCH: Final = 2.0


def distance(system: WhitenedSystem, nuisance: Nuisance, contribution: FloatArray, form: Form) -> float:
    """Return how far a contribution (n_rows,) lies from what a form could do, in standard deviations.

    The form's parameters are free within what is physically plausible, their allowed signs included.
    """
    target = project(nuisance, contribution[:, None])[:, 0]
    columns = project(nuisance, system.columns(form))
    bound = np.array([p.largest / p.typical for p in form.parameters]) * STRETCH
    gram = columns.T @ columns
    sizes = np.linalg.solve(gram + np.diag(1e-9 + 1.0 / (10 * bound) ** 2), columns.T @ target)
    sign = np.array([p.sign for p in form.parameters])
    # what can only be of one sign (counts are lost, not won) stands in for nothing of the other
    sizes = np.clip(sizes, np.where(sign > 0, 0.0, -bound), np.where(sign < 0, 0.0, bound))
    left = target - columns @ sizes
    return float(np.sqrt(left @ left))


def aliases_of(
    system: WhitenedSystem,
    nuisance: Nuisance,
    contribution: FloatArray,
    forms: dict[str, list[Form]],
    held: Sequence[str],
) -> dict[str, float]:
    """Return the effects that could stand in for a contribution, with their distance in standard deviations.

    Parameters
    ----------
    system : WhitenedSystem
        The whitened system.
    nuisance : Nuisance
        What is free beside the effect.
    contribution : array of float, shape (n_rows,)
        What the fitted effect does, whitened.
    forms : mapping of str to list of Form
        The library on this campaign.
    held : sequence of str
        Effects of the hypothesis itself, not to be offered.
    """
    aliases: dict[str, float] = {}
    for name, offered in forms.items():
        if name in held:
            continue
        near = min((distance(system, nuisance, contribution, form) for form in offered), default=np.inf)
        if near < NEAR:
            aliases[name] = near
    return aliases
