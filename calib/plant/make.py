"""A design and a truth make a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.plant.design import Design
from calib.plant.drive import drive
from calib.plant.effects import find
from calib.plant.effects.form import Cause
from calib.plant.measure import campaign_of
from calib.plant.noise import Noise, draw_noise, random_noise
from calib.plant.world import REFERENCE_LOAD_N, World, build_world
from calib.types import FloatArray


def random_model(design: Design, rng: np.random.Generator) -> OdometryModel:
    """Return what the simulator believes: a calibrated vehicle, with the load law that the design shares."""
    vehicle = design.vehicle
    radius = vehicle.wheel_radius_m * (1 + 2e-3 * rng.uniform(-1, 1, 2) - 5e-3)
    slopes = design.slope_per_N * radius * np.array([1.0, rng.uniform(0.85, 1.15)])
    return OdometryModel(
        radius_left_m=round(float(radius[0]), 6),
        radius_right_m=round(float(radius[1]), 6),
        track_m=round(vehicle.track_m * (1 + 5e-3 * float(rng.uniform(-1, 1))), 5),
        reference_load_N=REFERENCE_LOAD_N,
        slope_left_m_per_N=float(f"{slopes[0]:.6g}"),
        slope_right_m_per_N=float(f"{slopes[1]:.6g}"),
    )


def as_causes(truth: Mapping[str, float] | Sequence[Cause], design: Design, rng: np.random.Generator) -> list[Cause]:
    """Return causes with all their knobs drawn.

    A truth may be effect (or ``effect/form``) -> size; a size that is not a number takes the typical one.
    """
    if not isinstance(truth, Mapping):
        return list(truth)
    causes = []
    for key, size in truth.items():
        effect, _, form = key.partition("/")
        known = find(effect, form)
        causes.append(
            Cause(effect, float(known.typical if np.isnan(size) else size), known.form, known.knobs(rng, design))
        )
    return causes


def apply_causes(world: World, causes: Sequence[Cause], blocks: FloatArray | None = None) -> World:
    """Let causes change a world in place, and return it.

    `blocks` (n_causes, n_runs) is the share of each cause's size that acts on each run; all of it by default.
    """
    n_runs = len(world.design)
    for number, cause in enumerate(causes):
        share = np.ones(n_runs) if blocks is None else blocks[number]
        find(cause.effect, cause.form).act(world, cause.size * share, cause.knobs)
    return world


def make_campaign(
    design: Design,
    truth: Mapping[str, float] | Sequence[Cause],
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    model: OdometryModel | None = None,
    name: str = "campaign",
) -> Campaign:
    """Drive a design in a world with a known truth.

    It is in memory; ``calib.campaign.write.write_campaign`` puts it into a folder.

    Parameters
    ----------
    design
        The runs.
    truth
        ``{effect: size}`` or ``{"effect/form": size}``; NaN is the typical size; empty is no gap.
    rng
        All chance.
    noise
        Drawn at random where missing.
    model
        What the simulator believes; drawn at random where missing.
    name
        Name of the campaign.
    """
    return make_campaigns(design, truth, rng, noise=noise, model=model, names=(name,))[0]


def make_campaigns(
    design: Design,
    truth: Mapping[str, float] | Sequence[Cause],
    rng: np.random.Generator,
    *,
    noise: Noise | None = None,
    model: OdometryModel | None = None,
    names: Sequence[str] = ("campaign",),
) -> tuple[Campaign, ...]:
    """Drive a design as often as there are names, each time with other noise; see `make_campaign`."""
    noise = noise or random_noise(rng)
    model = model or random_model(design, rng)
    causes = as_causes(truth, design, rng)
    n_runs, times = len(design), len(names)
    stacked = design if times == 1 else design.select(np.tile(np.arange(n_runs), times))
    world = apply_causes(build_world(stacked, model), causes)
    draw = draw_noise(noise, n_runs * times, rng)
    record = drive(world, draw)
    return tuple(
        campaign_of(world, noise, draw, record, name=name, pick=np.arange(n_runs) + number * n_runs)
        for number, name in enumerate(names)
    )
