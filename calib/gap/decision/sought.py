"""What was driven: single runs that are off by themselves omitted, blunders of encoders and mounting corrected."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import numpy as np

from calib.campaign.check import implausible, notes_for_results
from calib.campaign.model import Campaign
from calib.campaign.settings import OdometryModel
from calib.coefficients.sections import EffectSection
from calib.errors import BadInputError, RefusedError
from calib.gap.decision import chance_of_order
from calib.gap.decision.confounding import calibrated
from calib.gap.decision.diagnosis import Situation
from calib.gap.effects import Effect, forms_on
from calib.gap.effects.encoder import (
    BAD_RUN_RATIO,
    BLUNDER_MISFIT,
    BLUNDER_RESIDUAL_SHARE,
    MOST_BAD_RUNS,
    Blunder,
    EncoderBlunder,
    bad_runs,
    corrected,
    find_blunder,
    misfit,
)
from calib.gap.effects.library import with_effects
from calib.gap.effects.mounting import RESTATED, Mounting, Restated, TurnedReference, find_turned
from calib.gap.effects.reference import ReferenceYaw
from calib.gap.effects.simulator import as_simulated
from calib.gap.effects.steering import steering_blunder
from calib.gap.inference import CERTAIN_PROBABILITY, EVEN_PROBABILITY, FALSE_REJECTION, LOG_EVIDENCE_WINDOW
from calib.gap.inference.fit import CALIBRATION_SD, Fitted, fit, recalibrate, squares_by_unit, whitened, whitened_rows
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.observations import Channel, Observations
from calib.gap.observations.from_campaign import check_distances, observations_of
from calib.gap.predict import Path, measured_gap, predict, residuals
from calib.types import BoolArray, FloatArray, IntArray

#: fits about a sensor's place and delay found, two settle one; a step below so many standard uncertainties is the last
PLACE_PASSES: Final = 8
CLOSE: Final = 0.1
#: windows most like another: where a tenth is off, three of four are by chance in 4 of 1,000
ALIKE: Final = 4
#: headings that agree with the counts within this share of their standard uncertainty, on so many runs, one turning by
#: so much, are the odometry's
COPIED_SHARE: Final = 1e-6
FEWEST_COPIED: Final = 4
LEAST_TURN_RAD: Final = 1e-2


@dataclass(frozen=True, slots=True)
class Sought:
    """What a campaign is compared with, and how it is cut."""

    model: OdometryModel | None
    applied: Sequence[EffectSection]
    exclude: tuple[str, ...]
    into_windows: bool | None = None
    without: Collection[tuple[str, int]] = ()  #: see `observations_of`

    def situation(self, campaign: Campaign) -> Situation:
        """Return what was driven, blunders of the reference's mounting and of the encoders corrected."""
        observations, notes = self._observed(campaign, self.applied)
        nominal = predict(observations)
        bare = predict(self._observed(campaign, ())[0]) if self.applied else nominal
        if turned := None if ReferenceYaw.id in self.exclude else find_turned(bare):
            return self._corrected(campaign, (turned,), measured_gap(nominal, nominal))
        if omitted := bad_runs(nominal):
            return replace(self.situation(without_runs(campaign, omitted)), omitted=omitted)
        return self.counted(campaign, observations, notes)

    def remounted(self, campaign: Campaign, before: Situation, mounted: Sequence[Mounting]) -> Situation:
        """Return the situation with the reference mounted so; the gap as first read is kept, window by window."""
        nominal = before.nominal
        as_read = measured_gap(nominal, nominal) if before.as_counted is None else before.as_counted
        after = self._corrected(campaign, mounted, as_read)
        path = after.nominal
        as_counted = _row_by_row(path, nominal, as_read, measured_gap(path, path))
        return replace(after, as_counted=as_counted, omitted=before.omitted)

    def mounted(
        self,
        campaign: Campaign,
        situation: Situation,
        searched: SearchResult,
        effects: Sequence[Effect],
        *,
        refine: bool,
    ) -> tuple[Mounting, ...]:
        """Return the reference's mounting where a search shows it otherwise than the situation has it, else nothing.

        Parameters
        ----------
        campaign, situation
            As given, and as searched.
        searched, effects
            Result of the search, and the library.
        refine
            Turn a turned reference further, by the angle found. Else its place or delay: of positions without headings
            the course depends on both, so that sizes are fitted about those last found.
        """
        known = tuple(fault for fault in situation.faults if isinstance(fault, Mounting))
        for form, theta, place in searched.fitted.each() if refine else ():
            if form.effect == ReferenceYaw.id and form.label == ReferenceYaw.OF_POSITION:
                sd_rad = float(np.sqrt(searched.fitted.covariance[place, place][0, 0]))
                if turned := [fault for fault in known if isinstance(fault, TurnedReference)]:
                    return (turned[0].refined(float(theta[0]), sd_rad),)
        likely = searched.inclusion()
        found = [
            kind(form.label, tuple(p.name for p in form.parameters), size, 0.0 * size, calibrated(likely[form.effect]))
            for form, size, _ in searched.fitted.each()
            if (kind := RESTATED.get((form.effect, form.label))) and likely[form.effect] > CERTAIN_PROBABILITY
        ]
        offered, best, least = {effect.id: effect for effect in effects}, tuple[Mounting, ...](), np.inf
        for chosen in (some for n in range(1, len(found) + 1) for some in combinations(found, n)):
            bent = np.sum([one.bent_rad(situation.observations) for one in chosen], axis=0)
            # what noise hides needs no other course
            if (np.abs(bent) > situation.observations.sigma[:, [Channel.HEADING]]).any():
                mounted, misfit = self._settled(campaign, (*known, *chosen), searched, offered)
                shown = tuple(fault for fault in mounted if not isinstance(fault, Restated) or fault.is_shown)
                # a further one has to pay for itself
                misfit += 2.0 * LOG_EVIDENCE_WINDOW * (len(shown) - len(known))
                if misfit < least and len(shown) > len(known):
                    best, least = shown, misfit
        return best

    def _settled(
        self, campaign: Campaign, mounted: tuple[Mounting, ...], searched: SearchResult, effects: dict[str, Effect]
    ) -> tuple[tuple[Mounting, ...], float]:
        # and - 2 log likelihood of what is left, each channel at its own level
        for _ in range(PLACE_PASSES):
            path = predict(self._observed(_with(campaign, mounted), self.applied)[0])
            restated = {fault.effect.id: fault.label for fault in mounted if isinstance(fault, Restated)}
            plain = [form for name in restated for form in effects[name].forms(path.s) if form.label == restated[name]]
            others = [form for form in searched.fitted.forms if form.effect not in restated]
            forms = plain + [form for form in forms_on(path.s, effects, others) if form is not None]
            fitted = fit(path, estimate_noise(path, residuals(path, path)), forms)
            fitted = fit(path, estimate_noise(fitted.path, fitted.left), forms)
            spread = np.sqrt(np.diag(fitted.covariance))
            sizes = {form.effect: (size, spread[place]) for form, size, place in fitted.each()}
            mounted = tuple(one.moved(*sizes[one.effect.id]) if isinstance(one, Restated) else one for one in mounted)
            if all((np.abs(sizes[name][0]) < CLOSE * sizes[name][1]).all() for name in restated):
                break
        left = [fitted.left[use, k] for k, use in enumerate(path.s.usable.T) if use.any()]
        return mounted, float(sum(len(each) * np.log(np.mean(each**2)) for each in left))

    def _corrected(self, campaign: Campaign, mounted: Sequence[Mounting], as_read: FloatArray) -> Situation:
        campaign = _with(campaign, mounted)
        return self.counted(campaign, *self._observed(campaign, self.applied), tuple(mounted), as_read)

    def counted(
        self,
        campaign: Campaign,
        observations: Observations,
        notes: tuple[str, ...],
        faults: tuple[Mounting, ...] = (),
        as_counted: FloatArray | None = None,
    ) -> Situation:
        """Return the situation, a blunder of the encoders corrected.

        Parameters
        ----------
        campaign, observations, notes
            As observed.
        faults
            Of the reference's mounting, corrected in these.
        as_counted
            The gap as first read.
        """
        nominal = predict(observations)
        fault = None if EncoderBlunder.id in self.exclude else find_blunder(observations, nominal)
        if fault is None and (faults or float(np.mean(misfit(nominal))) < BLUNDER_MISFIT):
            return Situation(campaign, observations, notes, faults, as_counted)
        if as_counted is None:
            as_counted = measured_gap(nominal, nominal)
        if not faults and self._is_clockwise(campaign, fault):
            clockwise = TurnedReference(0.0, 0.0, clockwise=True)
            turned = clockwise.correct(campaign)
            return Situation(turned, *self._observed(turned, self.applied), (clockwise,), as_counted)
        if fault is None:
            return Situation(campaign, observations, notes, faults)
        right = corrected(observations, fault)
        if fault.swapped and not faults:
            # the same but for the sensor's place, and radii or loads that differ
            mirror = TurnedReference(0.0, 0.0, mirrored=True, clockwise=True)
            turned = mirror.correct(campaign)
            seen, mirror_notes = self._observed(turned, self.applied)
            by_mirror, by_counts = (
                recalibrate(path, estimate_noise(path, residuals(path, path))).chi_square
                for path in map(predict, (seen, right))
            )
            if by_mirror + 2.0 * LOG_EVIDENCE_WINDOW < by_counts:
                return Situation(turned, seen, mirror_notes, (mirror,), as_counted)
        return Situation(campaign, right, notes, (*faults, fault), as_counted)

    def _is_clockwise(self, campaign: Campaign, fault: Blunder | None) -> bool:
        # of closed paths only the course tells counts from headings of the other sense
        along = replace(self, into_windows=True)
        windows, turned = (
            along._observed(each, self.applied)[0]
            for each in (campaign, TurnedReference(0.0, 0.0, clockwise=True).correct(campaign))
        )
        by_counts = windows if fault is None else corrected(windows, fault)
        counted, clocked = (float(np.mean(misfit(predict(s)))) for s in (by_counts, turned))
        return windows.windowed and clocked < BLUNDER_RESIDUAL_SHARE * counted

    def _observed(self, campaign: Campaign, applied: Sequence[EffectSection]) -> tuple[Observations, tuple[str, ...]]:
        observations = observations_of(campaign, self.model, into_windows=self.into_windows, without=self.without)
        if np.isfinite(observations.simulated).any():
            observations = as_simulated(observations)
        if blunder := steering_blunder(observations):
            raise BadInputError(f"{campaign.name}: column steer_rad: {blunder}, then diagnose again")
        check_distances(campaign, observations)
        if not observations.usable.any():
            wrong = " ".join(note.sentence for note in implausible(campaign))
            needed = (
                "an end pose needs ref_x_m and ref_y_m together and a log where the path bends, or give distance_m or "
                "ref_theta_rad; positions of a log need units, counts and a zero of steer_rad that lead along them"
            )
            raise RefusedError(
                f"{campaign.name}: no run has a channel that can be compared with the simulation; {wrong or needed}"
            )
        data_notes = (*(note.sentence for note in implausible(campaign)), *notes_for_results(campaign))
        if not applied:
            return observations, data_notes
        changed, notes = with_effects(observations, applied, declared=campaign.extra.get("effects", ()))
        return changed, (*data_notes, *notes)


