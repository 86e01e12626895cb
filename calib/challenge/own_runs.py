"""Detection and false alarms on a lab's own data: known effects and outside causes are planted and diagnosed."""

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from calib.campaign.model import Campaign, Logs
from calib.challenge import each
from calib.challenge.cases import ONE_SIGN
from calib.challenge.judge import Answer, Plant, answer_of
from calib.challenge.own_replay import OUTSIDERS, OwnNoise, Replay, SizedAct, by_column, outsiders, own_noise
from calib.challenge.score import Share
from calib.documents import plain
from calib.errors import BadInputError, RefusedError
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.diagnose import diagnose_in_full
from calib.gap.observations import Observations
from calib.plant import Form, World, scaled
from calib.plant.effects import effects as plant_effects
from calib.plant.effects import forms_of
from calib.plant.signal import CALIBRATION, strength
from calib.types import FloatArray, Progress, grouped, silent

NOT_PLANTED: Final = {
    "encoder_gross": "a blunder is found before the search, by trial",
    "integration_scheme": "it is in the simulator, not in the vehicle",
    "path_weave": "it needs runs without logs",
}
#: share of an effect's signal that a recalibration leaves, below which it is not planted
ABSORBED: Final = 0.02
#: effects that calibrate a front wheel that alone drives the odometry
STEERED: Final = ("steering_zero", "steering_scale")
#: effects that only the front wheel shows
OF_THE_FRONT: Final = (*STEERED, "steering_backlash", "steering_delay", "drive_slip")
#: largest change of an end by a planted effect: share of the path, and heading
LARGEST_SHARE, LARGEST_RAD = 0.2, 1.0
_SIZE: Final = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*([sx]?)\s*")
_RELATIVE_STEP: Final = 1e-4


#: how large an effect is planted; ``s``: a signal; ``x``: times the typical size; empty: in the effect's unit
Size = tuple[float, str]


def parse_sizes(text: str) -> tuple[Size, ...]:
    """Return sizes such as ``10s,2x,0.01``; see `Size`."""
    sizes = []
    for part in text.split(","):
        match = _SIZE.fullmatch(part)
        if match is None or float(match[1]) == 0.0:
            raise BadInputError(
                f"sizes: found {part.strip()!r:.40}; expected numbers separated by commas, each as 10s (a "
                "signal of 10), 2x (twice the typical size) or 0.01 (in the effect's unit); write them so"
            )
        sizes.append((float(match[1]), match[2]))
    return tuple(sizes)


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    effect: str
    act: SizedAct
    typical: float = 5e-4
    form: str = "plain"
    unit: str = "1/sd"
    family: str = ""
    outside: bool = False


def plants_of(
    diagnosis: Diagnosis, replay: Replay, wanted: Sequence[str], sizes: Sequence[Size], rng: np.random.Generator
) -> tuple[list[Plant], dict[str, str]]:
    """Return what is planted, and why others are not; see `Plant`.

    `wanted`: effects and outside causes, empty: all; BadInputError where one is unknown.
    """
    candidates, left_out = _candidates(diagnosis, replay, rng)
    known = {*left_out, *(candidate.effect for candidate in candidates)}
    for name in wanted:
        if name not in known:
            raise BadInputError(f"effect {name!r} found; expected one of {', '.join(sorted(known))}; name one of these")
    if wanted:
        candidates = [candidate for candidate in candidates if candidate.effect in wanted]
        left_out = {name: reason for name, reason in left_out.items() if name in wanted}
    absorbed = _absorbed(diagnosis, replay)
    plants = []
    for candidate in candidates:
        sized, reason = _sized(candidate, diagnosis, replay, absorbed, sizes)
        plants += sized
        if reason:
            left_out[candidate.effect] = reason
    return plants, left_out


