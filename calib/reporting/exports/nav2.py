"""Parameters of a navigation stack from the corrected odometry's noise: AMCL's alphas, covariances.

An end pose's covariance is linear in the alphas of AMCL's differential motion model (Thrun, Burgard, Fox, Probabilistic
Robotics, 2005, section 5.4; docs/exports.md), as in a random walk and in errors constant during a run: `form_ratios`.
"""

import math
from bisect import bisect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Final

import numpy as np

from calib.coefficients.formats import Artifact, ascii_line, number
from calib.documents import templates_of
from calib.errors import RefusedError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.observations import Channel
from calib.gap.predict import Path as PredictedPath
from calib.odometry.poses import wrapped
from calib.reporting import paragraph
from calib.reporting.exports import diagnosed
from calib.types import BoolArray, FloatArray, Progress, StrArray

#: motion between the filter's updates: defaults of nav2_amcl
UPDATE_MIN_D_M: Final = 0.25
UPDATE_MIN_A_RAD: Final = 0.2
#: a shorter way has no direction
SHORTEST_WAY_M: Final = 0.01
#: end pose: along and left of the final heading, and heading
POSE: Final = (Channel.ALONG, Channel.LATERAL, Channel.HEADING)
ALPHAS: Final = ("alpha1", "alpha2", "alpha3", "alpha4")
#: of nav2_amcl
DEFAULT_ALPHA: Final = 0.2
#: bounds tried, a third of a per cent apart: from a micrometre in a kilometre
BOUNDS: Final = np.geomspace(1e-15, DEFAULT_ALPHA, 10_000)
#: rise of the misfit beyond chance: half of the 90 % quantile of chi^2, of a size of one sign
BEYOND_CHANCE: Final = 1.353
FOLDS: Final = 10
COVERAGE: Final = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Components of end poses' covariance, (n_components, n_obs, 3, 3), and the reference's (n_obs, 3, 3)."""

    names: tuple[str, ...]
    components: FloatArray
    reference: FloatArray

    def of(self, units: BoolArray) -> "Spread":
        """Return the same of some observations (n_obs,)."""
        return Spread(self.names, self.components[:, units], self.reference[units])

    def free(self, on: BoolArray, held: float = 0.0) -> "Spread":
        """Return the components that are `on`; the reference has the others at the size `held`."""
        return Spread(tuple(compress(self.names, on)), self.components[on], self.covariance(np.where(on, 0.0, held)))

    def covariance(self, sizes: FloatArray) -> FloatArray:
        """Return the covariance of each end pose (n_obs, 3, 3) for sizes (n_components,)."""
        return np.asarray(self.reference + np.einsum("c,cuij->uij", sizes, self.components))


def _levers(way: FloatArray, end: FloatArray) -> FloatArray:
    dx, dy = end[0] - way[:, 0], end[1] - way[:, 1]
    c, s = math.cos(end[2]), math.sin(end[2])
    return np.column_stack((-c * dy + s * dx, s * dy + c * dx, np.ones(len(way))))


def _directions(heading: FloatArray, end: FloatArray) -> FloatArray:
    return np.column_stack((np.cos(heading - end[2]), np.sin(heading - end[2]), np.zeros(len(heading))))


def _outer(vectors: FloatArray, weights: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("n,ni,nj->ij", weights, vectors, vectors))


def amcl_components(poses: FloatArray) -> FloatArray:
    """Return the covariance of a path's end (n, 3) by each alpha of 1, (4, 3, 3)."""
    knots = poses[_updates(poses)]
    end = knots[-1]
    step = np.diff(knots, axis=0)
    way = np.hypot(step[:, 0], step[:, 1])
    course = np.arctan2(step[:, 1], step[:, 0])
    first = np.where(way < SHORTEST_WAY_M, 0.0, wrapped(course - knots[:-1, 2]))
    second = wrapped(step[:, 2] - first)
    turns = [np.minimum(np.abs(turn), np.abs(wrapped(turn - np.pi))) ** 2 for turn in (first, second)]
    before, after = _levers(knots[:-1], end), _levers(knots[1:], end)
    along = _directions(np.where(way < SHORTEST_WAY_M, knots[:-1, 2], course), end)
    by_turns = _outer(before, turns[0]) + _outer(after, turns[1])
    by_way = _outer(before, way**2) + _outer(after, way**2)
    return np.stack((by_turns, by_way, _outer(along, way**2), _outer(along, turns[0] + turns[1])))