def _row_by_row(path: Path, other: Path, values: FloatArray, missing: FloatArray) -> FloatArray:
    # values (n_units, 6) of another path for the windows of this one; `missing` where it lacks one
    pairs = [zip(one.s.run.tolist(), one.s.window.tolist(), strict=True) for one in (path, other)]
    row = {pair: number for number, pair in enumerate(pairs[1])}
    rows = np.array([row.get(pair, -1) for pair in pairs[0]])
    return np.where((rows >= 0)[:, None] & np.isfinite(values[rows]), values[rows], missing)


def _with(campaign: Campaign, mounted: Sequence[Mounting]) -> Campaign:
    for fault in mounted:
        campaign = fault.correct(campaign)
    return campaign


def refuse_copied(campaign: Campaign, nominal: Path) -> None:
    """Raise BadInputError where the headings are those of the counts."""
    observations = nominal.s
    measured = observations.usable[:, Channel.HEADING]
    turned_rad = nominal.end[measured, 2] + residuals(nominal, nominal)[measured, Channel.HEADING]
    if measured.sum() < FEWEST_COPIED or np.abs(turned_rad).max() < LEAST_TURN_RAD:
        return
    travels_m = (observations.travel_left_m, observations.travel_right_m)
    ways_m = np.stack([np.bincount(observations.unit, one, len(observations))[measured] for one in travels_m], axis=1)
    off_rad = float(np.abs(turned_rad - ways_m @ np.linalg.lstsq(ways_m, turned_rad)[0]).max())
    stated_rad = float(np.min(observations.sigma[measured, Channel.HEADING]))
    if off_rad < COPIED_SHARE * stated_rad:
        raise BadInputError(
            f"{campaign.name}: column ref_theta_rad: found headings that agree with the counts within {off_rad:.1g} "
            f"rad on all {measured.sum()} runs, where their standard uncertainty is {1e3 * stated_rad:.2g} mrad; "
            "expected those of an instrument of its own: these were computed from the counts"
        )


