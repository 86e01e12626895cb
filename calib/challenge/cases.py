"""A case from its recipe: its truth, then its campaigns.

No rule gets a larger share right than the mean of the largest posterior probability: the ceiling.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.plant import Cause, Noise, random_noise
from calib.plant.design import Design, good_design, poor_design
from calib.plant.effects import find
from calib.plant.make import as_causes, make_campaigns, random_model
from calib.plant.signal import Alternatives, alternatives, is_calibration, rivals, signatures, to_signal
from calib.types import FloatArray, grouped

UNSIGNED: Final = ("encoder_gross", "integration_scheme")
#: only positive sizes have a meaning
ONE_SIGN: Final = (
    "lost_counts", "beam_misalignment", "floor_undulation", "path_weave", "load_creep", "wear", "reference_latency",
    "steering_backlash", "steering_delay", "drive_slip", "braking_skid", "curve_scrub", "side_slip",
    "wheel_eccentricity", "outside:hidden",
)  # fmt: skip
_TRIES: Final = 6


@dataclass(frozen=True, slots=True)
class Recipe:
    """One case to make."""

    case: str
    number: int  #: in the unshuffled list; with the seed it determines all that is drawn
    group: str
    effects: tuple[str, ...] = ()  #: ``effect`` or ``effect/form``; empty is none
    targets: tuple[float, ...] = ()  #: wanted signal of each; NaN is the typical size
    design: str = "good"  #: ``good``, ``laser_only``, or a poor design of the plant
    aliases: tuple[str, ...] = ()  #: exact aliases on these runs
    deleted: str = ""


#: allowed by the gate
ALARMS: Final = 0.05


class Ceiling(NamedTuple):
    """What the best rule reaches on one campaign at one signal."""

    free: float  #: share of true effects named, where there surely is one
    gated: float  #: the same behind a gate that lets `ALARMS` of the empty campaigns through


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true in a case; one entry of the sealed file."""

    recipe: Recipe
    seed: int
    max_runs: int
    redraw: int  #: times the pair was drawn again as its effects hid in one another
    causes: tuple[Cause, ...]
    typical: tuple[float, ...]
    #: signal of each alone, and beside what the other could imitate
    signals: tuple[float | None, ...]
    beside: tuple[float | None, ...]
    #: other effects, nearest first, and their distance from the cause in standard deviations
    rivals: tuple[tuple[str, float], ...]
    noise: Noise
    model: OdometryModel
    n_runs: int
    #: see `Ceiling`: of all effects at this signal; of this one here, None where a recalibration absorbs it
    ceiling: Ceiling | None = None
    own_ceiling: Ceiling | None = None

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Truth":
        """Return what `calib.documents.plain` made of it, null for NaN and infinity."""
        from pydantic import TypeAdapter

        recipe, noise = dict(data["recipe"]), dict(data["noise"])
        recipe["targets"] = [np.nan if target is None else target for target in recipe["targets"]]
        noise["tail"] = np.inf if noise["tail"] is None else noise["tail"]
        return TypeAdapter(Truth).validate_python({**data, "recipe": recipe, "noise": noise})


def case_design(recipe: Recipe, seed: int, max_runs: int, redraw: int) -> Design:
    """Return the runs of a case."""
    rng = np.random.default_rng([seed, recipe.number, 0, redraw])
    needs = {need for name in recipe.effects for need in find(*name.split("/")).needs}
    n_runs = int(rng.choice([30, 40, 50, 60, 60, 80, 100]))
    if rng.random() < 0.05:
        n_runs = int(rng.choice([20, 120, 160]))
    n_runs = min(n_runs, max_runs)
    if recipe.group == "empty":
        needs |= {str(need) for need in rng.choice(["front", "slope", "lanes", "flying", "stops"], 2, replace=False)}
    if recipe.design == "good":
        weighed = "slope" not in needs and bool(rng.random() < 0.15)
        poses = {"poses": "turning"} if "poses" not in needs and rng.random() < 0.2 and "no_logs" not in needs else {}
        return good_design(rng, n_runs=max(n_runs, 30), needs=needs, weighed=weighed, **poses)
    if recipe.design == "laser_only":
        return replace(poor_design("corridor_only", rng, n_runs=n_runs), poses="none")
    design = poor_design(recipe.design, rng, n_runs=n_runs)
    return replace(design, poses="all") if recipe.group == "alias" else design


