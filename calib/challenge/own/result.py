"""What the diagnoses of planted campaigns answer, one by one and counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from calib.challenge.own.plants import Plant
from calib.challenge.score import clopper_pearson

#: verdicts that name no cause
SILENT: Final = ("no_gap", "undecided", "unknown")
#: verdicts that see no gap
UNSEEN: Final = ("no_gap", "undecided")
#: families whose members have nothing in common but the name
NO_FAMILY: Final = ("own", "covariate", "")


@dataclass(frozen=True, slots=True)
class Answer:
    """How one planted campaign went."""

    verdict: str  #: the verdict's word
    seen: bool  #: a gap is seen
    first: bool  #: the planted effect is named first
    in_group: bool  #: it is named, stands in a group with a named one, or its family is named
    open: bool  #: the verdict leaves a rest open: ``unknown``, or ``partly_explained``
    wrong: bool  #: causes are named, and neither it nor its group is among them
    recommended: bool  #: a fix is recommended
    seconds: float  #: what the diagnosis took


def answer_of(effect: str, family: str, verdict: Mapping[str, Any], seconds: float) -> Answer:
    """Hold a verdict in the shape of ``calib diagnose --json`` against what was planted.

    `effect` is empty where nothing was planted, or a cause outside the library.
    """
    word = str(verdict["verdict"])
    causes = list(verdict.get("causes", ()))
    named = [str(cause["effect"]) for cause in causes]
    groups = [set(group) for group in verdict.get("indistinguishable", ())]
    groups += [{str(cause["effect"]), *cause.get("forms_open", ())} for cause in causes]
    families = {str(cause.get("family", "")) for cause in causes[:1]} - set(NO_FAMILY)
    together = effect in named or family in families or any(effect in g and g & set(named) for g in groups)
    recommended = bool(verdict.get("recommended", False))
    left_open = word in ("unknown", "partly_explained")
    named_wrongly = bool(named) and word not in SILENT and not together
    return Answer(
        verdict=word,
        seen=word not in UNSEEN,
        first=named[:1] == [effect],
        in_group=together,
        open=left_open,
        # of an outside cause no name is right: wrong is what would be acted upon
        wrong=named_wrongly if effect else recommended,
        recommended=recommended,
        seconds=seconds,
    )


FORMAT: Final = "calib-challenge-own/1"
#: more false alarms, or wrong names, than this share are a finding
ALLOWED: Final = 0.05


@dataclass(frozen=True, slots=True)
class Found:
    """What was found of one effect at one size."""

    #: effect, form, unit: what was planted
    effect: str
    form: str
    unit: str
    outside: bool  #: whether no library holds it
    #: size, signal: how large, and how strongly it shows beside the noise
    size: float
    signal: float
    #: planted, seen, first, in_group, left_open, wrong: how often: in all; a gap was seen; it was named first; named,
    #: in a group with a named one or by its family; the verdict left a rest open; something else was named (of an
    #: outside cause: a fix was recommended)
    planted: int
    seen: int
    first: int
    in_group: int
    left_open: int
    wrong: int

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        common = {"size": self.size, "unit": self.unit, "signal": round(self.signal, 2), "planted": self.planted}
        if self.outside:
            return {**common, "seen": self.seen, "left_open": self.left_open, "wrong": self.wrong}
        return {**common, "form": self.form, "seen": self.seen, "first": self.first, "in_group": self.in_group,
                "left_open": self.left_open, "wrong": self.wrong}  # fmt: skip


def found_of(plant: Plant, answers: Sequence[Answer]) -> Found:
    """Return what the answers say of a plant."""
    return Found(
        effect=plant.effect,
        form=plant.form,
        unit=plant.unit,
        outside=plant.outside,
        size=plant.size,
        signal=plant.signal,
        planted=len(answers),
        seen=sum(answer.seen for answer in answers),
        first=sum(answer.first for answer in answers),
        in_group=sum(answer.in_group for answer in answers),
        left_open=sum(answer.open for answer in answers),
        wrong=sum(answer.wrong for answer in answers),
    )


@dataclass(frozen=True, slots=True)
class Own:
    """What a lab's own data would find."""

    campaign: str  #: its name
    simulated: bool  #: whether its data were made by a program
    own_verdict: str  #: of the campaign as it is
    #: runs, units, units_with_repeats: runs, units of the diagnosis, and those whose noise repeats give
    runs: int
    units: int
    units_with_repeats: int
    found: tuple[Found, ...]  #: each effect and outside cause at each size
    empty: tuple[Answer, ...]  #: on campaigns with nothing planted
    left_out: Mapping[str, str]  #: what was not planted, and why
    #: asked, done: diagnoses wanted, and how many the time was enough for
    asked: int
    done: int
    seed: int  #: of everything that was drawn
    seconds: float  #: what it took

    @property
    def raised(self) -> int:
        """False alarms: a gap is seen where nothing was planted."""
        return sum(answer.seen for answer in self.empty)

    @property
    def wrong(self) -> int:
        """Plants of which something else was named."""
        return sum(found.wrong for found in self.found)

    @property
    def planted(self) -> int:
        """Campaigns with something planted."""
        return sum(found.planted for found in self.found)

    @property
    def trusted(self) -> bool:
        """Whether neither false alarms nor wrong names are surely more than one in twenty."""
        return all(
            clopper_pearson(hits, total)[0] <= ALLOWED
            for hits, total in ((self.raised, len(self.empty)), (self.wrong, self.planted))
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        tables: dict[str, dict[str, list[dict[str, Any]]]] = {"effects": {}, "outsiders": {}}
        for found in self.found:
            tables["outsiders" if found.outside else "effects"].setdefault(found.effect, []).append(found.to_dict())
        low, high = clopper_pearson(self.raised, len(self.empty))
        return {
            "format": FORMAT,
            "campaign": self.campaign,
            "simulated": self.simulated,
            "own_verdict": self.own_verdict,
            **tables,
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