def _candidates(
    diagnosis: Diagnosis, replay: Replay, rng: np.random.Generator
) -> tuple[list[_Candidate], dict[str, str]]:
    candidates, left_out = list[_Candidate](), dict[str, str]()
    for effect in diagnosis.arrays.effects.values():
        if effect.id in NOT_PLANTED:
            left_out[effect.id] = NOT_PLANTED[effect.id]
        elif effect.id in OF_THE_FRONT and not diagnosis.observations.by_front:
            left_out[effect.id] = "only the front wheel shows it"
        elif effect.of_rear_wheels and diagnosis.observations.by_front:
            left_out[effect.id] = "it is planted wheel by wheel, and one counter tells the mean of both"
        elif not effect.forms(diagnosis.observations):
            left_out[effect.id] = f"these runs cannot show it: it needs {effect.needs or 'other runs'}"
        elif effect.id.startswith("covariate:"):
            act = by_column(replay.observations.number(effect.id.partition(":")[2]))
            candidates.append(_Candidate(effect.id, act, family=effect.family.value))
        elif effect.id not in plant_effects():
            left_out[effect.id] = "an effect of the campaign's own has no form to plant"
        else:
            forms = forms_of(effect.id)
            form = next((form for form in forms if form.form not in ("plain", "constant")), forms[0])
            knobs = form.knobs(np.random.default_rng([int(rng.integers(2**31)), 0]), replay.design)
            known = (form.typical, form.form, form.unit, effect.family.value)
            candidates.append(_Candidate(effect.id, partial(_planted, form, knobs), *known))
    for name, outsider in outsiders(replay, rng).items():
        if isinstance(outsider, str):
            left_out[name] = outsider
        else:
            candidates.append(_Candidate(name, outsider, OUTSIDERS[name], "outside", "1", outside=True))
    return candidates, left_out


def _planted(form: Form, knobs: dict[str, float], world: World, size: float) -> None:
    form.act(world, np.full(len(world.design), size), knobs)


def _absorbed(diagnosis: Diagnosis, replay: Replay) -> FloatArray:
    # changes of the readings that a recalibration removes: radii and track, (n_units, 6, 3)

    def of(name: str) -> FloatArray:
        enlarged, size = scaled(name), np.full(len(replay.design), _RELATIVE_STEP)
        change = replay.change(lambda world: enlarged(world, size, {}))
        return _along_and_across(diagnosis, change) / _RELATIVE_STEP

    left, right = of("left"), of("right")
    if diagnosis.observations.by_front:
        both = 0.5 * (left + right)
        return np.stack([both, both, np.zeros_like(both)], axis=2)
    return np.stack([left, right, of("track")], axis=2)


def _along_and_across(diagnosis: Diagnosis, change: FloatArray) -> FloatArray:
    turned = change.copy()
    turned[:, 1], turned[:, 2] = diagnosis.nominal.to_end_frame(change[:, 1], change[:, 2])
    return np.where(diagnosis.observations.usable, turned, np.nan)


def _signal(diagnosis: Diagnosis, change: FloatArray, absorbed: FloatArray | None) -> float:
    return strength(_along_and_across(diagnosis, change), diagnosis.noise.covariance, absorbed)


def _sized(
    candidate: _Candidate, diagnosis: Diagnosis, replay: Replay, absorbed: FloatArray, sizes: Sequence[Size]
) -> tuple[list[Plant], str]:
    level = candidate.effect not in (*CALIBRATION, *STEERED)
    free = absorbed if level else None

    def change(size: float) -> FloatArray:
        return replay.change(lambda world: candidate.act(world, size), level=level)

    small = change(candidate.typical)
    whole, left = _signal(diagnosis, small, None), _signal(diagnosis, small, free)
    if not left > ABSORBED * whole:
        return [], "these runs cannot show it" + (": a recalibration takes it up" if whole > 0 else "")
    plants = []
    for wanted, scale in sizes:
        if candidate.outside and scale != "s":
            continue
        value = {"s": candidate.typical * wanted / left, "x": candidate.typical * wanted}.get(scale, wanted)
        for _ in range(3 if scale == "s" else 0):
            reached = _signal(diagnosis, change(value), free)
            value *= (wanted / max(reached, 1e-9)) ** (0.5 if candidate.effect == "beam_misalignment" else 1.0)
        value = float(f"{value:.4g}")
        signs = (1.0,) if candidate.effect in ONE_SIGN else (1.0, -1.0)
        changes = tuple(change(sign * value) for sign in signs)
        moved = np.hypot(*changes[0][:, 1:3].T) / np.maximum(replay.observations.length_m, 1e-3)
        if (moved > LARGEST_SHARE).any() or (np.abs(changes[0][:, 3]) > LARGEST_RAD).any():
            continue
        known = (candidate.effect, candidate.form, candidate.outside, candidate.family)
        plants.append(Plant(*known, value, candidate.unit, _signal(diagnosis, changes[0], free), changes))
    return plants, "" if plants else "a size that shows would have to be out of all proportion"


