"""What is planted: the library's effects in the plant's forms, and causes outside it."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, Final
from zlib import crc32

import numpy as np

from calib.challenge.cases import ONE_SIGN
from calib.challenge.judge import Answer
from calib.challenge.own_replay import Replay
from calib.errors import BadInputError
from calib.gap.decision.diagnosis import Diagnosis
from calib.plant.effects import effects as plant_effects
from calib.plant.effects import forms_of
from calib.plant.signal import CALIBRATION, strength
from calib.plant.world import Form, Moment, World, scaled, standardised
from calib.types import FloatArray, IntArray

SizedAct = Callable[[World, float], None]

#: outside cause -> size at which it is tried first
OUTSIDERS: Final = {"interaction": 1e-3, "one_speed": 2e-3, "left_turns": 1e-2, "unlogged": 1e-3}

#: columns of this correlation are one
ALIKE: Final = 0.9
#: width of the resonance over its speed
NARROW: Final = 0.1
#: left turns tighter than this count
TIGHT_PER_M: Final = 0.05


def outsiders(replay: Replay, rng: np.random.Generator) -> dict[str, SizedAct | str]:
    """Return each outside cause, or why this campaign cannot have it."""
    columns = _two_columns(replay)
    speeds = np.unique(np.round(replay.design.speed_mps, 2))
    condition = replay.observations.condition
    n_repeated = int((np.bincount(condition) > 1).sum())
    drawn = rng.standard_normal((2, int(condition.max()) + 1))
    turns_left = bool((replay.observations.turn_rad > 0).any())
    crossed = None if columns is None else _on_both_radii(_standard(columns[0]) * _standard(columns[1]))
    return {
        "interaction": crossed or "no two columns vary apart",
        "one_speed": "all runs have one speed" if len(speeds) < 2 else _one_speed(float(speeds[len(speeds) // 2])),
        "left_turns": _left_turns if turns_left else "nothing turns left",
        "unlogged": "fewer than three conditions have repeats" if n_repeated < 3 else _unlogged(drawn, condition),
    }


def _on_both_radii(share: FloatArray) -> SizedAct:
    return lambda world, size: world.enlarge(size * share)


def _standard(values: FloatArray) -> FloatArray:
    return standardised(np.where(np.isfinite(values), values, np.nanmean(values)))


def _two_columns(replay: Replay) -> tuple[FloatArray, FloatArray] | None:
    design, observations = replay.design, replay.observations
    order = np.arange(len(observations), dtype=np.float64)
    driven = (design.temperature_C, design.speed_mps, design.minutes_under_load)
    candidates = (observations.number("load_left_N"), *driven, observations.length_m, order)
    varying = [v for v in candidates if np.isfinite(v).all() and np.std(v) > 1e-6 * (1e-3 + np.abs(np.mean(v)))]
    return next((pair for pair in combinations(varying, 2) if abs(float(np.corrcoef(*pair)[0, 1])) < ALIKE), None)


def _one_speed(at_mps: float) -> SizedAct:
    def act(world: World, size: float) -> None:
        def during(now: Moment) -> None:
            now.roll_more(size * np.exp(-(((np.abs(now.v_mps) - at_mps) / (NARROW * at_mps)) ** 2)))

        world.during.append(during)

    return act


def _left_turns(world: World, size: float) -> None:
    def during(now: Moment) -> None:
        now.track += size * (now.curvature_per_m * np.sign(now.v_mps) > TIGHT_PER_M)

    world.during.append(during)


def _unlogged(drawn: FloatArray, condition: IntArray) -> SizedAct:
    left, right = drawn[0, condition], 0.7 * (drawn[0, condition] + drawn[1, condition])
    return lambda world, size: world.enlarge(size * left, size * right)


#: what logged counts cannot be made to show
NOT_PLANTED: Final = {
    "encoder_gross": "a blunder is found before the search, by trial",
    "integration_scheme": "it is in the simulator, not in the vehicle",
    "path_weave": "it needs runs without logs",
}
#: share left beside a recalibration, below which an effect cannot be asked for
ABSORBED: Final = 0.02
#: what calibrates a front wheel that alone drives the odometry
STEERED: Final = ("steering_zero", "steering_scale")
#: what only the front wheel shows
OF_THE_FRONT: Final = (*STEERED, "steering_backlash", "steering_delay", "drive_slip")
#: of the path and of the heading: a larger change is no small effect
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
class Plant:
    """One effect at one size, and what was found of it."""

    effect: str  #: id of the effect, or name of the outside cause
    form: str
    outside: bool  #: whether no library holds it
    family: str
    size: float
    unit: str
    signal: float  #: beside these runs' noise, after a recalibration
    #: shape (n_units, 6): what it does to the readings, by either sign that has a meaning
    changes: tuple[FloatArray, ...]
    answers: tuple[Answer, ...] = ()  #: how the campaigns with it went

    def times(self, what: str) -> int:
        """Return how often a field of `Answer` is true."""
        return sum(getattr(answer, what) for answer in self.answers)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        document = {
            "size": self.size,
            "unit": self.unit,
            "signal": round(self.signal, 2),
            "planted": len(self.answers),
            "seen": self.times("seen"),
            "left_open": self.times("open"),
            "wrong": self.times("wrong"),
        }
        if self.outside:
            return document
        return document | {"form": self.form, "first": self.times("first"), "in_group": self.times("in_group")}

    @property
    def key(self) -> int:
        """Seed of what is drawn for it."""
        return crc32(f"{self.effect}/{self.size:.6g}".encode())


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
    """Return what is planted, and the reason of what is not; see `Plant`.

    `wanted`: effects and outside causes, empty: all that can show; BadInputError where one is unknown.
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
    candidates: list[_Candidate] = []
    left_out: dict[str, str] = {}
    for effect in diagnosis.effects:
        if effect.id in NOT_PLANTED:
            left_out[effect.id] = NOT_PLANTED[effect.id]
        elif effect.id in OF_THE_FRONT and not diagnosis.observations.by_front:
            left_out[effect.id] = "only the front wheel shows it"
        elif effect.of_rear_wheels and diagnosis.observations.by_front:
            left_out[effect.id] = "it is planted wheel by wheel, and one counter tells the mean of both"
        elif not effect.forms(diagnosis.observations):
            left_out[effect.id] = f"these runs cannot show it: it needs {effect.needs or 'other runs'}"
        elif effect.id.startswith("covariate:"):
            act = _on_both_radii(_standard(replay.observations.number(effect.id.partition(":")[2])))
            candidates.append(_Candidate(effect.id, act, family=effect.family.value))
        elif effect.id not in plant_effects():
            left_out[effect.id] = "an effect of the campaign's own has no form to plant"
        else:
            forms = forms_of(effect.id)
            # one that the library does not assume
            form = next((form for form in forms if form.form not in ("plain", "constant")), forms[0])
            knobs = form.knobs(np.random.default_rng([int(rng.integers(2**31)), 0]), replay.design)
            act = partial(_planted, form, knobs)
            known = (form.typical, form.form, form.unit, effect.family.value)
            candidates.append(_Candidate(effect.id, act, *known))
    for name, outsider in outsiders(replay, rng).items():
        if isinstance(outsider, str):
            left_out[name] = outsider
        else:
            candidates.append(_Candidate(name, outsider, OUTSIDERS[name], "outside", "1", outside=True))
    return candidates, left_out


