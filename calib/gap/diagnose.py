"""From a campaign to a verdict: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign, FloatArray
from calib.campaign.settings import OdometryModel
from calib.gap.aliases import aliases_of, undetectable_size
from calib.gap.closure import Closure, measure_closure
from calib.gap.effects.effect import Effect, Form
from calib.gap.effects.library import library
from calib.gap.fit import Fitted, fit
from calib.gap.gross import GrossFault, corrected, find_gross
from calib.gap.linear import CALIBRATION_SD, Nuisance, rows
from calib.gap.noise import Noise, estimate_noise
from calib.gap.path import Path, predict
from calib.gap.recalibration import DIRECTIONS, NAMES, Recalibration, judge_recalibration
from calib.gap.residuals import residuals
from calib.gap.search import Hypothesis, Search, Settings, Workbench, search
from calib.gap.situation import CHANNELS, Situation, build_situation
from calib.gap.verdict import Cause, Quantity, Verdict

#: a gap is said to exist where the probability that anything is off reaches this
DETECTION: Final = 0.8

__all__ = ["Diagnosis", "diagnose", "diagnose_in_full"]


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """A verdict with the arrays behind it, for figures.

    Parameters
    ----------
    verdict : Verdict
        The answer.
    situation : Situation
        Units and steps.
    noise : Noise
        Covariance of each unit.
    nominal : Path
        The model alone.
    fitted : Fitted
        The hypothesis that the verdict names, the recalibration free.
    closure : Closure or None
        The gap before and after on held-out runs.
    """

    verdict: Verdict
    situation: Situation
    noise: Noise
    nominal: Path
    fitted: Fitted
    closure: Closure | None


def diagnose(
    campaign: Campaign,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    model: OdometryModel | None = None,
    settings: Settings | None = None,
) -> Verdict:
    """Diagnose the gap of a campaign; see `diagnose_in_full`."""
    return diagnose_in_full(campaign, seed=seed, exclude=exclude, model=model, settings=settings).verdict


def diagnose_in_full(
    campaign: Campaign,
    *,
    seed: int = 0,
    exclude: tuple[str, ...] = (),
    model: OdometryModel | None = None,
    settings: Settings | None = None,
) -> Diagnosis:
    """Diagnose the gap of a campaign.

    Parameters
    ----------
    campaign : Campaign
        What was driven and measured.
    seed : int
        For the bootstrap of the closure.
    exclude : tuple of str
        Effects to leave out of the library.
    model : OdometryModel, optional
        What the simulator believes; the campaign's own by default.
    settings : Settings, optional
        What the search takes for granted.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RefusedError
        Where no run has both counts and something measured.
    """
    settings = settings or Settings()
    s = build_situation(campaign, model)
    nominal = predict(s)
    fault = find_gross(s, nominal) if "encoder_gross" not in exclude else None
    before = residuals(nominal, nominal)
    if fault is not None:
        s = corrected(s, fault)
        nominal = predict(s)
    effects = library(s, exclude=exclude, declared=campaign.extra.get("effects", ()))
    # a gross fault is looked for above, by re-simulation; the linear search is no place for it
    effects = [effect for effect in effects if effect.id != "encoder_gross"]
    noise, base = _settle(nominal)
    found = search(nominal, noise, base, effects, settings)
    chosen = _choose(found)
    recalibration = judge_recalibration(chosen.fitted, nominal, noise, settings)
    return _Judge(
        campaign, s, nominal, noise, effects, found, chosen, recalibration, settings, seed, fault, before
    ).diagnosis()


def _settle(nominal: Path) -> tuple[Noise, Fitted]:
    """Fit the recalibration and the noise in turn."""
    noise = estimate_noise(nominal, residuals(nominal, nominal))
    base = fit(nominal, noise)
    for _ in range(1):
        noise = estimate_noise(base.path, base.left)
        base = fit(nominal, noise, start=base)
    return noise, base


def _choose(found: Search) -> Hypothesis:
    """Return the best hypothesis, an unknown rest beside it or not."""
    return found.hypotheses[0]


class _Judge:
    """Turns a search into a verdict."""

    def __init__(
        self,
        campaign: Campaign,
        s: Situation,
        nominal: Path,
        noise: Noise,
        effects: list[Effect],
        found: Search,
        chosen: Hypothesis,
        recalibration: Recalibration,
        settings: Settings,
        seed: int,
        fault: GrossFault | None,
        before: FloatArray,
    ) -> None:
        self.campaign, self.s, self.nominal, self.noise = campaign, s, nominal, noise
        self.effects = {e.id: e for e in effects}
        self.found, self.chosen, self.recalibration = found, chosen, recalibration
        self.settings, self.seed = settings, seed
        self.fault, self.before = fault, before
        self.probabilities = found.probabilities()
        self.named_calibration = recalibration.subsets[0]
        self.bench = Workbench(chosen.fitted.path, nominal, noise)
        self.per_unit = self.bench.calibration / CALIBRATION_SD

    def diagnosis(self) -> Diagnosis:
        """Return the verdict and the arrays behind it."""
        verdict, sentence = "no_gap", ""
        chosen = self.chosen
        p_unknown = self._probability(lambda h: h.unknown)
        groups = self._groups()
        closure = measure_closure(
            self.nominal,
            self.noise,
            chosen.fitted,
            np.random.default_rng(self.seed),
            sessions="session_step" not in chosen.effects,
        )
        named = (*chosen.effects, *self.named_calibration)
        if self._gap_probability() < DETECTION:
            verdict, named = "no_gap", ()
        elif chosen.unknown and not named:
            verdict = "unknown"
        elif chosen.unknown:
            verdict = "partly_explained"
            if closure.fraction is None or closure.fraction < 0.3:
                verdict = "unknown"
        elif not named:
            verdict = "no_gap"
        elif any(len(group) > 1 for group in groups):
            verdict = "ambiguous"
        else:
            verdict = "explained"
        if verdict in ("explained", "ambiguous") and closure.ci95 is not None and closure.ci95[1] < 0.7:
            verdict = "unknown"
        if self.fault is not None:
            verdict = {"no_gap": "explained", "unknown": "partly_explained"}.get(verdict, verdict)
        causes = self._causes() if named and verdict not in ("no_gap", "unknown") else []
        if self.fault is not None:
            causes.insert(0, self._gross_cause())
        if verdict == "no_gap":
            groups = []
        made = Verdict(
            verdict=verdict,
            sentence=sentence,
            causes=tuple(causes),
            credible_sets=self._credible_sets(),
            indistinguishable=tuple(tuple(group) for group in groups if len(group) > 1),
            undetectable={},
            where=self._where(closure),
            closure=self._closure(closure),
            recommended=verdict in ("explained", "partly_explained")
            and closure.fraction is not None
            and closure.fraction >= 0.7
            and closure.ci95 is not None
            and closure.ci95[0] > 0.3,
            next_runs=(),
            notes=self.s.notes,
            noise={"dof": self.noise.dof, "scales": self.noise.scales},
            probabilities=self._effect_probabilities() | {"unknown": p_unknown},
            campaign=self.campaign.name,
            simulated=self.campaign.simulated,
        )
        return Diagnosis(made, self.s, self.noise, self.nominal, chosen.fitted, closure)

    def _gap_probability(self) -> float:
        """Return the probability that anything at all is off."""
        nothing = self._probability(lambda h: not h.effects and not h.unknown)
        for subset, p in zip(self.recalibration.subsets, self.recalibration.probabilities, strict=True):
            if not subset:
                return 1.0 - nothing * float(p)
        return 1.0

    def _gross_cause(self) -> Cause:
        fault = self.fault
        assert fault is not None
        quantities = {
            "factor_left": Quantity(fault.left, (fault.left, fault.left), "1"),
            "factor_right": Quantity(fault.right, (fault.right, fault.right), "1"),
        }
        return Cause(
            effect="encoder_gross",
            title="a gross fault of the encoders",
            form=fault.label,
            probability=1.0,
            share=1.0,
            signal=float("inf"),
            parameters=quantities,
            remark="put the counts right, then diagnose again",
        )

    def _probability(self, what: Any) -> float:
        return float(sum(p for h, p in zip(self.found.hypotheses, self.probabilities, strict=True) if what(h)))

    def _effect_probabilities(self) -> dict[str, float]:
        made: dict[str, float] = {}
        for h, p in zip(self.found.hypotheses, self.probabilities, strict=True):
            for name in h.effects:
                made[name] = made.get(name, 0.0) + float(p)
        for name in NAMES:
            made[name] = self.recalibration.probability(name)
        return {k: v for k, v in sorted(made.items(), key=lambda item: -item[1]) if v > 1e-4}

    def _contribution(self, form: Form, theta: FloatArray) -> FloatArray:
        return self.bench.columns(form) @ (theta / np.array([p.typical for p in form.parameters]))

    def _calibration_contribution(self, name: str) -> FloatArray:
        k = NAMES.index(name)
        return self.per_unit @ DIRECTIONS[k] * self.recalibration.values[k]

    def _groups(self) -> list[list[str]]:
        """Return, for each named effect, the group that these runs cannot tell it from (itself first)."""
        fitted = self.chosen.fitted
        named = (*self.chosen.effects, *self.named_calibration)
        others = self.found.forms
        calibration_forms = {n: e.forms(self.s) for n, e in self.effects.items() if e.calibration}
        groups = []
        for form, theta in zip(fitted.forms, fitted.theta, strict=True):
            rest = [self.bench.calibration]
            rest += [3.0 * self.bench.columns(f) for f in fitted.forms if f is not form]
            nuisance = Nuisance.of(np.concatenate(rest, axis=1))
            near = aliases_of(self.bench, nuisance, self._contribution(form, theta), others, named)
            groups.append([form.effect, *sorted(near, key=lambda n: near[n])])
        for name in self.named_calibration:
            rest = [self.bench.calibration[:, 3:]]
            rest += [3.0 * self.bench.columns(f) for f in fitted.forms]
            rest += [
                (self.per_unit @ DIRECTIONS[NAMES.index(other)])[:, None]
                for other in self.named_calibration
                if other != name
            ]
            nuisance = Nuisance.of(np.concatenate(rest, axis=1))
            near = aliases_of(
                self.bench, nuisance, self._calibration_contribution(name), others | calibration_forms, named
            )
            groups.append([name, *sorted(near, key=lambda n: near[n])])
        return groups

    def _causes(self) -> list[Cause]:
        from scipy.special import stdtrit

        fitted = self.chosen.fitted
        k = float(stdtrit(max(self.noise.dof, 3.0), 0.975))
        inflate = float(np.sqrt(max(1.0, fitted.chi_square / max(len(self.bench.gap) - len(fitted.parameters) - 4, 1))))
        nominal = rows(self.nominal, self.noise, residuals(self.nominal, self.nominal)[:, :, None])[:, 0]
        excess = max(float(nominal @ nominal) - len(nominal), 1.0)
        nuisance = Nuisance.of(self.bench.calibration)
        probability = self._effect_probabilities()
        made = []
        position = 4
        for form, theta in zip(fitted.forms, fitted.theta, strict=True):
            contribution = self._contribution(form, theta)
            signal = float(np.sqrt(nuisance.scalar(contribution[:, None], contribution[:, None])[0, 0]))
            quantities = {}
            plausible = True
            for parameter, value in zip(form.parameters, theta, strict=True):
                sd = float(np.sqrt(fitted.covariance[position, position])) * inflate
                position += 1
                quantities[parameter.name] = Quantity(
                    float(value), (float(value - k * sd), float(value + k * sd)), parameter.unit
                )
                plausible &= abs(value) - 2 * sd <= parameter.largest
            effect = self.effects[form.effect]
            made.append(
                Cause(
                    effect=form.effect,
                    title=effect.title,
                    form=form.label,
                    probability=probability.get(form.effect, 0.0),
                    share=float(np.clip(contribution @ contribution / excess, 0.0, 1.0)),
                    signal=signal,
                    parameters=quantities,
                    plausible=plausible,
                    remark="" if plausible else f"larger than is physically plausible: suspect {effect.implausible}",
                    settings=form.settings,
                )
            )
        for name in self.named_calibration:
            i = NAMES.index(name)
            contribution = self._calibration_contribution(name)
            value, sd = float(self.recalibration.values[i]), float(self.recalibration.sd[i]) * inflate
            largest = self.effects[name].forms(self.s)[0].parameters[0].largest if name in self.effects else np.inf
            plausible = abs(value) - 2 * sd <= largest
            title = self.effects[name].title if name in self.effects else name
            made.append(
                Cause(
                    effect=name,
                    title=title,
                    form="",
                    probability=probability.get(name, 0.0),
                    share=float(np.clip(contribution @ contribution / excess, 0.0, 1.0)),
                    signal=float(self.recalibration.signal[i]),
                    parameters={"relative": Quantity(value, (value - k * sd, value + k * sd), "1")},
                    plausible=plausible,
                    remark="" if plausible or name not in self.effects else f"suspect {self.effects[name].implausible}",
                )
            )
        return sorted(made, key=lambda cause: -cause.probability)

    def _credible_sets(self) -> tuple[tuple[str, ...], ...]:
        """Return the most probable sets of causes that together hold 95 %."""
        weights: dict[tuple[str, ...], float] = {}
        for h, p in zip(self.found.hypotheses, self.probabilities, strict=True):
            for subset, q in zip(self.recalibration.subsets, self.recalibration.probabilities, strict=True):
                key = (*h.effects, *subset, *(("unknown",) if h.unknown else ()))
                weights[key] = weights.get(key, 0.0) + float(p * q)
        made, total = [], 0.0
        for key, weight in sorted(weights.items(), key=lambda item: -item[1]):
            made.append(key)
            total += weight
            if total >= 0.95:
                break
        return tuple(made)

    def _where(self, closure: Closure) -> dict[str, Any]:
        channels = {}
        for number, name in enumerate(CHANNELS):
            on = self.s.usable[:, number]
            if on.any():
                channels[name] = {
                    "rms": float(np.sqrt(np.mean(closure.before[on, number] ** 2))),
                    "floor": float(np.sqrt(np.mean(closure.floor[on, number] ** 2))),
                }
        return {"channels": channels, "covariates": [], "runs": [], "places": []}

    def _closure(self, closure: Closure) -> dict[str, Any]:
        def rms(values: FloatArray) -> float:
            on = self.s.usable
            pose = on[:, 1] & on[:, 2]
            if pose.any():
                return float(np.sqrt(np.mean(values[pose, 1] ** 2 + values[pose, 2] ** 2)))
            if on[:, 0].any():
                return float(np.sqrt(np.mean(values[on[:, 0], 0] ** 2)))
            return float("nan")

        made = {
            "before_rms_m": rms(self.before),
            "after_rms_m": rms(closure.after),
            "floor_rms_m": rms(closure.floor),
            "fraction": closure.fraction,
            "ci95": None if closure.ci95 is None else list(closure.ci95),
            "held_out": closure.held_out,
            "by_channel": closure.by_channel,
        }
        return {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in made.items()}


def sizes_needed(bench: Workbench, forms: dict[str, list[Form]]) -> dict[str, FloatArray]:
    """Return for each effect the size that these runs could just show (signal 5), by its best form."""
    nuisance = Nuisance.of(bench.calibration)
    return {name: undetectable_size(bench, nuisance, made[0]) for name, made in forms.items()}