def lone_run(situation: Situation) -> dict[str, float]:
    """Return the run, by id, its share off, that is three times as far off its nearest repeat as any other."""
    noise, observations = situation.noise, situation.observations
    if observations.windowed or situation.omitted or noise.dof <= 0.0:
        return {}
    whole, off = recalibrate(situation.nominal, noise), np.zeros(len(observations))
    left = np.where(observations.usable, whole.left / (noise.floor * np.sqrt(noise.weight)[:, None]), 0.0)
    for alike in (observations.condition == one for one in set(observations.condition)):
        # from the nearest: of a pair none is the one that is off
        near = [np.sort(np.square(left[alike] - one).sum(axis=1))[:2] for one in left[alike]]
        off[alike] = np.sqrt([squares[-1] for squares in near])
    return _named(whole, np.arange(len(off)), [run]) if (run := furthest(off)) >= 0 else {}


def furthest(off: FloatArray) -> int:
    """Return the number of what is three times as far off as all others, shape (n,); -1 without one."""
    number = int(np.argmax(off))
    return number if off[number] > BAD_RUN_RATIO * np.delete(off, number).max(initial=0.0) else -1


def lone_recordings(situation: Situation) -> dict[str, float]:
    """Return the few recordings, by id, each its share off, that are off by themselves.

    Outliers of a joint estimate that fits all others, else the one that is three times as far off as any other once
    these are recalibrated. Not the first or last that goes on where the others tend to, as tyres warm up.
    """
    from calib.kinematics.estimate import estimate_geometry

    nominal, noise, run_id = situation.nominal, situation.noise, situation.observations.labels["run_id"]
    runs, unit = np.unique(situation.observations.run, return_inverse=True)
    most, names = int(MOST_BAD_RUNS * len(runs)), [str(run_id[unit == number][0]) for number in range(len(runs))]
    try:
        geometry = estimate_geometry(situation.campaign)
        outliers = [names.index(name) for name in geometry.outliers if name in names]
        if geometry.passed and 0 < len(outliers) <= most:
            others = _by_others(nominal, noise, np.isin(unit, outliers))
            return {} if _go_on(others, noise, unit, outliers) else _named(others, unit, outliers)
    except RefusedError:
        pass

    def off(fitted: Fitted) -> FloatArray:
        squares = np.bincount(unit, squares_by_unit(nominal, noise, fitted.left))
        return np.sqrt(squares / np.fmax(np.bincount(unit, situation.observations.usable.sum(axis=1)), 1))

    worst = int(np.argmax(off(recalibrate(nominal, noise))))
    others = _by_others(nominal, noise, unit == worst)
    apart = most > 0 and furthest(off(others)) == worst
    return _named(others, unit, [worst]) if apart and not _go_on(others, noise, unit, [worst]) else {}