def _ways(poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    middle, end = 0.5 * (poses[:-1] + poses[1:]), poses[-1]
    return np.hypot(*np.diff(poses[:, :2], axis=0).T), _directions(middle[:, 2], end), _levers(middle, end)


def walk_components(poses: FloatArray) -> FloatArray:
    """Return the covariance of a path's end (n, 3) by random walks of 1 a metre, (2, 3, 3)."""
    way, directions, levers = _ways(poses)
    return np.stack((_outer(directions, way), _outer(levers, way)))


def constant_components(poses: FloatArray) -> FloatArray:
    """Return the covariance of a path's end (n, 3) by constant errors of 1, (3, 3, 3).

    Relative of the way, of the curvature (1/m), relative of the turns.
    """
    way, directions, levers = _ways(poses)
    moved = np.stack((way @ directions, way @ levers, np.diff(poses[:, 2]) @ levers))
    return np.asarray(np.einsum("ci,cj->cij", moved, moved))


def _updates(poses: FloatArray) -> list[int]:
    kept = [0]
    for at in range(1, len(poses)):
        dx, dy, turn = poses[at] - poses[kept[-1]]
        if math.hypot(dx, dy) >= UPDATE_MIN_D_M or abs(turn) >= UPDATE_MIN_A_RAD:
            kept.append(at)
    last = len(poses) - 1
    return kept if kept[-1] == last else [*kept, last]


#: model of the noise -> names and covariances of its components
MODELS: Final[dict[str, tuple[tuple[str, ...], Callable[[FloatArray], FloatArray]]]] = {
    "amcl": (ALPHAS, amcl_components),
    "walk": (("along", "heading"), walk_components),
    "constant": (("scale", "curvature", "turn scale"), constant_components),
}


def spread_of(path: PredictedPath, units: BoolArray, model: str) -> Spread:
    """Return the components of a model of `MODELS` on the paths of some observations (n_obs,)."""
    s = path.s
    names, component = MODELS[model]
    components = [component(poses) for poses, on in zip(path.traces(), units, strict=True) if on]
    reference = np.zeros((len(components), 3, 3))
    reference[:, 0, 0] = reference[:, 1, 1] = s.sigma[units, 1] ** 2
    reference[:, 2, 2] = s.sigma[units, 3] ** 2
    return Spread(names, np.stack(components, axis=1), reference)


def sizes_of(spread: Spread, residuals: FloatArray, begin: FloatArray | None = None) -> FloatArray:
    """Return the sizes (n_components,), none below zero, that fit residuals (n_obs, 3) best.

    By the likelihood of along, lateral and heading, each by itself. `begin`: sizes near the solution.
    """
    return _fit(spread, residuals, begin)[1]


def _fit(spread: Spread, residuals: FloatArray, begin: FloatArray | None = None) -> tuple[float, FloatArray]:
    from scipy.optimize import minimize

    components = np.einsum("cuii->cui", spread.components).reshape(len(spread.names), residuals.size)
    reference = np.einsum("uii->ui", spread.reference).ravel()
    square = residuals.ravel() ** 2
    # scaled to the residuals: one step of the search fits all
    relative = components.reshape(len(components), *residuals.shape) / np.mean(residuals**2, axis=0)
    unit = 1.0 / np.maximum(np.mean(relative, axis=(1, 2)), 1e-30)
    scaled = unit[:, None] * components

    def misfit(sizes: FloatArray) -> tuple[float, FloatArray]:
        variance = reference + sizes @ scaled
        value = 0.5 * float(np.sum(np.log(variance) + square / variance))
        return value, 0.5 * scaled @ ((1.0 - square / variance) / variance)

    if not len(unit):
        return misfit(unit)[0], unit
    start = np.full(len(unit), 1.0 / len(unit)) if begin is None else begin / unit
    optimum = minimize(misfit, start, jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * len(unit))
    return float(optimum.fun), np.asarray(optimum.x * unit)


def stated(spread: Spread, residuals: FloatArray, raised: float = 1.0) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return each component's size, times `raised`, and the names of those left undetermined.

    Without these the fit is worse by chance at most. They have the most that the residuals allow with any others.
    """
    limit = _fit(spread, residuals)[0] + BEYOND_CHANCE
    on = np.ones(len(spread.names), dtype=np.bool_)
    for at in np.argsort(np.einsum("cuii->c", spread.components)):
        on[at] = False
        on[at] = _fit(spread.free(on), residuals)[0] > limit

    def most(name: str) -> float:
        others = np.array(spread.names) != name
        return float(BOUNDS[bisect(BOUNDS, limit, key=lambda size: _fit(spread.free(others, size), residuals)[0]) - 1])

    free, unknown = spread.free(on), tuple(compress(spread.names, ~on))
    sizes = zip(free.names, (raised * sizes_of(free, residuals)).tolist(), strict=True)
    return dict.fromkeys(spread.names, 0.0) | dict(sizes) | {name: most(name) for name in unknown}, unknown


def ratios(variance: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return observed over predicted standard deviation along, lateral, in heading (3,)."""
    return np.asarray(np.sqrt(np.mean(residuals**2, axis=0) / np.mean(variance, axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Sizes of the components, and observed over predicted standard deviation of other runs."""

    sizes: FloatArray
    ratios: FloatArray  #: along, lateral, heading, shape (3,)
    interval: FloatArray  #: of each, shape (3, 2)
    raised: float = 1.0  #: how many times as large as fitted the sizes are


def fitted(spread: Spread, residuals: FloatArray, kinds: StrArray) -> Fitted:
    """Fit the sizes, each tenth of the runs of a kind (n_obs,) against the others' sizes.

    The sizes are raised until runs held out scatter as predicted in the mean of the three.
    """
    from scipy.stats import chi2

    full = sizes_of(spread, residuals)
    fold = np.empty(len(residuals), dtype=np.int64)
    fold[np.argsort(kinds, kind="stable")] = np.arange(len(residuals)) % FOLDS
    reference = np.einsum("uii->ui", spread.reference)
    added = np.empty_like(residuals)
    for part in range(FOLDS):
        held = fold == part
        sizes = sizes_of(spread.of(~held), residuals[~held], begin=full)
        added[held] = np.einsum("c,cuii->ui", sizes, spread.components[:, held])
    raised = max(1.0, float(np.exp(2.0 * np.mean(np.log(ratios(reference + added, residuals))))))
    variance = reference + raised * added
    ratio = ratios(variance, residuals)
    # degrees of freedom by the squares' scatter (Satterthwaite): fewer with heavy tails
    normal = ratio**2 * variance
    scatter = np.sum((residuals**2 - normal) ** 2, axis=0)
    freedom = 2.0 * np.sum(residuals**2, axis=0) ** 2 / np.maximum(scatter, 2.0 * np.sum(normal**2, axis=0))
    tails = np.array([0.5 + 0.5 * COVERAGE, 0.5 - 0.5 * COVERAGE])
    interval = ratio[:, None] * np.sqrt(freedom[:, None] / chi2.ppf(tails, freedom[:, None]))
    return Fitted(raised * full, ratio, interval, raised)


def form_ratios(amcl: Spread, others: Sequence[Spread], residuals: FloatArray) -> FloatArray:
    """Return the ratios (3,) of AMCL's model with infinitely many such runs: the bias by its form.

    `others` together describe the scatter.
    """
    components = np.concatenate([other.components for other in others])
    whole = Spread(tuple(name for other in others for name in other.names), components, amcl.reference)
    expected = np.sqrt(np.einsum("uii->ui", whole.covariance(sizes_of(whole, residuals))))
    return ratios(np.einsum("uii->ui", amcl.covariance(sizes_of(amcl, expected))), expected)


#: fewest end poses: the standard error of their spread is a sixth
FEWEST_RUNS: Final = 20
#: of the variances of a twist
RATE_HZ: Final = 50.0
SPEED_MPS: Final = 1.0
CHANNELS: Final = ("along", "lateral", "heading")
#: deviation from 1 of a ratio by the form that is pointed out
FORM_TOLERANCE: Final = 0.1


def is_beyond(form: FloatArray) -> bool:
    """Return whether ratios by the form (3,) are further from 1 than `FORM_TOLERANCE`."""
    return bool(np.abs(np.log(form)).max() > np.log(1.0 + FORM_TOLERANCE))


@dataclass(frozen=True, slots=True, eq=False)
class _KindNoise:
    kind: str
    n_runs: int
    alphas: dict[str, float]
    undetermined: tuple[str, ...]
    form: FloatArray


def kind_noise(models: Sequence[Spread], residuals: FloatArray, kinds: StrArray) -> tuple[_KindNoise, ...]:
    """Return the alphas of each kind of enough runs; `models`: of `MODELS`."""
    rows = []
    for kind in sorted(set(kinds)) if len(set(kinds)) > 1 else ():
        on = kinds == kind
        if on.sum() >= FEWEST_RUNS:
            amcl, *others = (model.of(on) for model in models)
            alphas = stated(amcl, residuals[on])
            rows.append(_KindNoise(str(kind), int(on.sum()), *alphas, form_ratios(amcl, others, residuals[on])))
    return tuple(rows)


@dataclass(frozen=True, slots=True, eq=False)
class MotionNoise:
    """The noise of the corrected odometry on held-out runs."""

    n_runs: int
    length_m: float
    turn_rad: float  #: median of their total absolute rotation
    alphas: dict[str, float]
    undetermined: tuple[str, ...]  #: alphas and walks that are bounds or defaults
    walks: dict[str, float]  #: variance a metre of distance (m) and of heading (rad^2/m)
    held_out: Fitted
    form: FloatArray  #: ratios by the form of AMCL's model alone, shape (3,)
    by_kind: tuple[_KindNoise, ...] = ()  #: where no alphas spread as all runs do
    bounded: FloatArray | None = None  #: ratios of these runs where some alphas are bounds or defaults, shape (3,)

    @property
    def beyond_form(self) -> bool:
        """Whether no alphas spread as the runs do."""
        return is_beyond(self.form)

    @property
    def cover(self) -> float:
        """Factor of the alphas that understates none of the three."""
        return float(self.form.max() ** 2)


def render(path: Path, accept: str, progress: Progress) -> tuple[Artifact, ...]:  # noqa: ARG001
    """Diagnose a campaign and return the parameters; see `export_from`."""
    campaign, diagnosis = diagnosed(path, progress)
    noise = motion_noise(diagnosis)
    named = ", ".join(cause.effect for cause in diagnosis.corrected_causes) or "nothing"
    notes = [f"the odometry is taken as corrected by: {named}; on the vehicle, correct it likewise"]
    if diagnosis.causes and not diagnosis.recommended:
        notes.append("this correction is not recommended: see calib diagnose")
    if unknown := ", ".join(name if name in ALPHAS else f"the walk ({name})" for name in noise.undetermined):
        notes.append(paragraph("amcl_unknown", listed=unknown))
    if noise.beyond_form:
        notes.append(paragraph("amcl_form", listed=_listed(noise.form), cover=noise.cover))
        if near := ", ".join(each.kind for each in noise.by_kind if not is_beyond(each.form)):
            notes.append(f"alphas of their own meet the runs of {near} alone; the file has them by kind of run")
    text = parameters_text(noise, campaign.name, named, simulated=campaign.simulated)
    return (Artifact("nav2_odometry.yaml", text.encode(), tuple(notes)),)


def motion_noise(diagnosis: Diagnosis) -> MotionNoise:
    """Return the noise of the odometry corrected by a diagnosis, from held-out end poses."""
    observations = diagnosis.observations
    if observations.aside_m is not None:
        raise RefusedError(
            f"{diagnosis.campaign}: found a vehicle that moves sideways; expected two wheels on an axle, whose "
            "motion model is AMCL's differential one; set the omnidirectional model by hand"
        )
    units = np.asarray(observations.usable[:, POSE].all(axis=1))
    if units.sum() < FEWEST_RUNS:
        raise RefusedError(
            f"{diagnosis.campaign}: found {int(units.sum())} end poses with a heading; expected {FEWEST_RUNS} at "
            "least; a spread needs them: measure ref_x_m, ref_y_m and ref_theta_rad at the end of each run"
        )
    residuals, kinds = diagnosis.arrays.held_out.after[units][:, POSE], observations.labels["kind"][units]
    path = diagnosis.correction.path
    models = amcl, walk, constant = tuple(spread_of(path, units, model) for model in MODELS)
    noise, form = fitted(amcl, residuals, kinds), form_ratios(amcl, (walk, constant), residuals)
    alphas, unknown = stated(amcl, residuals, noise.raised)
    walks, unknown_walks = stated(walk, residuals)
    spread = np.einsum("uii->ui", amcl.covariance(np.array(list(alphas.values()))))
    return MotionNoise(
        n_runs=int(units.sum()),
        length_m=float(np.median(observations.length_m[units])),
        turn_rad=float(np.median(observations.total(np.abs(path.steps.turn_rad))[units])),
        alphas=alphas,
        undetermined=unknown + unknown_walks,
        walks=walks,
        held_out=noise,
        form=form,
        by_kind=kind_noise(models, residuals, kinds) if is_beyond(form) else (),
        bounded=ratios(spread, residuals) if unknown else None,
    )


def parameters_text(noise: MotionNoise, campaign: str, corrected: str, *, simulated: bool) -> str:
    """Return the parameter file of a noise; `corrected`: by what the odometry is corrected."""
    held_out = zip(CHANNELS, noise.held_out.ratios, noise.held_out.interval, strict=True)
    template = templates_of(__package__).get_template("nav2.yaml.j2")
    constants = {"update_min_d": UPDATE_MIN_D_M, "update_min_a": UPDATE_MIN_A_RAD, "default_alpha": DEFAULT_ALPHA}
    return template.render(
        constants | {"noise": noise, "campaign": campaign, "corrected": corrected, "simulated": simulated},
        ratios=[f"{name} {ratio:.2f} ({low:.2f} to {high:.2f})" for name, ratio, (low, high) in held_out],
        listed=_listed,
        rounded=lambda value: number(float(f"{value:.4g}")),
        ascii_line=ascii_line,
        speed_mps=SPEED_MPS,
        rate_Hz=RATE_HZ,
    )


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in zip(CHANNELS, values, strict=True))
