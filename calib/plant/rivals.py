"""What else could have left what a cause left: every other effect's nearness to it on the same runs."""

from __future__ import annotations

import numpy as np

from calib.campaign.settings import OdometryModel
from calib.plant.design import Design, lacks
from calib.plant.effects import ALL
from calib.plant.effects.form import Cause
from calib.plant.noise import Noise
from calib.plant.signal import is_calibration, strength, strengths, whiten
from calib.types import FloatArray

_EXPONENTS = {"hertz": 2 / 3, "root": 0.5, "quadratic": 2.0, "power": 0.87, "running_in": 0.8}
_SKIPPED = ("encoder_gross", "integration_scheme", "path_weave", "floor_zone")


def _variants(design: Design, slope_per_N: float) -> list[Cause]:
    """Return causes at small sizes whose sums span what each effect can do on a design."""
    n_sessions = len(set(design.session))
    variants: list[Cause] = []
    for form in ALL:
        if form.effect in _SKIPPED or form.effect.startswith("outside:"):
            continue
        if lacks(design, form.needs - {"slope", "offsets"}) or ("slope" in form.needs and slope_per_N == 0.0):
            continue
        size = 0.2 * form.typical
        knobs: list[dict[str, float]] = [{}]
        if form.effect.startswith(("load_radius", "wear")):
            exponent = _EXPONENTS.get(form.form, 1.0)
            knobs = [{"right_ratio": ratio, "exponent": exponent} for ratio in (0.0, 1.0)]
        elif form.effect == "load_creep":
            knobs = [{"tau_min": 15.0}]
        elif form.effect == "session_step":
            knobs = [{f"step_{knob}": 1.0} for knob in range(1, n_sessions)] if form.form == "plain" else []
        elif form.effect == "wheel_eccentricity":
            knobs = [{"left_rad": a, "right_rad": b} for a, b in ((0.0, 0.0), (1.57, 0.0), (0.0, 1.57))]
        elif form.effect in {"rear_drag", "lost_counts"}:
            knobs = [{"right": 0.0}, {"right": 1.0}]
        elif form.effect == "reference_lever_arm":
            knobs = [{"towards_rad": 0.0}, {"towards_rad": np.pi / 2}]
        elif form.effect == "floor_slope":
            knobs = [{"downhill_rad": 0.0}, {"downhill_rad": np.pi / 2}]
        elif form.effect.startswith("covariate:"):
            knobs = [form.knobs(np.random.default_rng(0), design)]
        variants.extend(Cause(form.effect, size, form.form, knob) for knob in knobs)
    return variants


def rivals(design: Design, model: OdometryModel, noise: Noise, cause: Cause) -> list[tuple[str, float]]:
    """Return the other effects that the design can show, nearest first, each with its distance from the cause.

    The distance, by the best of its forms, is the norm of what it cannot imitate in standard deviations of the noise, a
    recalibration being free.
    """
    others = [other for other in _variants(design, model.slope_left_m_per_N) if other.effect != cause.effect]
    strong = strengths(design, model, noise, [cause, *others], step_s=0.08, weigh=False)
    truth = strong.change[0]
    families = _families(others, first=1)
    nearest: dict[str, float] = {}
    base = None if is_calibration(cause) else strong.absorbed
    for (effect, _), numbers in families.items():
        columns = np.stack([np.nan_to_num(strong.change[number]) for number in numbers], axis=-1)
        free = columns if base is None else np.concatenate((base, columns), axis=-1)
        distance = strength(truth, strong.cov, free)
        nearest[effect] = min(nearest.get(effect, np.inf), distance)
    return [(effect, round(nearest[effect], 3)) for effect in sorted(nearest, key=nearest.__getitem__)]


def _families(causes: list[Cause], first: int) -> dict[tuple[str, str], list[int]]:
    """Return the numbers of the causes, from `first`, that add up to one form of one effect."""
    families: dict[tuple[str, str], list[int]] = {}
    for number, cause in enumerate(causes, start=first):
        # one wheel or the other, never both: alternatives, while the other variants of an effect add up
        which = str(cause.knobs["right"]) if "right" in cause.knobs else ""
        families.setdefault((cause.effect, cause.form + which), []).append(number)
    return families


def signatures(design: Design, model: OdometryModel, noise: Noise) -> dict[str, list[FloatArray]]:
    """Return what each effect, without calibration, can do on a design: whitened, a recalibration projected out.

    Effect -> its forms, each (n_rows, n_directions).
    """
    causes = [cause for cause in _variants(design, model.slope_left_m_per_N) if not is_calibration(cause)]
    columns = whitened(design, model, noise, causes)
    columns_by_effect: dict[str, list[FloatArray]] = {}
    for (effect, _), numbers in _families(causes, first=0).items():
        columns_by_effect.setdefault(effect, []).append(np.stack([columns[number] for number in numbers], axis=1))
    return columns_by_effect


def whitened(design: Design, model: OdometryModel, noise: Noise, causes: list[Cause]) -> list[FloatArray]:
    """Return what each cause leaves on a design, whitened, a recalibration projected out, each shape (n_rows,)."""
    strong = strengths(design, model, noise, causes, step_s=0.08, weigh=False)
    columns = []
    for change in strong.change:
        white, absorbed = whiten(change, strong.cov, strong.absorbed)
        if absorbed is not None:
            white = white - absorbed @ np.linalg.lstsq(absorbed, white, rcond=1e-10)[0]
        columns.append(white)
    return columns