def lone_windows(situation: Situation) -> tuple[set[tuple[str, int]], dict[str, float]]:
    """Return few windows that noise cannot explain beside the others' radii, and the share of each off, by its time.

    Nothing where those most like one of them, in motion or in place, are off with it: no single reading's fault.
    """
    from scipy.special import fdtri

    from calib.kinematics.adequacy import FEW_OUTLIERS, OUTLIER_CHANCE

    nominal, noise, seen = situation.nominal, situation.noise, situation.observations
    rows, bad = seen.usable.sum(axis=1), np.zeros(0, bool)
    for _ in range(PLACE_PASSES):
        others = _by_others(nominal, noise, bad) if bad.any() else recalibrate(nominal, noise)
        level = estimate_noise(others.path, others.left)
        expected, most = (
            np.asarray(fdtri(np.maximum(rows, 1), max(level.dof, 3.0), chance))
            for chance in (0.5, 1.0 - OUTLIER_CHANCE / len(rows))
        )
        squares = squares_by_unit(nominal, level, others.left) / np.maximum(rows, 1)
        # the level holds those that are off; the median does not
        usual = min(float(np.median(squares / expected)), 1.0)
        before, bad = bad, (squares > usual * most) & seen.from_log
        if not bad.any() or bad.mean() > FEW_OUTLIERS:
            return set(), {}
        if np.array_equal(before, bad):
            break
    motion = np.stack([np.nan_to_num(seen.measured[:, Channel.HEADING]), seen.length_m], axis=1)
    for of in (motion, seen.start_pose[:, :2]) if seen.common_frame else (motion,):
        scaled = of / np.maximum(np.std(of, axis=0), 1e-12)
        apart = np.nan_to_num(np.linalg.norm(scaled[bad][:, None] - scaled, axis=2), nan=np.inf)
        apart[seen.run[bad][:, None] == seen.run] = np.inf
        if (bad[np.argsort(apart, axis=1)[:, :ALIKE]].mean(axis=1) > EVEN_PROBABILITY).any():
            return set(), {}
    ids, middle_s = seen.labels["run_id"].tolist(), 0.5 * (seen.start_s + seen.time_s[seen.starts[1:] - 1])
    off, lone = misfit(others.path), np.flatnonzero(bad)
    named = {f"{ids[k]} at {middle_s[k]:.3g} s": float(off[k]) for k in lone}
    return {(ids[k], int(seen.window[k])) for k in lone}, named


