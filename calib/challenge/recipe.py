"""From a seeds file to the list of cases to make: what kind each is, before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.settings_file import load_toml
from calib.errors import BadFileError
from calib.limits import CASES, refuse_beyond
from calib.plant.effects.registry import ALL, forms_of
from calib.plant.signal import CALIBRATION

GROUPS: Final = ("empty", "calibration", "single", "natural", "pair", "outside", "alias", "deleted", "crowded")
SEEDS: Final = Path(__file__).parent / "seeds"
SIGNALS: Final = (3.0, 5.0, 10.0, 25.0)
_FORMAT: Final = "calib-challenge-seeds/1"
_GROSS: Final = ("encoder_gross", "integration_scheme")

#: for pairs: effects that leave different things behind
_PAIRED: Final = (
    "load_radius",
    "temperature_radius",
    "speed_radius",
    "travel_direction",
    "curve_scrub",
    "load_dependent_track",
    "rangefinder_scale",
    "reference_yaw",
    "lost_counts",
    "payload_position",
    "rear_drag",
    "wear",
    "load_creep",
    "reference_lever_arm",
    "session_step",
    "curve_load_transfer",
)

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
    """A seeds file."""

    purpose: str  #: ``development``, ``scoring`` or ``ci``
    seed: int  #: of everything
    cases: Mapping[str, int]  #: how many cases of each of `GROUPS`
    max_runs: int = 160  #: most runs of a case


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
    """Read a seeds file."""
    data: dict[str, Any] = load_toml(Path(path), str(path), remedy="give one of calib/challenge/seeds")
    cases, seed, most = data.get("cases"), data.get("seed"), data.get("max_runs", 160)
    if data.get("format") != _FORMAT or not isinstance(seed, int) or seed < 0 or not isinstance(cases, dict):
        raise BadFileError(
            path,
            found=f"format {data.get('format')!r}, seed {seed!r}",
            expected=f"format {_FORMAT!r}, a whole number as seed and a table [cases]",
            remedy="compare with calib/challenge/seeds/development.toml",
        )
    for group, count in cases.items():
        if group not in GROUPS or not isinstance(count, int) or isinstance(count, bool) or count < 0:
            raise BadFileError(
                path,
                column=f"cases.{group}",
                found=repr(count),
                expected=f"a count of one of {', '.join(GROUPS)}",
                remedy="correct the table",
            )
    refuse_beyond(sum(cases.values()), CASES, shown=str(path), what="cases", remedy="make several sets", column="cases")
    if not isinstance(most, int) or most < 20:
        raise BadFileError(
            path, column="max_runs", found=repr(most), expected="20 or more", remedy="correct or leave out the entry"
        )
    return Seeds(str(data.get("purpose", "")), seed, dict(cases), most)


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
    """Return (effect/form, signal): every effect at every signal, forms in turn, strong ones twice; gross."""
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


def _of_group(group: str, count: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    nan = float("nan")
    if group == "empty":
        poor = ("load_a_session", "corridor_only", "squares_one_load", "few_repeats")
        return [{"design": "good" if n % 5 < 3 else poor[(n // 5 * 2 + n % 5 - 3) % 4]} for n in range(count)]
    if group == "calibration":
        return [
            {"effects": (CALIBRATION[n % 3],), "targets": ((5.0, 10.0, 25.0, 100.0, 250.0)[n // 3 % 5],)}
            for n in range(count)
        ]
    if group == "single":
        return [{"effects": (name,), "targets": (signal,)} for name, signal in _singles(count, rng)]
    if group == "natural":
        names = list(map(str, rng.permutation(_library())))
        return [{"effects": (names[n % len(names)],), "targets": (nan,)} for n in range(count)]
    if group == "pair":
        pairs = []
        for n in range(count):
            pair = rng.choice(_PAIRED, 2, replace=False)
            pairs.append({"effects": tuple(map(str, pair)), "targets": ((15.0, 15.0), (25.0, 12.0))[n % 2]})
        return pairs
    if group == "outside":
        strange = [form.effect for form in ALL if form.effect.startswith("outside:")]
        return [
            {"effects": (strange[n % len(strange)],), "targets": ((25.0, 10.0)[n // len(strange) % 2],)}
            for n in range(count)
        ]
    if group == "alias":
        return [
            {
                "effects": (name,),
                "targets": ((25.0, 12.0)[n // len(_ALIASES) % 2],),
                "design": design,
                "aliases": others,
            }
            for n, (name, design, others) in ((n, _ALIASES[n % len(_ALIASES)]) for n in range(count))
        ]
    if group == "crowded":
        return [_crowd(n, rng) for n in range(count)]
    names = [*_library(), *CALIBRATION]
    if count < len(names):
        names = list(map(str, rng.permutation(names)))
    return [
        {"effects": (names[n % len(names)],), "targets": (25.0,), "deleted": names[n % len(names)]}
        for n in range(count)
    ]


def _crowd(number: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return three to six effects of the library at signals of 5 to 100, and an outside one at 5 to 15."""
    drawn = rng.choice([*_PAIRED, "unequal_radii", "track_width"], 3 + number % 4, replace=False)
    signals = np.exp(rng.uniform(np.log(5.0), np.log(100.0), len(drawn)))
    strange = [form.effect for form in ALL if form.effect.startswith("outside:")]
    return {
        "effects": (*map(str, drawn), strange[number % len(strange)]),
        "targets": (*(round(float(signal), 1) for signal in signals), float(rng.choice([5.0, 10.0, 15.0]))),
    }


def recipes(seeds: Seeds, limit: int | None = None) -> list[Recipe]:
    """Return the (first `limit`) cases of a seeds file, in a shuffled order so that a case's name says nothing."""
    listed: list[dict[str, Any]] = []
    for group in GROUPS:
        cases = _of_group(group, seeds.cases.get(group, 0), np.random.default_rng([seeds.seed, GROUPS.index(group)]))
        listed.extend({"group": group, **case} for case in cases)
    order = np.random.default_rng([seeds.seed, 999]).permutation(len(listed))
    kept = order if limit is None else order[:limit]
    return [Recipe(case=f"c{place + 1:04d}", number=int(n), **listed[int(n)]) for place, n in enumerate(kept)]
