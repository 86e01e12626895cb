"""A case from its recipe: first its truth, then its campaigns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.challenge.ceiling import Ceiling, ceiling_of, ceiling_of_truth
from calib.challenge.recipe import Recipe
from calib.plant.design import Design
from calib.plant.effects import find
from calib.plant.effects.form import Cause
from calib.plant.make import as_causes, make_campaigns, random_model
from calib.plant.noise import Noise, random_noise
from calib.plant.plans import good_design, poor_design
from calib.plant.rivals import rivals, signatures, whitened
from calib.plant.signal import is_calibration, to_signal

_UNSIGNED: Final = ("encoder_gross", "integration_scheme")
#: effects of which only positive sizes have a meaning
ONE_SIGN: Final = (
    "lost_counts",
    "beam_misalignment",
    "floor_undulation",
    "path_weave",
    "load_creep",
    "wear",
    "reference_latency",
    "steering_backlash",
    "steering_delay",
    "drive_slip",
    "braking_skid",
    "curve_scrub",
    "side_slip",
    "wheel_eccentricity",
    "outside:hidden",
)
_TRIES: Final = 6


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true in a case; one entry of the sealed file."""

    recipe: Recipe  #: what was asked for
    #: seed, max_runs: from the seeds file
    seed: int
    max_runs: int
    redraw: int  #: how often the pair was drawn again because its two effects hid in one another
    causes: tuple[Cause, ...]  #: what is wrong, at its size
    typical: tuple[float, ...]  #: typical size of each
    #: signals, beside: signal of each alone, and after what the other could imitate was projected out
    signals: tuple[float | None, ...]
    beside: tuple[float | None, ...]
    #: other effects, and how far in standard deviations they stay from what the cause does; nearest first
    rivals: tuple[tuple[str, float], ...]
    #: noise, model: of the case
    noise: Noise
    model: OdometryModel
    n_runs: int  #: runs
    #: what the best rule reaches on these runs at this signal, freely and behind the gate; None where there is none
    ceiling: tuple[float, float] | None = None
    #: the same for this effect as it acts here; None where a recalibration absorbs it
    own_ceiling: tuple[float, float] | None = None

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Truth:
        """Return what `calib.documents.plain` made of it; there an infinite tail and a target that is NaN are null."""
        from pydantic import TypeAdapter

        recipe, noise = dict(data["recipe"]), dict(data["noise"])
        recipe["targets"] = [np.nan if target is None else target for target in recipe["targets"]]
        noise["tail"] = np.inf if noise["tail"] is None else noise["tail"]
        return TypeAdapter(Truth).validate_python({**data, "recipe": recipe, "noise": noise})


def case_design(recipe: Recipe, seed: int, max_runs: int, redraw: int = 0) -> Design:
    """Return the runs of a case; the same for the same arguments."""
    rng = np.random.default_rng([seed, recipe.number, 0, redraw])
    needs: set[str] = set()
    for name in recipe.effects:
        effect, _, form = name.partition("/")
        needs |= find(effect, form).needs
    n_runs = int(rng.choice([30, 40, 50, 60, 60, 80, 100]))
    if rng.random() < 0.05:
        n_runs = int(rng.choice([20, 120, 160]))
    n_runs = min(n_runs, max_runs)
    if recipe.group == "empty":
        # what an empty campaign has besides its runs varies as in the others
        needs |= {str(need) for need in rng.choice(["front", "slope", "lanes", "flying", "stops"], 2, replace=False)}
    if recipe.design == "good":
        weighed = "slope" not in needs and bool(rng.random() < 0.15)
        poses = {"poses": "turning"} if "poses" not in needs and rng.random() < 0.2 and "no_logs" not in needs else {}
        return good_design(rng, n_runs=max(n_runs, 30), needs=needs, weighed=weighed, **poses)
    if recipe.design == "laser_only":
        return replace(poor_design("corridor_only", rng, n_runs=n_runs), poses="none")
    design = poor_design(recipe.design, rng, n_runs=n_runs)
    # an alias by design has to be seen: with end poses
    return replace(design, poses="all") if recipe.group == "alias" else design