def _planted(form: Form, knobs: dict[str, float], world: World, size: float) -> None:
    form.act(world, np.full(len(world.design), size), knobs)


def _absorbed(diagnosis: Diagnosis, replay: Replay) -> FloatArray:

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
    given: _Candidate, diagnosis: Diagnosis, replay: Replay, absorbed: FloatArray, sizes: Sequence[Size]
) -> tuple[list[Plant], str]:
    level = given.effect not in (*CALIBRATION, *STEERED)
    free = absorbed if level else None

    def change(size: float) -> FloatArray:
        return replay.change(lambda world: given.act(world, size), level=level)

    small = change(given.typical)
    whole, left = _signal(diagnosis, small, None), _signal(diagnosis, small, free)
    if not left > ABSORBED * whole:
        return [], "these runs cannot show it" + (": a recalibration takes it up" if whole > 0 else "")
    plants = []
    for wanted, scale in sizes:
        # an outside cause has no unit
        if given.outside and scale != "s":
            continue
        value = {"s": given.typical * wanted / left, "x": given.typical * wanted}.get(scale, wanted)
        for _ in range(3 if scale == "s" else 0):
            reached = _signal(diagnosis, change(value), free)
            value *= (wanted / max(reached, 1e-9)) ** (0.5 if given.effect == "beam_misalignment" else 1.0)
        value = float(f"{value:.4g}")
        signs = (1.0,) if given.effect in ONE_SIGN else (1.0, -1.0)
        changes = tuple(change(sign * value) for sign in signs)
        moved = np.hypot(*changes[0][:, 1:3].T) / np.maximum(replay.observations.length_m, 1e-3)
        if (moved > LARGEST_SHARE).any() or (np.abs(changes[0][:, 3]) > LARGEST_RAD).any():
            continue
        reached = _signal(diagnosis, changes[0], free)
        known = (given.effect, given.form, given.outside, given.family)
        plants.append(Plant(*known, value, given.unit, reached, changes))
    return plants, "" if plants else "a size that shows would have to be out of all proportion"