def _go_on(others: Fitted, noise: Noise, unit: IntArray, lone: Sequence[int]) -> bool:
    """Return whether the first or last recording is off by what the others have more and more of."""
    seen, last = others.path.s, int(unit.max())
    row = unit[np.nonzero(seen.usable)[0]]
    columns = whitened_rows(others.path, noise, others.path.calibration) * CALIBRATION_SD
    gap = whitened(others.path, noise, others.left)
    own = [(columns[row == k], gap[row == k]) for k in range(last + 1)]
    sizes = np.array([np.linalg.solve(c.T @ c + np.eye(c.shape[1]), c.T @ g) for c, g in own])
    for end in {0, last}.intersection(lone):
        lean = np.delete(sizes @ own[end][0].T @ (own[end][0] @ sizes[end]), lone)
        chance, rises = chance_of_order(lean)
        if chance < FALSE_REJECTION and rises == (end > 0):
            return True
    return False


def _by_others(nominal: Path, noise: Noise, mine: BoolArray) -> Fitted:
    weight = np.where(mine, 1e12, 1.0)[:, None, None]
    return recalibrate(nominal, replace(noise, covariance=noise.covariance * weight))


def _named(others: Fitted, unit: IntArray, numbers: Sequence[int]) -> dict[str, float]:
    off, run_id = misfit(others.path), others.path.s.labels["run_id"]
    return {str(run_id[unit == number][0]): float(off[unit == number].mean()) for number in numbers}


def without_runs(campaign: Campaign, omitted: Collection[str]) -> Campaign:
    """Return the campaign with these runs excluded, by id."""
    if not omitted:
        return campaign
    excluded = campaign.runs.excluded | np.isin(campaign.runs.label("run_id"), list(omitted))
    return replace(campaign, runs=replace(campaign.runs, excluded=excluded))
