"""A fit held against its nominal vehicle and physical bounds: what is beyond them fails, whatever statistics say."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.plausible import factor_reason, implausible, off
from calib.errors import ImplausibleError
from calib.radius.checks import FAILED, PLAUSIBLE, Check

if TYPE_CHECKING:
    from calib.radius.fitted import Fit
    from calib.radius.regression import WheelFit

#: share of the radius by which load may change it over the measured range, and by which single runs may scatter
MOST_CHANGE: Final = 0.2
MOST_SCATTER: Final = 0.03


def held_against_bounds(fit: Fit, campaign: Campaign) -> Fit:
    """Return `fit` with a failed check ``plausible`` for everything that cannot be.

    `campaign`: its vehicle is what radii are held against; not where its wheel radius was assumed.
    """
    shared = [f"{note.where}: {note.text}" for note in implausible(campaign)]
    nominal = None if "vehicle.wheel_radius_m" in campaign.assumed else campaign.vehicle.wheel_radius_m
    wheels = {}
    for name, wheel in fit.wheels.items():
        other = "right" if name == "left" else "left"
        own = [text for text in shared if f"the {other} wheel" not in text]
        radius_named = any(f"the {name} wheel's radius" in text for text in own)
        sentences = dict.fromkeys([*own, *_of_wheel(wheel, nominal, radius_named=radius_named)])
        checks = tuple(Check(PLAUSIBLE, FAILED, _sentence(text)) for text in sentences)
        wheels[name] = replace(wheel, checks=(*checks, *wheel.checks))
    return replace(fit, left=wheels["left"], right=wheels["right"])


def refuse_implausible(campaign: Campaign) -> None:
    """Refuse a campaign that allows no law and that cannot be, for the latter reason.

    Raises ImplausibleError where something is beyond its bounds.
    """
    findings = [f"{note.where}: {note.text}" for note in implausible(campaign)]
    if findings:
        raise ImplausibleError(campaign.name, findings)


def _of_wheel(wheel: WheelFit, nominal_m: float | None, *, radius_named: bool) -> Iterator[str]:
    radius = wheel.law.radius_ref_m
    if not (np.isfinite(radius) and radius > 0):
        yield f"the radius at the reference load comes out as {radius:.4g} m; expected one above zero; check the loads"
        return
    if nominal_m is not None and off(radius / nominal_m) and not radius_named:
        yield (
            f"the radius comes out {radius / nominal_m:.2f} times nominal ({1e3 * radius:.4g} mm for "
            f"{1e3 * nominal_m:.4g} mm): {factor_reason(radius / nominal_m)}"
        )
    change = wheel.law.slope_m_per_N * (wheel.law.load_max_N - wheel.law.load_min_N) / radius
    if wheel.model == "line" and abs(change) > MOST_CHANGE:
        yield (
            f"load changes the radius by {100 * change:.3g} % over the loads driven; expected less than "
            f"{100 * MOST_CHANGE:.0f} %; check loads and distances"
        )
    if wheel.run_std_m > MOST_SCATTER * radius:
        yield (
            f"single runs scatter by {100 * wheel.run_std_m / radius:.2g} % of the radius; expected less than "
            f"{100 * MOST_SCATTER:.0f} %; check that distances, counts and loads are those of the same runs"
        )


def _sentence(text: str) -> str:
    return text if text.endswith((".", "?")) else f"{text}."
