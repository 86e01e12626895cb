"""Known manipulations on recorded data: ``python -m tests.real.plants FOLDER [name ...]`` prints the table."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign
from calib.challenge.judge import UNRELATED_FAMILIES
from calib.gap.diagnose import diagnose_in_full
from calib.gap.effects.library import effect_class
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import predict, residuals
from calib.plant.signal import CALIBRATION, strength
from calib.types import FloatArray
from tests.real import recordings
from tests.real.manipulations import CORRIDOR, POSES, Manipulation

__all__ = ["BASES", "Outcome", "calibrated", "outcome_of", "table", "totals"]

#: recording -> (campaign of its folder, manipulations)
BASES: Final[dict[str, tuple[Callable[[Path], Campaign], tuple[Manipulation, ...]]]] = {
    "optiodom/diff": (recordings.optiodom_differential, POSES),
    "khepera_lstraight": (lambda folder: recordings.khepera(folder, "lstraight", tuples_per_run=20), POSES),
    "straightline_laser": (recordings.straight_line, CORRIDOR),
}
#: what a recording has beside anything planted, by its own publication: forward 0.94109, backward 0.93781 of nominal
#: (tests/campaign/test_straightline.py)
OWN: Final = {"straightline_laser": frozenset({"travel_direction"})}
#: a planted effect that shows so strongly is never answered by `no_gap`
STRONG: Final = 20.0
#: of stated probabilities
BINS: Final = (0.0, 0.5, 0.8, 0.95, 1.01)


@dataclass(frozen=True)
class Outcome:
    """How one manipulation was answered.

    Parameters
    ----------
    recording, name : str
        What was done to what; an empty name is the recording as it is, calibrated.
    signal : float
        How strongly it shows beside the noise that the diagnosis gives the recording.
    verdict : str
        The verdict's word.
    named : tuple of str
        Causes, likeliest first.
    recommended, found, wrong : bool
        A fix is recommended; the manipulation or its family is named first (of an outside one: a rest is left open);
        what is named first is neither, nor what the recording has as it is.
    intervals : tuple of (str, float, float, float)
        Parameter, truth, low, high.
    outside : bool
        No effect of the library says it: a fix of it would be wrong.
    stated : tuple of (float, bool)
        Probability of each named cause that the recording does not have of its own, and whether it is the planted one
        or tied with it.
    beside_own : bool
        As `found`, causes that the recording has of its own set aside: these are true, and may be larger.
    """

    recording: str
    name: str
    signal: float
    verdict: str
    named: tuple[str, ...]
    recommended: bool
    found: bool
    wrong: bool
    intervals: tuple[tuple[str, float, float, float], ...]
    outside: bool = False
    stated: tuple[tuple[float, bool], ...] = ()
    beside_own: bool = False


def calibrated(campaign: Campaign) -> tuple[Campaign, dict[str, Any], FloatArray]:
    """Return a recording judged against radii and track fitted to it, its verdict, and the covariance of its noise.

    What is left is the recording's own rest and noise.
    """
    diagnosis = diagnose_in_full(campaign, plan=False)
    left, right, track = diagnosis.fitted.calibration[:3]
    model = replace(
        campaign.model,
        radius_left_m=campaign.model.radius_left_m * (1 + left),
        radius_right_m=campaign.model.radius_right_m * (1 + right),
        track_m=campaign.model.track_m * (1 + track),
    )
    base = replace(campaign, model=model)
    again = diagnose_in_full(base, plan=False)
    # what the recording has beside radii and track, named with these off or with these right
    beside = [cause.effect for cause in diagnosis.causes if cause.effect not in CALIBRATION]
    run_id = observations_of(base).labels["run_id"]
    # a run that is omitted weighs nothing
    covariance = np.broadcast_to(1e12 * np.eye(6), (len(run_id), 6, 6)).copy()
    covariance[~np.isin(run_id, list(again.arrays.situation.omitted))] = again.noise.covariance
    return base, again.to_dict() | {"beside": beside}, covariance


def _family(effect: str) -> str:
    family = effect_class(effect).family.value
    return "" if family in UNRELATED_FAMILIES else family


def outcome_of(
    recording: str, base: Campaign, own: dict[str, Any], covariance: FloatArray, manipulation: Manipulation
) -> Outcome:
    """Manipulate a calibrated recording, diagnose it, and hold the verdict against what was done."""
    struck = manipulation.change(base)
    verdict = diagnose_in_full(struck, plan=False).to_dict()
    causes = verdict["causes"]
    named = tuple(cause["effect"] for cause in causes)
    groups = [set(group) for group in verdict["indistinguishable"]]
    truth = set(manipulation.truth)
    families = {_family(effect) for effect in truth} - {""}

    def right(effect: str) -> bool:
        tied = any(effect in group and group & truth for group in groups)
        return effect in truth or _family(effect) in families or tied

    own_causes = {cause["effect"] for cause in own["causes"]} | {*own["beside"]} | OWN.get(recording, frozenset())
    others = [effect for effect in named if effect in truth or effect not in own_causes]
    beside_own = bool(others) and right(others[0]) and not manipulation.both
    if not truth:
        found = verdict["verdict"] in ("unknown", "partly_explained", "ambiguous")
        wrong = bool(verdict["recommended"])
    else:
        found = bool(named) and right(named[0]) and (not manipulation.both or truth <= {*named, *set().union(*groups)})
        before = {cause["effect"] for cause in own["causes"]} | OWN.get(recording, frozenset())
        silent = verdict["verdict"] in ("unknown", "no_gap", "undecided")
        wrong = bool(named) and not silent and not right(named[0]) and named[0] not in before
    intervals = []
    for key, value in manipulation.parameters.items():
        effect, _, parameter = key.partition(".")
        for cause in causes:
            given = cause["parameters"].get(parameter, {}).get("ci95") if cause["effect"] == effect else None
            if given and None not in given:
                intervals.append((key, value, float(given[0]), float(given[1])))
    stated = tuple(
        (float(cause["probability"]), right(cause["effect"]))
        for cause in causes
        if cause["effect"] not in own_causes or cause["effect"] in truth
    )
    signal = _signal(base, struck, covariance, free=not truth & set(CALIBRATION))
    return Outcome(
        recording, manipulation.name, signal, verdict["verdict"], named, bool(verdict["recommended"]), found, wrong,
        tuple(intervals), not truth, stated, found or beside_own,
    )  # fmt: skip


def _signal(base: Campaign, struck: Campaign, covariance: FloatArray, *, free: bool) -> float:
    """Return the whitened norm of what a manipulation does to the gap, a recalibration projected out where `free`."""
    before, after = (predict(observations_of(campaign)) for campaign in (base, struck))
    if len(before.s) != len(after.s):
        return float("nan")
    change = residuals(after, after) - residuals(before, before)
    change = np.where(before.s.usable & after.s.usable, change, np.nan)
    return strength(change, covariance, before.calibration[:, :, :3] if free else None)


def _base_of(job: tuple[str, str]) -> tuple[str, Campaign, dict[str, Any], FloatArray]:
    name, folder = job
    return (name, *calibrated(BASES[name][0](Path(folder))))


def _one(job: tuple[str, Campaign, dict[str, Any], FloatArray, int]) -> Outcome:
    name, base, own, covariance, number = job
    return outcome_of(name, base, own, covariance, BASES[name][1][number])


def table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the table, a line each."""
    lines = []
    for each in outcomes:
        mark = "found" if each.found else "WRONG" if each.wrong else "missed"
        interval = "".join(
            f" {name}={truth:.3g} in [{low:.3g}, {high:.3g}] {'holds' if low <= truth <= high else 'FAILS'}"
            for name, truth, low, high in each.intervals
        )
        fix = " fix" if each.recommended else ""
        lines.append(
            f"{each.recording:20} {each.name:34} {each.signal:7.1f} {mark:7} {each.verdict}{fix}: "
            f"{', '.join(each.named)}{interval}"
        )
    return lines


