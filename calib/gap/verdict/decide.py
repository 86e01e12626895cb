"""From a search of hypotheses to a verdict: what is named, what cannot be told apart, what is recommended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.model import Campaign
from calib.gap.effects.calibration import DIRECTIONS, NAMES
from calib.gap.effects.effect import Effect, Form
from calib.gap.effects.encoder_gross import GrossFault
from calib.gap.evidence.marginal import CALIBRATION_SD, Nuisance, rows
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.recalibration import PRIOR, Recalibration
from calib.gap.evidence.search import Hypothesis, Search, Settings
from calib.gap.evidence.sizes import size_spreads
from calib.gap.evidence.whitened import WhitenedSystem
from calib.gap.predict.path import Path
from calib.gap.predict.residuals import residuals
from calib.gap.verdict.alternatives import NEAR, aliases_of
from calib.gap.verdict.closure import Closure
from calib.gap.verdict.gross import gross_cause
from calib.gap.verdict.result import SURE, Cause, Quantity, Verdict

__all__ = ["Judge"]

#: a gap is said to exist where the probability that anything is off reaches this
DETECTION: Final = 0.7
#: an unknown cause alone is called one where its probability reaches this
UNKNOWN: Final = 0.85
#: a cause named beside an unknown rest may be what the rest looks like: by so much its probability is cut
DOUBT: Final = 0.6
#: closure on held-out runs below which a fix is not recommended, and an explanation not believed
CLOSES: Final = 0.7
#: closure from which on a gap counts as explained; below, a rest is left
EXPLAINS: Final = 0.9
#: probability of an unknown cause, at least, where the named ones leave such a rest
REST: Final = 0.5
#: how probable it is that what so many named causes (a calibration parameter counts half) explain together is one cause
#: outside the library, which they imitate; from cases whose true effect was deleted from the library
IMITATION: Final = ((0.0, 1.0, 2.0, 2.5), (0.0, 0.08, 0.12, 0.9))
#: a cause that shows by less than this share of the strongest one may be that one's deviation from its assumed form
WEAK: Final = 0.4
#: by what its probability is cut
WEAKENED: Final = 0.6
#: hypotheses whose weights differ by less (a factor of ten) are not told apart either
LIKELY_NATS: Final = 2.3


class Judge:
    """Turns a search into a verdict.

    Parameters
    ----------
    campaign : Campaign
        What was driven and measured.
    nominal : Path
        The model alone (a gross fault put right).
    noise : Noise
        Covariance of each unit.
    effects : sequence of Effect
        The library.
    found : Search
        All hypotheses tried, best first.
    recalibration : Recalibration
        Which calibration parameters are off beside the best hypothesis' effects.
    closure : Closure
        The gap before and after on held-out runs, for the best hypothesis.
    fault : GrossFault, optional
        A gross fault of the encoders, found and put right before the search.
    settings : Settings
        What the search took for granted.
    """

    def __init__(
        self,
        campaign: Campaign,
        nominal: Path,
        noise: Noise,
        effects: Sequence[Effect],
        found: Search,
        recalibration: Recalibration,
        closure: Closure,
        fault: GrossFault | None,
        settings: Settings,
    ) -> None:
        self.campaign, self.s, self.nominal, self.noise = campaign, nominal.s, nominal, noise
        self.effects = {e.id: e for e in effects}
        self.found, self.recalibration, self.closure, self.fault = found, recalibration, closure, fault
        self.chosen: Hypothesis = found.hypotheses[0]
        self.probabilities = found.probabilities()
        self.calibration = tuple(n for n in recalibration.subsets[0] if n in self.effects)
        #: a calibration parameter is off whose effect the library was denied: a cause outside the library
        self.denied = len(self.calibration) < len(recalibration.subsets[0])
        self.bench = WhitenedSystem(self.chosen.fitted.path, nominal, noise)
        self.settings = settings
        self.shares: dict[str, float] = {}
        self.per_unit = self.bench.calibration / CALIBRATION_SD

    def verdict(self, where: dict[str, Any], undetectable: dict[str, str], notes: tuple[str, ...]) -> Verdict:
        """Return the verdict; `where`, `undetectable` and `notes` are passed through."""
        groups = self._groups()
        self.shares = self._shares(groups)
        said = self._said(groups)
        nothing = said in ("no_gap", "unknown")
        causes = [] if nothing and self.fault is None else self._causes()
        if self.fault is not None:
            # where the rest is no gap or unknown, the fault alone is named
            causes = [gross_cause(self.fault), *([] if nothing else causes)]
            said = {"no_gap": "explained", "unknown": "partly_explained"}.get(said, said)
        closure = self.closure
        return Verdict(
            verdict=said,
            sentence="",
            causes=tuple(causes),
            credible_sets=self._credible_sets(() if nothing else groups),
            indistinguishable=() if nothing else tuple(tuple(group) for group in groups if len(group) > 1),
            undetectable=undetectable,
            where=where,
            closure=self._closure_said(),
            # a fix is for a gap whose cause is known: where a rest is left, the rest may be what the fix imitates
            recommended=said == "explained"
            and all(cause.probability >= SURE for cause in causes)
            and closure.fraction is not None
            and closure.fraction >= CLOSES
            and closure.ci95 is not None
            and closure.ci95[0] > 0.5 * CLOSES,
            next_runs=(),
            notes=(*self.s.notes, *notes),
            noise={"dof": self.noise.dof, "scales": self.noise.scales},
            probabilities=self.effect_probabilities(),
            campaign=self.campaign.name,
            simulated=self.campaign.simulated,
        )

    def _said(self, groups: list[list[str]]) -> str:
        """Return which of the five verdicts it is, a gross fault left aside."""
        closure, chosen = self.closure, self.chosen
        named = (*chosen.effects, *self.calibration)
        if self.gap_probability() < DETECTION:
            return "no_gap"
        if not named:
            sure = self.denied or self._probability(lambda h: h.unknown) >= UNKNOWN
            return "unknown" if sure else "no_gap"
        rest = chosen.unknown or self.denied
        if rest and (closure.fraction is None or closure.fraction < 0.3):
            return "unknown"
        if closure.ci95 is not None and closure.ci95[1] < CLOSES:
            return "partly_explained" if closure.ci95[0] > 0.3 else "unknown"
        if rest or self.imitation() >= 0.5 or self._rest_left():
            return "partly_explained"
        return "ambiguous" if any(len(group) > 1 for group in groups) else "explained"

    def imitation(self) -> float:
        """Return the probability that the named causes together imitate one outside the library."""
        return float(np.interp(len(self.chosen.effects) + 0.5 * len(self.calibration), *IMITATION))

    def _rest_left(self) -> bool:
        """Return whether the named causes leave more of the gap, on held-out runs, than an explanation may."""
        return self.closure.fraction is not None and self.closure.fraction < EXPLAINS

    def _shares(self, groups: list[list[str]]) -> dict[str, float]:
        """Return what each calibration parameter keeps of its probability beside the effects that look like it.

        Those effects were projected out of the search, so that only their prior odds speak for them.
        """
        made = {}
        for group in groups:
            ours = [name for name in group if name in NAMES and name in self.calibration]
            if ours and group[0] in ours:
                others = len(group) - len(ours)
                made.update(dict.fromkeys(ours, PRIOR / (PRIOR + self.settings.prior_effect * others)))
        return made

    def gap_probability(self) -> float:
        """Return the probability that anything at all is off."""
        nothing = self._probability(lambda h: not h.effects and not h.unknown)
        for subset, p in zip(self.recalibration.subsets, self.recalibration.probabilities, strict=True):
            if not subset:
                return 1.0 - nothing * float(p)
        return 1.0

    def effect_probabilities(self) -> dict[str, float]:
        """Return the probability of each effect being at work, and that of an unknown cause, largest first."""
        made: dict[str, float] = {"unknown": self._probability(lambda h: h.unknown)}
        for h, p in zip(self.found.hypotheses, self.probabilities, strict=True):
            for name in h.effects:
                made[name] = made.get(name, 0.0) + float(p)
        for name in NAMES:
            if name in self.effects:
                made[name] = self.recalibration.probability(name) * self.shares.get(name, 1.0)
        unknown = made.pop("unknown")
        if self.chosen.effects and self._rest_left():
            unknown = max(unknown, REST)
        sure = 1.0 - self.imitation()
        made = {name: value * (1.0 - DOUBT * unknown) * sure for name, value in made.items()}
        made["unknown"] = 1.0 - (1.0 - unknown) * sure
        if self.fault is not None:
            made[self.fault.effect.id] = 1.0
        return {k: v for k, v in sorted(made.items(), key=lambda item: -item[1]) if v > 1e-4 or k == "unknown"}

    def _probability(self, what: Callable[[Hypothesis], bool]) -> float:
        return float(sum(p for h, p in zip(self.found.hypotheses, self.probabilities, strict=True) if what(h)))

    def _contribution(self, form: Form, theta: FloatArray) -> FloatArray:
        made: FloatArray = self.bench.columns(form) @ (theta / form.typical)
        return made

    def _calibration_contribution(self, names: Sequence[str]) -> FloatArray:
        made = np.zeros(len(self.bench.gap))
        for name in names:
            k = NAMES.index(name)
            made += self.per_unit @ DIRECTIONS[k] * self.recalibration.values[k]
        return made

    def _groups(self) -> list[list[str]]:
        """Return, for each named effect, the group that these runs cannot tell it from (itself first)."""
        fitted = self.chosen.fitted
        named = (*self.chosen.effects, *self.calibration)
        forms = self.found.forms
        groups = []
        for form, theta in zip(fitted.forms, fitted.theta, strict=True):
            rest = [self.bench.calibration]
            rest += [3.0 * self.bench.columns(f) for f in fitted.forms if f is not form]
            nuisance = Nuisance.of(np.concatenate(rest, axis=1))
            near = aliases_of(self.bench, nuisance, self._contribution(form, theta), forms, named)
            alike = self._as_likely(form.effect)
            near.update({name: NEAR for name in alike if name not in near and name not in named})
            groups.append([form.effect, *sorted(near, key=lambda n: near[n])])
        beside = [self.bench.calibration[:, 3:], *(3.0 * self.bench.columns(f) for f in fitted.forms)]
        if len(self.calibration) > 1:
            # one cause may look like two calibration parameters off at once (counts lost on one wheel)
            nuisance = Nuisance.of(np.concatenate(beside, axis=1))
            near = aliases_of(self.bench, nuisance, self._calibration_contribution(self.calibration), forms, named)
            if near:
                return [*groups, [*self.calibration, *sorted(near, key=lambda n: near[n])]]
        offered = forms | {n: e.forms(self.s) for n, e in self.effects.items() if e.calibration}
        for name in self.calibration:
            others = []
            for other, direction in zip(NAMES, DIRECTIONS, strict=True):
                if other != name:
                    way = (self.per_unit @ direction)[:, None]
                    # one that was not found to be off may be off by what would not have been found
                    unseen = NEAR / max(float(np.sqrt((way**2).sum())), 1e-12)
                    others.append(way * (0.03 if other in self.calibration else unseen))
            nuisance = Nuisance.of(np.concatenate([*beside, *others], axis=1))
            near = aliases_of(self.bench, nuisance, self._calibration_contribution([name]), offered, named)
            groups.append([name, *sorted(near, key=lambda n: near[n])])
        return groups

    def _as_likely(self, effect: str) -> list[str]:
        """Return the effects that, put in the place of one of the best hypothesis, are nearly as likely."""
        best = self.chosen
        rest = tuple(name for name in best.effects if name != effect)
        made = []
        for h in self.found.hypotheses:
            if h.unknown == best.unknown and h.log_weight > best.log_weight - LIKELY_NATS:
                instead = [name for name in h.effects if name not in rest]
                if len(h.effects) == len(best.effects) and len(instead) == 1 and instead[0] != effect:
                    made += instead
        return made

    def _causes(self) -> list[Cause]:
        from scipy.special import stdtrit

        fitted = self.chosen.fitted
        k = float(stdtrit(max(self.noise.dof, 3.0), 0.975))
        free = max(len(self.bench.gap) - len(fitted.parameters) - 4, 1)
        inflate = float(np.sqrt(max(1.0, fitted.chi_square / free)))
        before = rows(self.nominal, self.noise, residuals(self.nominal, self.nominal)[:, :, None])[:, 0]
        excess = max(float(before @ before) - len(before), 1.0)
        explained = float(np.clip(1.0 - max(fitted.chi_square - len(before), 0.0) / excess, 0.0, 1.0))
        nuisance = Nuisance.of(self.bench.calibration)
        probability = self.effect_probabilities()

        def cause(name: str, form: Form, theta: FloatArray, sd: FloatArray, way: FloatArray, signal: float) -> Cause:
            spread = sd * inflate
            quantities = {
                p.name: Quantity(float(v), (float(v - k * u), float(v + k * u)), p.unit)
                for p, v, u in zip(form.parameters, theta, spread, strict=True)
            }
            sizes = zip(form.parameters, theta, spread, strict=True)
            times = max((abs(v) - 2 * u) / p.largest for p, v, u in sizes)
            effect = self.effects[name]
            remark = f"{times:.2g} times what is physically plausible: suspect {effect.implausible}"
            return Cause(
                effect=name,
                title=effect.title,
                form=form.label,
                probability=probability.get(name, 0.0),
                share=float(way @ way),
                signal=signal,
                parameters=quantities,
                plausible=bool(times <= 1.0),
                remark="" if times <= 1.0 else remark,
                settings=form.settings,
            )

        made = []
        spreads = size_spreads(self.bench, fitted, self.settings.tolerance)
        for form, theta, sd in zip(fitted.forms, fitted.theta, spreads, strict=True):
            way = self._contribution(form, theta)
            signal = float(np.sqrt(nuisance.scalar(way[:, None], way[:, None])[0, 0]))
            made.append(cause(form.effect, form, theta, sd, way, signal))
        for name in self.calibration:
            i = NAMES.index(name)
            form = self.effects[name].forms(self.s)[0]
            value, sd = self.recalibration.values[[i]], self.recalibration.sd[[i]]
            way = self._calibration_contribution([name])
            made.append(cause(name, form, value, sd, way, float(self.recalibration.signal[i])))
        strongest = max((c.signal for c in made), default=0.0)
        made = [
            replace(c, probability=c.probability * (WEAKENED if c.signal < WEAK * strongest else 1.0)) for c in made
        ]
        # what the named causes explain together is divided by their squares
        total = max(sum(c.share for c in made), 1e-12)
        made = [replace(c, share=explained * c.share / total) for c in made]
        return sorted(made, key=lambda c: (-round(c.probability, 2), -c.signal))

    def _credible_sets(self, groups: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
        """Return the most probable sets of causes that together hold 95 %, and what could stand in for the best."""
        weights: dict[tuple[str, ...], float] = {}
        gross = () if self.fault is None else (self.fault.effect.id,)
        for h, p in zip(self.found.hypotheses, self.probabilities, strict=True):
            for subset, q in zip(self.recalibration.subsets, self.recalibration.probabilities, strict=True):
                known = tuple(name for name in subset if name in self.effects)
                unknown = h.unknown or len(known) < len(subset)
                key = (*gross, *h.effects, *known, *(("unknown",) if unknown else ()))
                weights[key] = weights.get(key, 0.0) + float(p * q)
        made, total = [], 0.0
        for key, weight in sorted(weights.items(), key=lambda item: -item[1]):
            made.append(key)
            total += weight
            if total >= 0.95:
                break
        for group in groups:
            held = [name for name in group if name in made[0]]
            for other in group:
                instead = tuple(sorted({other, *(name for name in made[0] if name not in held)}))
                if other not in made[0] and instead not in made:
                    made.append(instead)
        return tuple(made)

    def _closure_said(self) -> dict[str, Any]:
        closure = self.closure
        on = self.s.usable

        def rms(values: FloatArray) -> float | None:
            pose = on[:, 1] & on[:, 2]
            if pose.any():
                return float(np.sqrt(np.mean(values[pose, 1] ** 2 + values[pose, 2] ** 2)))
            if on[:, 0].any():
                return float(np.sqrt(np.mean(values[on[:, 0], 0] ** 2)))
            return None

        return {
            "before_rms_m": rms(closure.before),
            "after_rms_m": rms(closure.after),
            "floor_rms_m": rms(closure.floor),
            "fraction": closure.fraction,
            "ci95": None if closure.ci95 is None else list(closure.ci95),
            "held_out": closure.held_out,
            "by_channel": dict(closure.by_channel),
        }