FORMAT: Final = "calib-challenge-own/1"
#: largest share of false alarms, or wrong names
ALLOWED: Final = 0.05


@dataclass(frozen=True, slots=True)
class Own:
    """What a lab's own data would find."""

    campaign: str
    simulated: bool  #: whether its data were made by a program
    own_verdict: str
    #: runs, units of the diagnosis, and those whose noise repeats give
    runs: int
    units: int
    units_with_repeats: int
    found: tuple[Plant, ...]
    empty: tuple[Answer, ...]  #: on campaigns with nothing planted
    left_out: Mapping[str, str]
    asked: int
    done: int
    seed: int
    seconds: float

    @property
    def alarms(self) -> Share:
        """False alarms of empty campaigns."""
        return Share(sum(answer.seen for answer in self.empty), len(self.empty))

    @property
    def wrong(self) -> Share:
        """Wrong names of planted campaigns."""
        return Share(sum(one.times("wrong") for one in self.found), sum(len(one.answers) for one in self.found))

    @property
    def trusted(self) -> bool:
        """Whether neither is surely more than `ALLOWED`."""
        return all(share.exact95[0] <= ALLOWED for share in (self.alarms, self.wrong))

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        tables = {
            name: grouped((plant.effect, plant) for plant in self.found if plant.outside == outside)
            for name, outside in (("effects", False), ("outsiders", True))
        }
        alarms, wrong = self.alarms, self.wrong
        return {
            "format": FORMAT,
            "campaign": self.campaign,
            "simulated": self.simulated,
            "own_verdict": self.own_verdict,
            **plain(tables),
            "false_alarms": {"tried": alarms.total, "raised": alarms.hits, "ci95": list(alarms.exact95)},
            "wrong": {"planted": wrong.total, "wrong": wrong.hits},
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
    """Plant known effects on a campaign's own noise, and diagnose each; see `OwnNoise`.

    Parameters
    ----------
    campaign
        Runs with logs.
    effects
        Also outside causes; empty: all that the campaign can show.
    sizes, planted
        How large each is planted, and how often.
    workers
        Processes of this machine.
    seconds
        After which no further diagnosis begins.
    seed, progress
        Of all draws; called with the diagnoses done.
    """
    began = time.monotonic()
    diagnosis = diagnose_in_full(campaign, seed=seed, plan=False)
    # a cause of no library was found before the search: a blunder
    if {cause.effect for cause in diagnosis.causes} - diagnosis.arrays.effects.keys():
        raise RefusedError(
            f"{campaign.name}: the counters have a blunder ({diagnosis.sentence}); expected counts "
            "that are right to a few per cent; correct the campaign's encoder settings first"
        )
    observations = diagnosis.observations
    plants, left_out = plants_of(diagnosis, Replay.of(observations), effects, sizes, np.random.default_rng(seed))
    jobs: list[_Job] = []
    for turn in range(planted):
        jobs += [*((None, turn * EMPTY_EACH + number) for number in range(EMPTY_EACH)), *((p, turn) for p in plants)]
    progress(0, len(jobs), "diagnoses")
    # without logs, which the observations hold, a campaign is quick to hand over
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
    measured = readings + drawn
    # along and lateral are noise in the frame of the heading that is measured
    heading = np.where(observations.usable[:, 3], measured[:, 3], readings[:, 3])
    cos, sin = np.cos(heading), np.sin(heading)
    measured[:, 1] = readings[:, 1] + cos * drawn[:, 1] - sin * drawn[:, 2]
    measured[:, 2] = readings[:, 2] + sin * drawn[:, 1] + cos * drawn[:, 2]
    observed = replace(observations, measured=np.where(observations.usable, measured, np.nan))
    try:
        verdict = diagnose_in_full(campaign, seed=turn, plan=False, observations=observed)
    except RefusedError:
        return answer_of(effect, family, {"verdict": "undecided"})
    return answer_of(effect, family, verdict.to_dict())