def totals(outcomes: Sequence[Outcome]) -> dict[str, tuple[int, int]]:
    """Return (hits, of how many) of each figure to show."""
    # of what no library holds, the right answer is a rest without a fix
    found = [each for each in outcomes if each.found and not each.outside]
    strong = [each for each in outcomes if each.signal >= STRONG]
    intervals = [interval for each in outcomes for interval in each.intervals]
    return {
        "first or in its family": (sum(each.found for each in outcomes), len(outcomes)),
        "the same, the recording's own causes set aside": (sum(each.beside_own for each in outcomes), len(outcomes)),
        "wrong": (sum(each.wrong for each in outcomes), len(outcomes)),
        "recommended where right": (sum(each.recommended for each in found), len(found)),
        "recommended where wrong": (sum(each.recommended for each in outcomes if each.wrong), len(outcomes)),
        "no_gap at a signal of 20 and more": (sum(each.verdict == "no_gap" for each in strong), len(strong)),
        "intervals that hold": (sum(low <= truth <= high for _, truth, low, high in intervals), len(intervals)),
    }


def bins(outcomes: Sequence[Outcome]) -> list[str]:
    """Return how often causes stated at a probability were the planted ones, a line each bin."""
    stated = np.array([pair for each in outcomes for pair in each.stated]).reshape(-1, 2)
    lines = []
    for low, high in pairwise(BINS):
        inside = stated[(stated[:, 0] >= low) & (stated[:, 0] < high)]
        if len(inside):
            mean, true = inside.mean(axis=0)
            lines.append(f"stated {low:.2f} to {min(high, 1.0):.2f}: mean {mean:.2f}, true {true:.2f} of {len(inside)}")
    return lines


def main(folder: str, names: Sequence[str]) -> None:
    """Print the table of every recording named, and the totals."""
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for name, base, own, covariance in pool.map(_base_of, [(name, folder) for name in names or BASES]):
            before = ", ".join(cause["effect"] for cause in own["causes"])
            fix = ", a fix recommended" if own["recommended"] else ""
            sys.stdout.write(f"{name}, calibrated, nothing planted: {own['verdict']}: {before}{fix}\n")
            sys.stdout.flush()
            jobs = [(name, base, own, covariance, number) for number in range(len(BASES[name][1]))]
            for outcome in pool.map(_one, jobs):
                outcomes.append(outcome)
                sys.stdout.write(table([outcome])[0] + "\n")
                sys.stdout.flush()
    for name, (hits, total) in totals(outcomes).items():
        sys.stdout.write(f"{name}: {hits} of {total}\n")
    sys.stdout.write("".join(f"{line}\n" for line in bins(outcomes)))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "../shared/data", sys.argv[2:])