def truth_of(recipe: Recipe, seed: int, max_runs: int) -> Truth:
    """Draw the truth of a case: noise, model, causes, and their sizes for the wanted signals."""
    for redraw in range(_TRIES):
        truth = _draw(recipe, seed, max_runs, redraw)
        hidden = [
            beside is not None and signal is not None and beside < 0.6 * signal
            for beside, signal in zip(truth.beside, truth.signals, strict=True)
        ]
        if not any(hidden):
            break
    return truth


def _draw(recipe: Recipe, seed: int, max_runs: int, redraw: int) -> Truth:
    design = case_design(recipe, seed, max_runs, redraw)
    rng = np.random.default_rng([seed, recipe.number, 1, redraw])
    heavy = {"tail": float(rng.choice([3.5, 4.0, np.inf]))} if recipe.group == "empty" else {}
    noise = random_noise(rng, **heavy)
    model = random_model(design, rng)
    causes = []
    for cause in as_causes({name: float("nan") for name in recipe.effects}, design, rng):
        sign = 1.0 if cause.effect in (*_UNSIGNED, *ONE_SIGN) else float(rng.choice([-1.0, 1.0]))
        causes.append(replace(cause, size=sign * cause.size))
    signals: tuple[float | None, ...] = (None,) * len(causes)
    beside, near, best, own = signals, tuple[tuple[str, float], ...](), None, None
    if causes and not any(cause.effect in _UNSIGNED for cause in causes):
        causes, noise, shown = to_signal(design, model, noise, causes, recipe.targets)
        signals, beside = tuple(round(v, 3) for v in shown.alone), tuple(round(v, 3) for v in shown.beside)
        if len(causes) == 1 and not causes[0].effect.startswith("outside:") and recipe.group != "natural":
            near = tuple(rivals(design, model, noise, causes[0])[:8])
        if recipe.group == "single":
            best, own = _ceilings(design, model, noise, causes[0], recipe, seed)
    return Truth(
        recipe=recipe,
        seed=seed,
        max_runs=max_runs,
        redraw=redraw,
        causes=tuple(causes),
        typical=tuple(find(cause.effect, cause.form).typical for cause in causes),
        signals=signals,
        beside=beside,
        rivals=near,
        noise=noise,
        model=model,
        n_runs=len(design),
        ceiling=best,
        own_ceiling=own,
    )


def _ceilings(
    design: Design, model: OdometryModel, noise: Noise, cause: Cause, recipe: Recipe, seed: int
) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
    """Return what the best rule reaches on the runs of a case, for any effect and for the true one."""

    def rounded(ceiling: Ceiling | None) -> tuple[float, float] | None:
        return None if ceiling is None else (round(ceiling.free, 3), round(ceiling.gated, 3))

    known, signal = signatures(design, model, noise), recipe.targets[0]
    drawn = np.random.default_rng([seed, recipe.number, 3])
    best = rounded(ceiling_of(known, signal, drawn, one_sign=ONE_SIGN))
    if is_calibration(cause):
        return best, None
    drawn, left = np.random.default_rng([seed, recipe.number, 4]), whitened(design, model, noise, [cause])[0]
    return best, rounded(ceiling_of_truth(known, cause.effect, left, signal, drawn, one_sign=ONE_SIGN))


def campaigns_of(truth: Truth) -> tuple[Campaign, Campaign]:
    """Return the campaign of a case, and a fresh one: the same truth driven again with other noise."""
    recipe = truth.recipe
    design = case_design(recipe, truth.seed, truth.max_runs, truth.redraw)
    rng = np.random.default_rng([truth.seed, recipe.number, 2, truth.redraw])
    # both are called what the case is called: a name must not tell them apart
    names = (recipe.case, recipe.case)
    campaign, fresh = make_campaigns(design, truth.causes, rng, noise=truth.noise, model=truth.model, names=names)
    return campaign, fresh
