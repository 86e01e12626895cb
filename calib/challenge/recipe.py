"""From a seeds file to the list of cases to make: what kind each is, before anything is drawn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Final, Literal, get_args

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from calib.campaign.settings_file import load_toml
from calib.errors import CASES, BadFileError, refuse_beyond
from calib.plant.effects import ALL, forms_of
from calib.plant.signal import CALIBRATION

Group = Literal["empty", "calibration", "single", "natural", "pair", "outside", "alias", "deleted", "crowded"]
GROUPS: Final[tuple[Group, ...]] = get_args(Group)
SEEDS: Final = Path(__file__).parent / "seeds"
SIGNALS: Final = (3.0, 5.0, 10.0, 25.0)
_FORMAT: Final = "calib-challenge-seeds/1"
_EXPECTED: Final = f"a whole number as seed, max_runs of 20 or more, and in [cases] counts of {', '.join(GROUPS)}"
_REMEDY: Final = "compare with calib/challenge/seeds/development.toml"
_GROSS: Final = ("encoder_gross", "integration_scheme")

_OUTSIDE: Final = [form.effect for form in ALL if form.effect.startswith("outside:")]
#: designs of the empty cases that have no good one
_EMPTY_POOR: Final = ("load_a_session", "corridor_only", "squares_one_load", "few_repeats")
#: for pairs: effects that leave different things behind
_PAIRED: Final = (
    "load_radius", "temperature_radius", "speed_radius", "travel_direction", "curve_scrub", "load_dependent_track",
    "rangefinder_scale", "reference_yaw", "lost_counts", "payload_position", "rear_drag", "wear", "load_creep",
    "reference_lever_arm", "session_step", "curve_load_transfer",
)  # fmt: skip

#: exact aliases: the truth, the design on which it cannot be told from the others, and the others
_ALIASES: Final[tuple[tuple[str, str, tuple[str, ...]], ...]] = (
    ("radius_scale", "laser_only", ("rangefinder_scale", "beam_misalignment")),
    ("rangefinder_scale", "laser_only", ("radius_scale", "beam_misalignment")),
    ("beam_misalignment", "good", ("rangefinder_scale",)),
    ("lost_counts/constant", "good", ("unequal_radii", "radius_scale")),
    ("load_radius", "load_a_session", ("session_step",)),
    ("travel_direction", "corridor_only", ("floor_slope",)),
    ("floor_slope", "corridor_only", ("travel_direction",)),
)


@dataclass(frozen=True, slots=True)
class Seeds:
    """A seeds file; pydantic holds it against these types and bounds."""

    purpose: str  #: ``development``, ``scoring`` or ``ci``
    seed: Annotated[int, Field(strict=True, ge=0)]
    cases: dict[Group, Annotated[int, Field(strict=True, ge=0)]]  #: how many cases of each of `GROUPS`
    max_runs: Annotated[int, Field(strict=True, ge=20)] = 160  #: most runs of a case


@dataclass(frozen=True, slots=True)
class Recipe:
    """One case to make."""

    case: str  #: its neutral name
    number: int  #: its place in the unshuffled list, which with the seed determines everything drawn
    group: str  #: one of `GROUPS`
    effects: tuple[str, ...] = ()  #: ``effect`` or ``effect/form``; empty is none
    targets: tuple[float, ...] = ()  #: wanted signal of each; NaN is the typical size
    design: str = "good"  #: ``good``, ``laser_only``, or a poor design of the plant
    aliases: tuple[str, ...] = ()  #: effects that these runs cannot tell from the truth, exactly
    deleted: str = ""  #: effect to be deleted from the library; empty is none


def read_seeds(path: Path) -> Seeds:
    """Read a seeds file; raises BadFileError where an entry is missing or is none that can be made."""
    data = load_toml(path, str(path), remedy="give one of calib/challenge/seeds")
    if data.pop("format", None) != _FORMAT:
        raise BadFileError(path, column="format", found="another format", expected=_FORMAT, remedy=_REMEDY)
    try:
        seeds = TypeAdapter(Seeds).validate_python({"purpose": "", **data})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if part != "[key]")
        raise BadFileError(
            path, column=where, found=f"{first['input']!r:.80}", expected=_EXPECTED, remedy=_REMEDY
        ) from error
    total = sum(seeds.cases.values())
    refuse_beyond(total, CASES, shown=str(path), what="cases", remedy="make several sets", column="cases")
    return seeds


def _library() -> list[str]:
    """Return the effects of the library that have a signal to be set, without calibration."""
    names = dict.fromkeys(
        form.effect
        for form in ALL
        if not form.effect.startswith("outside:") and form.effect not in (*CALIBRATION, *_GROSS)
    )
    covariates = [name for name in names if name.startswith("covariate:")]
    return [name for name in names if name not in covariates[1:]]


def _singles(count: int, rng: np.random.Generator) -> list[tuple[str, float]]:
    """Return (effect/form, signal): every effect at every signal, forms in turn, strong ones twice; blunders."""
    faults = [(f"{form.effect}/{form.form}", float("nan")) for name in _GROSS for form in forms_of(name)]
    strong: list[tuple[str, float]] = []
    for turn, signal in enumerate((*SIGNALS, 10.0, 25.0)):
        for place, name in enumerate(_library()):
            # constant lost counts are an alias by construction, and have their own group
            forms = [item.form for item in forms_of(name) if (name, item.form) != ("lost_counts", "constant")]
            strong.append((f"{name}/{forms[(turn + place) % len(forms)]}", signal))
    if count < len(strong) + len(faults):
        # a small set: other effects each time, strong ones first
        names = [str(item) for item in rng.permutation(_library())]
        return [(names[n % len(names)], (10.0, 25.0, 25.0, 10.0, 5.0, 3.0)[n % 6]) for n in range(count)]
    whole = strong + faults
    return [whole[number % len(whole)] for number in range(count)]


def _of_group(group: Group, count: int, rng: np.random.Generator) -> list[Recipe]:
    """Return `count` cases of a group, their names and numbers still to be given."""
    case = partial(Recipe, "", 0, group)
    if group == "single":
        return [case((name,), (signal,)) for name, signal in _singles(count, rng)]
    names = [*_library(), *CALIBRATION] if group == "deleted" else _library()
    if group == "natural" or (group == "deleted" and count < len(names)):
        names = list(map(str, rng.permutation(names)))

    def made(n: int) -> Recipe:
        name = names[n % len(names)]
        if group == "empty":
            return case(design="good" if n % 5 < 3 else _EMPTY_POOR[(n // 5 * 2 + n % 5 - 3) % 4])
        if group == "calibration":
            return case((CALIBRATION[n % 3],), ((5.0, 10.0, 25.0, 100.0, 250.0)[n // 3 % 5],))
        if group == "natural":
            return case((name,), (float("nan"),))
        if group == "pair":
            pair = tuple(map(str, rng.choice(_PAIRED, 2, replace=False)))
            return case(pair, ((15.0, 15.0), (25.0, 12.0))[n % 2])
        if group == "outside":
            return case((_OUTSIDE[n % len(_OUTSIDE)],), ((25.0, 10.0)[n // len(_OUTSIDE) % 2],))
        if group == "alias":
            effect, design, others = _ALIASES[n % len(_ALIASES)]
            return case((effect,), ((25.0, 12.0)[n // len(_ALIASES) % 2],), design, others)
        if group == "crowded":
            return case(*_crowd(n, rng))
        return case((name,), (25.0,), deleted=name)

    return [made(n) for n in range(count)]


def _crowd(number: int, rng: np.random.Generator) -> tuple[tuple[str, ...], tuple[float, ...]]:
    drawn = rng.choice([*_PAIRED, "unequal_radii", "track_width"], 3 + number % 4, replace=False)
    signals = np.exp(rng.uniform(np.log(5.0), np.log(100.0), len(drawn)))
    targets = (*(round(float(signal), 1) for signal in signals), float(rng.choice([5.0, 10.0, 15.0])))
    return (*map(str, drawn), _OUTSIDE[number % len(_OUTSIDE)]), targets


def recipes(seeds: Seeds, limit: int | None = None) -> list[Recipe]:
    """Return the (first `limit`) cases of a seeds file, in a shuffled order so that a case's name says nothing."""
    listed: list[Recipe] = []
    for number, group in enumerate(GROUPS):
        listed += _of_group(group, seeds.cases.get(group, 0), np.random.default_rng([seeds.seed, number]))
    order = np.random.default_rng([seeds.seed, 999]).permutation(len(listed))
    kept = order if limit is None else order[:limit]
    return [replace(listed[int(n)], case=f"c{place + 1:04d}", number=int(n)) for place, n in enumerate(kept)]
