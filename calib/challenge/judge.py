"""One verdict judged against one truth: names, groups, fix, and the intervals of its parameters."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from zlib import crc32

import numpy as np

from calib.challenge.cases import Truth
from calib.gap.effects.library import REGISTRY
from calib.plant import Cause
from calib.types import FloatArray

Compared = tuple[str, float, float, float]

#: effect, in its plain form -> parameter of the verdict that is its size
_SIZES: Final = {
    "radius_scale": "relative", "unequal_radii": "relative", "track_width": "relative", "curve_scrub": "widening",
    "rangefinder_scale": "relative", "rangefinder_offset": "offset", "travel_direction": "relative",
    "reference_yaw": "yaw", "reference_latency": "latency", "temperature_radius": "alpha", "payload_mass": "share",
    "floor_undulation": "excess", "steering_zero": "zero", "steering_scale": "relative", "speed_radius": "per_mps",
    "side_slip": "slip_per_acceleration", "steering_delay": "delay",
}  # fmt: skip


def _expected(truth: Truth, cause: Cause) -> dict[str, float]:
    size = cause.size
    if cause.form != "plain":
        return {}
    if cause.effect == "load_radius":
        left_m, right_m = truth.model.radius_left_m, truth.model.radius_right_m
        return {"slope_left": size * left_m, "slope_right": size * cause.knobs["right_ratio"] * right_m}
    if cause.effect == "load_dependent_track":
        # the verdict's load is that of the axle, the plant's that of a wheel
        return {"per_N": 0.5 * size}
    if cause.effect == "beam_misalignment":
        return {"excess": 1 / float(np.cos(size)) - 1}
    return {_SIZES[cause.effect]: size} if cause.effect in _SIZES else {}


def compare(truth: Truth, verdict: Mapping[str, Any]) -> list[Compared]:
    """Return the intervals of a verdict that can be held against the truth."""
    named = {cause.get("effect"): cause for cause in verdict.get("causes", [])}
    compared: list[Compared] = []
    for cause in truth.causes:
        parameters = named.get(cause.effect, {}).get("parameters", {})
        for name, value in _expected(truth, cause).items():
            interval = parameters.get(name, {}).get("ci95")
            if interval and None not in interval:
                compared.append((f"{cause.effect}.{name}", value, float(interval[0]), float(interval[1])))
    return compared


#: distance, in standard deviations of the noise, below which causes form one group
RESOLVED_SIGMAS: Final = 3.0
#: signal from which an effect of a crowded case has to be named
NAMED_FROM_SIGNAL: Final = 20.0
LEFT_OPEN: Final = ("unknown", "partly_explained")


@dataclass(frozen=True, slots=True)
class Judged:
    """How one case went."""

    case: str
    group: str
    design: str
    truth: tuple[str, ...]
    deleted: str
    signal: float | None  #: target signal; None where there is none or it is natural
    verdict: str  #: its word, ``error`` (diagnosis failed) or ``missing``
    named: tuple[str, ...]  #: likeliest first
    right: bool  #: the right answer of its group, see `judge`
    first: bool  #: a true effect is named first (for empty cases: nothing is named)
    in_group: bool  #: every true effect is named, or stands in a group with a named one
    covered: bool | None  #: the 95 % set holds the truth; None: it is in no library
    set_size: int
    #: by the plant no other effect is nearer than `RESOLVED_SIGMAS`; None: not measured
    separable: bool | None
    rival: str
    #: a fix is recommended; and a cause of it is neither true nor in a group with the truth
    recommended: bool
    wrong_fix: bool
    #: the recommended fix made the fresh campaign worse; None: not tried
    harmful: bool | None
    statements: tuple[tuple[float, bool], ...]  #: probability of each named cause, and whether it is true
    intervals: tuple[Compared, ...]
    #: closure on held-out runs, and on the fresh campaign
    predicted: float | None
    achieved: float | None
    seconds: float | None
    #: in a crowded case: each effect from `NAMED_FROM_SIGNAL` on is named or in a group with one
    strong: tuple[bool, ...] = ()
    decided: bool = False  #: the verdict is ``explained``, and what it names first is true or of a true effect's family
    error: str = ""
    #: see `calib.challenge.cases.Truth`
    ceiling: tuple[float, float] | None = None
    own_ceiling: tuple[float, float] | None = None


def judge(truth: Truth, verdict: Mapping[str, Any] | None) -> Judged:
    """Hold the JSON of a verdict (None: there is none) against the truth.

    Right is: nothing, for an empty case; the effect first, or both of two; of one outside the library `LEFT_OPEN`, of a
    deleted one also an effect nearer than `RESOLVED_SIGMAS`; truth and alias in a group.
    """
    recipe = truth.recipe
    answer: Mapping[str, Any] = verdict if verdict is not None else {"verdict": "missing"}
    word = str(answer.get("verdict", "missing"))
    crowded = recipe.group == "crowded"  # its outside cause is a residual that none can name
    effects = tuple(c.effect for c in truth.causes if not (crowded and c.effect.startswith("outside:")))
    causes = [cause for cause in answer.get("causes", []) if isinstance(cause, dict)]
    named = tuple(str(cause.get("effect", "")) for cause in causes)
    groups = groups_of(answer, causes)
    near = {name for name, distance in truth.rivals if distance < RESOLVED_SIGMAS} | set(recipe.aliases)
    in_library = recipe.group != "outside" and not recipe.deleted
    first = bool(named) and named[0] in effects if effects else not named and word == "no_gap"
    in_group = all(grouped_with(effect, named, groups) for effect in effects) and (bool(effects) or first)
    signals = zip(truth.causes, truth.signals, truth.beside, strict=True) if crowded else ()
    large = (c.effect for c, alone, beside in signals if min(alone or 0.0, beside or 0.0) >= NAMED_FROM_SIGNAL)
    strong = tuple(grouped_with(name, named, groups) for name in large if not name.startswith("outside:"))
    sets = [set(credible) for credible in answer.get("credible_sets", [])]
    false_causes = [cause for cause in named if cause not in near and not grouped_with(cause, effects, groups)]
    stated = [c for c in causes if c.get("probability") is not None and recipe.group != "alias"]
    recommended, extra = bool(answer.get("recommended", False)), answer.get("challenge") or {}
    achieved = extra.get("achieved") or {}
    before, after = achieved.get("before_over_floor"), achieved.get("after_over_floor")
    target = recipe.targets[0] if recipe.targets else math.nan
    right = {
        "outside": word in LEFT_OPEN,
        "deleted": word in LEFT_OPEN or (bool(named) and named[0] in near),
        "alias": any(effects[0] in group and bool(group & set(recipe.aliases)) for group in groups if effects),
        "pair": set(effects) <= set(named),
        "crowded": all(strong),
    }.get(recipe.group, first)
    return Judged(
        case=recipe.case,
        group=recipe.group,
        design=recipe.design,
        truth=effects,
        deleted=recipe.deleted,
        signal=None if math.isnan(target) else target,
        verdict=word,
        named=named,
        right=right,
        first=first,
        in_group=in_group,
        covered=any(set(effects) <= credible for credible in sets) if in_library else None,
        set_size=len(sets),
        separable=truth.rivals[0][1] >= RESOLVED_SIGMAS if truth.rivals else None,
        rival=f"{truth.rivals[0][0]} {truth.rivals[0][1]:.1f}" if truth.rivals else "",
        recommended=recommended,
        wrong_fix=recommended and bool(false_causes or not effects),
        harmful=bool(after > before) if recommended and before is not None and after is not None else None,
        statements=tuple((float(cause["probability"]), str(cause.get("effect", "")) in effects) for cause in stated),
        intervals=tuple(compare(truth, answer)),
        predicted=(answer.get("closure") or {}).get("fraction"),
        achieved=achieved.get("fraction"),
        seconds=extra.get("seconds"),
        strong=strong,
        decided=word == "explained" and bool(named) and _family(named[0]) in {_family(effect) for effect in effects},
        error=str(answer.get("error", "")),
        ceiling=truth.ceiling,
        own_ceiling=truth.own_ceiling,
    )


def _family(effect: str) -> str:
    return REGISTRY[effect].family.value if effect in REGISTRY else effect


def groups_of(answer: Mapping[str, Any], causes: Sequence[Mapping[str, Any]]) -> list[set[str]]:
    """Return the effects that a verdict cannot tell apart, with forms that fit as well."""
    open_forms = {str(cause.get("effect", "")): set(cause["forms_open"]) for cause in causes if cause.get("forms_open")}
    alike = answer.get("indistinguishable", [])
    groups = [set(group).union(*(open_forms.get(name, set()) for name in group)) for group in alike]
    return groups + [{name, *others} for name, others in open_forms.items()]


def grouped_with(effect: str, named: Sequence[str], groups: Sequence[set[str]]) -> bool:
    """Return whether an effect is named, or stands in a group with a named one."""
    return effect in named or any(effect in group and group & set(named) for group in groups)


NAMES_NOTHING: Final = ("no_gap", "undecided", "unknown")
NO_GAP_SEEN: Final = ("no_gap", "undecided")
#: families whose members have nothing in common
UNRELATED_FAMILIES: Final = ("own", "covariate", "")


@dataclass(frozen=True, slots=True)
class Answer:
    """How one planted campaign went."""

    verdict: str
    seen: bool
    first: bool  #: the planted effect is named first
    in_group: bool  #: it, one of its group, or its family is named
    open: bool
    #: others alone are named; of an outside cause: a fix is recommended
    wrong: bool


def answer_of(effect: str, family: str, verdict: Mapping[str, Any]) -> Answer:
    """Hold a verdict's JSON against the effect planted, if any."""
    word = str(verdict["verdict"])
    causes = list(verdict.get("causes", ()))
    named = [str(cause["effect"]) for cause in causes]
    families = {str(cause.get("family", "")) for cause in causes[:1]} - set(UNRELATED_FAMILIES)
    together = family in families or grouped_with(effect, named, groups_of(verdict, causes))
    named_wrongly = bool(named) and word not in NAMES_NOTHING and not together
    wrong = named_wrongly if effect else bool(verdict.get("recommended", False))
    return Answer(word, word not in NO_GAP_SEEN, named[:1] == [effect], together, word in LEFT_OPEN, wrong)


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