def truth_of(recipe: Recipe, seed: int, max_runs: int) -> Truth:
    """Draw the truth of a case."""
    for redraw in range(_TRIES):
        truth = _draw(recipe, seed, max_runs, redraw)
        pairs = zip(truth.beside, truth.signals, strict=True)
        if not any(beside is not None and signal is not None and beside < 0.6 * signal for beside, signal in pairs):
            break
    return truth


def _draw(recipe: Recipe, seed: int, max_runs: int, redraw: int) -> Truth:
    design = case_design(recipe, seed, max_runs, redraw)
    rng = np.random.default_rng([seed, recipe.number, 1, redraw])
    heavy = {"tail": float(rng.choice([3.5, 4.0, np.inf]))} if recipe.group == "empty" else {}
    noise = random_noise(rng, **heavy)
    model = random_model(design, rng)
    causes = []
    for cause in as_causes(dict.fromkeys(recipe.effects, np.nan), design, rng):
        sign = 1.0 if cause.effect in (*UNSIGNED, *ONE_SIGN) else float(rng.choice([-1.0, 1.0]))
        causes.append(replace(cause, size=sign * cause.size))
    signals: tuple[float | None, ...] = (None,) * len(causes)
    beside, near, best, own = signals, tuple[tuple[str, float], ...](), None, None
    if causes and not any(cause.effect in UNSIGNED for cause in causes):
        causes, noise, reached = to_signal(design, model, noise, causes, recipe.targets)
        signals, beside = (tuple(round(v, 3) for v in part) for part in (reached.alone, reached.beside))
        if len(causes) == 1 and not causes[0].effect.startswith("outside:") and recipe.group != "natural":
            among = alternatives(design, model, noise, causes[0])
            near = tuple(rivals(among)[:8])
            if recipe.group == "single":
                best, own = _ceilings(among, recipe, seed)
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


def _ceilings(among: Alternatives, recipe: Recipe, seed: int) -> list[Ceiling | None]:
    known, signal, cause = signatures(among), recipe.targets[0], among.cause
    drawn, drawn_of_own = (np.random.default_rng([seed, recipe.number, stream]) for stream in (3, 4))
    best, own = ceiling_of(known, signal, drawn), None
    if not is_calibration(cause):
        own = ceiling_of(known, signal, drawn_of_own, (cause.effect, among.left(0)))
    return [one and Ceiling(round(one.free, 3), round(one.gated, 3)) for one in (best, own)]


def campaigns_of(truth: Truth) -> tuple[Campaign, ...]:
    """Return the campaign of a case, and the same truth driven again with other noise."""
    recipe = truth.recipe
    design = case_design(recipe, truth.seed, truth.max_runs, truth.redraw)
    rng = np.random.default_rng([truth.seed, recipe.number, 2, truth.redraw])
    names = (recipe.case, recipe.case)  # must not tell them apart
    return make_campaigns(design, truth.causes, rng, noise=truth.noise, model=truth.model, names=names)


#: draws of effect and noise; the standard error of a share is then at most 0.018
DRAWS: Final = 800
#: directions weaker than this, relative to the strongest, are rounding
RANK: Final = 1e-9
#: evidences nearer than this are the same but for rounding
ALIKE_NATS: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class _Space:
    effect: int
    basis: FloatArray  # what a form of it can do, orthonormal (n_rows, n_directions)
    one_sign: bool


