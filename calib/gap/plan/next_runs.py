"""Which runs to drive next, best first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.gap.data.from_campaign import observations_of
from calib.gap.data.observations import Observations
from calib.gap.effects.applied import matching_form
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Effect, Form
from calib.gap.evidence.fit import Fitted
from calib.gap.evidence.noise import Noise
from calib.gap.plan.planned_runs import DEFAULT_CORRIDOR_M, Measured, PlannedRun, default_candidates, drive, joined
from calib.gap.plan.separability import Signatures, noise_at
from calib.gap.predict.path import predict
from calib.gap.verdict.alternatives import NEAR
from calib.gap.verdict.outcome import PlannedRunAdvice

MOST_RUNS: Final = 5
#: pairs named in one line
NAMED: Final = 3


def next_runs(
    campaign: Campaign,
    effects: Sequence[Effect],
    noise: Noise,
    ties: Sequence[Sequence[str]] = (),
    fitted: Fitted | None = None,
    *,
    model: OdometryModel | None = None,
    candidates: Sequence[PlannedRun] | None = None,
    most: int = MOST_RUNS,
) -> list[PlannedRunAdvice]:
    """Return the runs to drive next, best first, with what each would tell apart.

    The next runs are taken to be driven in one session that begins with a repeat of an unladen corridor run. Each step
    takes the run after which the nearest two effects of the tie lie furthest apart; without a tie, the run after which
    most effects of the library are seen and stand apart.

    Parameters
    ----------
    campaign : Campaign
        What was driven.
    effects : sequence of Effect
        The library.
    noise : Noise
        Of the campaign; its scales are taken for the next runs too.
    ties : sequence of sequence of str
        Groups of effects that the campaign cannot tell apart, the named one first.
    fitted : Fitted, optional
        Gives the sizes of the effects that were fitted; others are taken at their typical size.
    model : OdometryModel, optional
        What the simulator believes; the campaign's own by default.
    candidates : sequence of PlannedRun, optional
        Runs to choose from; `default_candidates` without.
    most : int
        How many runs to name.

    Returns
    -------
    list of PlannedRunAdvice
        Empty where no candidate helps.
    """
    from dataclasses import replace

    driven = campaign.included()
    if model is not None:
        driven = replace(driven, model=model)
    offered = list(candidates) if candidates is not None else default_candidates(driven)
    if not offered:
        return []
    corridor_m = _corridor_m(driven)
    measured = _measured(driven)
    reference = PlannedRun("corridor", "out", temperature_C=_usual(driven))
    planned = drive(driven, [reference, *offered], measured, corridor_m)
    whole = joined(driven, planned)
    observations = observations_of(whole)
    path = predict(observations)
    future = np.array([str(name).startswith("next") for name in observations.labels["run_id"]])
    number_of = {str(name): unit for unit, name in enumerate(observations.labels["run_id"])}
    of_run = [number_of.get(f"next{number:03d}") for number in range(len(offered) + 1)]
    sizes = _sizes(observations, effects, fitted)
    signatures = Signatures(path, noise_at(path, noise.scales), effects, sizes)
    base = signatures.gram(~future) + (_one(signatures, of_run[0]) if of_run[0] is not None else 0.0)
    grams = {number: _one(signatures, unit) for number, unit in enumerate(of_run[1:]) if unit is not None}
    task = _Task(signatures, ties)
    chosen: list[PlannedRunAdvice] = []
    for _ in range(most):
        before = task.distances(base)
        if task.done(before) or not grams:
            break
        scored = {number: task.score(task.distances(base + gram)) for number, gram in grams.items()}
        best = max(scored, key=lambda number: (scored[number], -number))
        after = task.distances(base + grams[best])
        if not task.score(after) > task.score(before):
            break
        base = base + grams.pop(best)
        distance = float(after.min()) if task.pairs else None
        chosen.append(offered[best].advice(task.why(before, after), distance))
    return chosen


def _one(signatures: Signatures, unit: int | None) -> FloatArray:
    columns = signatures.columns[signatures.unit == unit]
    return np.asarray(columns.T @ columns)


class _Task:
    """What the next runs are to tell apart."""

    def __init__(self, signatures: Signatures, ties: Sequence[Sequence[str]]) -> None:
        self.signatures = signatures
        number = {name: index for index, name in enumerate(signatures.names)}
        self.pairs = [
            (number[group[0]], number[other])
            for group in ties
            for other in group[1:]
            if group[0] in number and other in number
        ]
        self.truths = sorted({a for a, _ in self.pairs}) if self.pairs else list(range(len(signatures.names)))

    def distances(self, gram: FloatArray) -> FloatArray:
        """Return the distance of each tied pair, or how well each effect stands apart where there is no tie."""
        signal, distance = self.signatures.distances(gram, self.truths)
        if self.pairs:
            row = {truth: index for index, truth in enumerate(self.truths)}
            return np.array([distance[row[a], b] for a, b in self.pairs])
        return np.asarray(np.minimum(signal, distance.min(axis=1, initial=np.inf)))

    def done(self, gain: FloatArray) -> bool:
        """Return whether all is told apart with something to spare."""
        return bool((gain >= 2 * NEAR).all())

    def score(self, gain: FloatArray) -> tuple[float, float]:
        """Return what is to be made large: the smallest distance, then all of them; numbers told apart first."""
        if self.pairs:
            return (round(float(np.min(np.minimum(gain, 4 * NEAR))), 6), float(np.minimum(gain, 4 * NEAR).sum()))
        return (float(np.minimum(gain / NEAR, 1.0).sum()), float(np.minimum(gain, 4 * NEAR).sum()))

    def why(self, before: FloatArray, after: FloatArray) -> str:
        """Say what a run tells apart, most gained first."""
        names = self.signatures.names
        order = np.argsort(-(np.minimum(after, 4 * NEAR) - np.minimum(before, 4 * NEAR)))[:NAMED]
        order = np.array([k for k in order if after[k] > before[k] + 0.05], dtype=np.int64)
        if self.pairs:
            sentences = []
            for k in order:
                a, b = self.pairs[int(k)]
                word = "tells" if after[k] >= NEAR else "begins to tell"
                sentences.append(f"{word} {names[a]} from {names[b]}")
            return ", ".join(sentences) or "repeats what is least sure"
        clear = [names[self.truths[int(k)]] for k in order if after[k] >= NEAR]
        return f"shows {', '.join(clear or [names[self.truths[int(k)]] for k in order])}" + ("" if clear else " better")


def _sizes(
    observations: Observations, effects: Sequence[Effect], fitted: Fitted | None
) -> dict[str, tuple[Form, FloatArray]]:
    """Return form and size, on the joint runs, of the effects that were fitted."""
    sizes: dict[str, tuple[Form, FloatArray]] = {}
    if fitted is None:
        return sizes
    by_id = {effect.id: effect for effect in effects}
    for form, theta in zip(fitted.forms, fitted.theta, strict=True):
        if form.effect not in by_id:
            continue
        here = matching_form(by_id[form.effect].forms(observations), form.label, form.settings)
        if here is None:
            continue
        known = {parameter.name: float(value) for parameter, value in zip(form.parameters, theta, strict=True)}
        sizes[form.effect] = (here, np.array([known.get(parameter.name, 0.0) for parameter in here.parameters]))
    calibration = np.linalg.solve(DIRECTIONS[:, :3].T, fitted.calibration[:3])
    for name, size in zip(NAMES, calibration, strict=True):
        forms = by_id[name].forms(observations) if name in by_id else []
        if forms and abs(size) > 1e-12:
            sizes[name] = (forms[0], np.full(len(forms[0].parameters), float(size)))
    return sizes


def _measured(campaign: Campaign) -> Measured:
    runs, logs = campaign.runs, campaign.logs
    front = logs.columns.get("counts_front")
    return Measured(
        distance=bool(np.isfinite(runs.number("distance_m")).any() or "range_m" in logs.columns),
        poses=bool(np.isfinite(runs.number("ref_theta_rad")).any() or "ref_theta_rad" in logs.columns),
        front=front is not None and bool(np.isfinite(front).any()),
        log=bool(logs.present.any()),
    )


def _corridor_m(campaign: Campaign) -> float:
    distance = campaign.runs.number("distance_m")
    corridor = (campaign.runs.label("kind") == "corridor") & np.isfinite(distance)
    length = float(np.median(distance[corridor])) if corridor.any() else DEFAULT_CORRIDOR_M
    return length if 2.0 <= length <= 500.0 else DEFAULT_CORRIDOR_M


def _usual(campaign: Campaign) -> float:
    warm = campaign.runs.number("temperature_C")
    return float(np.nanmedian(warm)) if np.isfinite(warm).any() else float("nan")
