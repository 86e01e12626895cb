"""What this lab's data would find, and how often wrongly, by planting and diagnosing."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign, Logs
from calib.challenge.judge import Answer, answer_of
from calib.challenge.own_plants import Plant, Size, parse_sizes, plants_of
from calib.challenge.own_replay import OwnNoise, Replay, own_noise
from calib.challenge.score import clopper_pearson
from calib.challenge.seal import each
from calib.documents import plain
from calib.errors import RefusedError
from calib.gap.diagnose import diagnose_in_full
from calib.gap.observations.arrays import Observations
from calib.types import FloatArray, Progress, grouped, silent

FORMAT: Final = "calib-challenge-own/1"
#: largest share of false alarms, or wrong names
ALLOWED: Final = 0.05


@dataclass(frozen=True, slots=True)
class Own:
    """What a lab's own data would find."""

    campaign: str
    simulated: bool  #: whether its data were made by a program
    own_verdict: str  #: of the campaign as it is
    #: runs, units of the diagnosis, and those whose noise repeats give
    runs: int
    units: int
    units_with_repeats: int
    found: tuple[Plant, ...]
    empty: tuple[Answer, ...]  #: on campaigns with nothing planted
    left_out: Mapping[str, str]
    #: diagnoses, and those in time
    asked: int
    done: int
    seed: int
    seconds: float

    @property
    def raised(self) -> int:
        """False alarms."""
        return sum(answer.seen for answer in self.empty)

    @property
    def wrong(self) -> int:
        """Wrong names."""
        return sum(found.times("wrong") for found in self.found)

    @property
    def planted(self) -> int:
        """Planted campaigns."""
        return sum(len(found.answers) for found in self.found)

    @property
    def trusted(self) -> bool:
        """Whether neither is surely more than `ALLOWED`."""
        counts = (self.raised, len(self.empty)), (self.wrong, self.planted)
        return all(clopper_pearson(*count)[0] <= ALLOWED for count in counts)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        tables = {
            name: grouped((plant.effect, plant) for plant in self.found if plant.outside == outside)
            for name, outside in (("effects", False), ("outsiders", True))
        }
        low, high = clopper_pearson(self.raised, len(self.empty))
        return {
            "format": FORMAT,
            "campaign": self.campaign,
            "simulated": self.simulated,
            "own_verdict": self.own_verdict,
            **plain(tables),
            "false_alarms": {"tried": len(self.empty), "raised": self.raised, "ci95": [low, high]},
            "wrong": {"planted": self.planted, "wrong": self.wrong},
            "trusted": self.trusted,
            "not_planted": dict(self.left_out),
            "noise": {"runs": self.runs, "units": self.units, "units_with_repeats": self.units_with_repeats},
            "asked": self.asked,
            "done": self.done,
            "seed": self.seed,
            "seconds": round(self.seconds, 1),
        }


#: sizes by default: hardly seen, seen, strong
SIZES: Final = parse_sizes("5s,10s,25s")
#: empty campaigns for each round of plants
EMPTY_EACH: Final = 4
#: what is planted, or nothing, and which time it is
_Job = tuple[Plant | None, int]


def challenge_own(
    campaign: Campaign,
    effects: Sequence[str] = (),
    sizes: Sequence[Size] = SIZES,
    *,
    planted: int = 5,
    workers: int = 2,
    seconds: float = 900.0,
    seed: int = 0,
    progress: Progress = silent,
) -> Own:
    """Plant known effects on a campaign's own noise and route, and diagnose each; see `OwnNoise`.

    Parameters
    ----------
    campaign : Campaign
        Runs with logs.
    effects : sequence of str
        Also outside causes; empty: all that the campaign can show.
    sizes : sequence of Size
        How large each is planted.
    planted : int
        How often each at each size.
    workers : int
        Processes of this machine.
    seconds : float
        Then no further diagnosis begins; each size is planted once before any is twice.
    seed : int
        Of all that is drawn.
    progress : Progress
        Told the diagnoses done.
    """
    began = time.monotonic()
    diagnosis = diagnose_in_full(campaign, seed=seed, plan=False)
    # a cause of no library was found before the search: a blunder
    if {cause.effect for cause in diagnosis.causes} - {effect.id for effect in diagnosis.effects}:
        raise RefusedError(
            f"{campaign.name}: the counters have a blunder ({diagnosis.sentence}); expected counts "
            "that are right to a few per cent; correct the campaign's encoder settings first"
        )
    observations = diagnosis.observations
    plants, left_out = plants_of(diagnosis, Replay.of(observations), effects, sizes, np.random.default_rng(seed))
    jobs: list[_Job] = []
    for turn in range(planted):
        jobs += [(None, turn * EMPTY_EACH + number) for number in range(EMPTY_EACH)]
        jobs += [(plant, turn) for plant in plants]
    progress(0, len(jobs), "diagnoses")
    # logs are in the observations; without them a campaign is quick to hand over
    light = replace(campaign.included(), logs=Logs.empty(len(campaign.included().runs)))
    noise = own_noise(observations, diagnosis.fitted.left, diagnosis.noise.covariance)
    simulated = observations.simulated
    readings = np.where(np.isfinite(simulated), simulated, diagnosis.nominal.reading)
    work = partial(_diagnosed, light, observations, readings, noise, seed, began + seconds)
    answers = each(work, jobs, workers, lambda done: progress(done, len(jobs), "diagnoses"))
    by_plant = grouped((plant, answer) for (plant, _), answer in zip(jobs, answers, strict=True) if answer is not None)
    return Own(
        campaign=campaign.name,
        simulated=campaign.simulated,
        own_verdict=diagnosis.kind.value,
        runs=len(light.runs),
        units=len(observations),
        units_with_repeats=int(noise.repeated.sum()),
        found=tuple(replace(plant, answers=tuple(by_plant.get(plant, ()))) for plant in plants),
        empty=tuple(by_plant.get(None, ())),
        left_out=left_out,
        asked=len(jobs),
        done=sum(answer is not None for answer in answers),
        seed=seed,
        seconds=time.monotonic() - began,
    )


def _diagnosed(
    campaign: Campaign,
    observations: Observations,
    readings: FloatArray,
    noise: OwnNoise,
    seed: int,
    until_s: float,
    job: _Job,
) -> Answer | None:
    if time.monotonic() > until_s:
        return None
    plant, turn = job
    effect, family, key = "", "", 0
    if plant is not None:
        readings, key = readings + plant.changes[turn % len(plant.changes)], plant.key
        effect, family = ("", "") if plant.outside else (plant.effect, plant.family)
    drawn = noise.draw(np.random.default_rng([abs(seed), key, turn]))
    observed = _observed(observations, readings, drawn)
    try:
        verdict = diagnose_in_full(campaign, seed=turn, plan=False, observations=observed)
    except RefusedError:
        return answer_of(effect, family, {"verdict": "undecided"})
    return answer_of(effect, family, verdict.to_dict())


def _observed(observations: Observations, readings: FloatArray, drawn: FloatArray) -> Observations:
    measured = readings + drawn
    # along and lateral are noise in the frame of the heading that is measured
    heading = np.where(observations.usable[:, 3], measured[:, 3], readings[:, 3])
    cos, sin = np.cos(heading), np.sin(heading)
    measured[:, 1] = readings[:, 1] + cos * drawn[:, 1] - sin * drawn[:, 2]
    measured[:, 2] = readings[:, 2] + sin * drawn[:, 1] + cos * drawn[:, 2]
    return replace(observations, measured=np.where(observations.usable, measured, np.nan))