def ceiling_of(
    signatures: Mapping[str, Sequence[FloatArray]],
    signal: float,
    rng: np.random.Generator,
    true: tuple[str, FloatArray] | None = None,
) -> Ceiling | None:
    """Return the ceiling of a campaign of equally likely effects, or of one of them; None where nothing is left.

    `signatures`: of `calib.plant.signal`; `signal`: norm of the true effect; `true`: the effect, and what it leaves
    here (n_rows,): how often the rule names it; exact aliases share.
    """
    if true is not None and true[0] not in signatures:
        signatures = {**signatures, true[0]: [true[1][:, None]]}
    spaces = _spaces(signatures)
    if not spaces:
        return None
    every = [space.basis for space in spaces] + ([] if true is None else [true[1][:, None]])
    frame, _ = np.linalg.qr(np.concatenate(every, axis=1))
    present = sorted({space.effect for space in spaces})
    spaces = [_Space(present.index(s.effect), frame.T @ s.basis, s.one_sign) for s in spaces]
    noise = rng.standard_normal((2, DRAWS, frame.shape[1]))
    if true is None:
        drawn = rng.integers(len(present), size=DRAWS)
        shown = np.stack([_direction(spaces, int(effect), rng) for effect in drawn])
    else:
        shown = (true[1] @ frame) / np.linalg.norm(true[1])
    seen = (noise[0] + signal * shown, noise[1])
    evidence, of_noise = (_log_evidence(spaces, len(present), readings, signal) for readings in seen)
    passed = _log_mean(evidence) > np.quantile(_log_mean(of_noise), 1 - ALARMS)
    if true is None:
        hit = np.exp(evidence.max(axis=1) - _log_mean(evidence)) / len(present)
    else:
        tied = evidence > evidence.max(axis=1, keepdims=True) - ALIKE_NATS
        hit = tied[:, present.index(list(signatures).index(true[0]))] / tied.sum(axis=1)
    return Ceiling(float(hit.mean()), float((hit * passed).mean()))


def _spaces(signatures: Mapping[str, Sequence[FloatArray]]) -> list[_Space]:
    spaces = []
    for number, (effect, forms) in enumerate(signatures.items()):
        for columns in forms:
            norms = np.linalg.norm(columns, axis=0)
            kept = columns[:, norms > 0] / norms[norms > 0]
            left, size, _ = np.linalg.svd(kept, full_matrices=False)
            rank = int((size > max(RANK * size.max(initial=0.0), 1e-6)).sum())
            if rank == 1:
                spaces.append(_Space(number, kept[:, :1], effect in ONE_SIGN))
            elif rank > 1:
                spaces.append(_Space(number, left[:, :rank], False))
    return spaces


def _direction(spaces: Sequence[_Space], effect: int, rng: np.random.Generator) -> FloatArray:
    own = [space for space in spaces if space.effect == effect]
    space = own[int(rng.integers(len(own)))]
    drawn = rng.standard_normal(space.basis.shape[1])
    if space.one_sign:
        drawn = np.abs(drawn)
    direction: FloatArray = space.basis @ (drawn / np.linalg.norm(drawn))
    return direction / np.linalg.norm(direction)


def _log_evidence(spaces: Sequence[_Space], n_effects: int, readings: FloatArray, signal: float) -> FloatArray:
    by_effect = grouped((space.effect, _log_likelihood(space, readings, signal)) for space in spaces)
    return np.stack([_log_mean(np.stack(by_effect[effect], axis=1)) for effect in range(n_effects)], axis=1)


def _log_likelihood(space: _Space, readings: FloatArray, signal: float) -> FloatArray:
    # Gamma(k/2) (2/z)^(k/2-1) I_(k/2-1)(z) in k dimensions
    from scipy.special import gammaln, ive

    inside = readings @ space.basis
    n_directions = space.basis.shape[1]
    if n_directions == 1:
        along = signal * inside[:, 0]
        both = np.logaddexp(along, -along) - np.log(2.0)
        return (along if space.one_sign else both) - 0.5 * signal**2
    z = np.maximum(signal * np.linalg.norm(inside, axis=1), 1e-12)
    order = 0.5 * n_directions - 1.0
    mean = gammaln(0.5 * n_directions) + order * np.log(2.0 / z) + np.log(ive(order, z)) + z
    return np.asarray(mean - 0.5 * signal**2)


def _log_mean(logs: FloatArray) -> FloatArray:
    return np.asarray(np.logaddexp.reduce(logs, axis=1) - np.log(logs.shape[1]))
