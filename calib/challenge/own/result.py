"""What the diagnoses of planted campaigns answer, one by one and counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from calib.challenge.own.plants import Plant
from calib.challenge.score import clopper_pearson
from calib.result import plain

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
    wrong: (
        bool  #: causes are named, and neither it nor its group is among them; of an outside one: a fix is recommended
    )


def answer_of(effect: str, family: str, verdict: Mapping[str, Any]) -> Answer:
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
    named_wrongly = bool(named) and word not in SILENT and not together
    return Answer(
        verdict=word,
        seen=word not in UNSEEN,
        first=named[:1] == [effect],
        in_group=together,
        open=word in ("unknown", "partly_explained"),
        # of an outside cause no name is right: wrong is what would be acted upon
        wrong=named_wrongly if effect else bool(verdict.get("recommended", False)),
    )


FORMAT: Final = "calib-challenge-own/1"
#: more false alarms, or wrong names, than this share are a finding
ALLOWED: Final = 0.05


@dataclass(frozen=True, slots=True)
class Found:
    """What was found of one effect at one size."""

    plant: Plant
    answers: tuple[Answer, ...]

    def times(self, what: str) -> int:
        """Return how often an answer says so: ``seen``, ``first``, ``in_group``, ``open`` or ``wrong``."""
        return sum(getattr(answer, what) for answer in self.answers)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values; no effect of the library can be first, or in a group, of an outside cause."""
        plant = self.plant
        document = {
            "size": plant.size,
            "unit": plant.unit,
            "signal": round(plant.signal, 2),
            "planted": len(self.answers),
            "seen": self.times("seen"),
            "left_open": self.times("open"),
            "wrong": self.times("wrong"),
        }
        if plant.outside:
            return document
        return document | {"form": plant.form, "first": self.times("first"), "in_group": self.times("in_group")}


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
        return sum(found.times("wrong") for found in self.found)

    @property
    def planted(self) -> int:
        """Campaigns with something planted."""
        return sum(len(found.answers) for found in self.found)

    @property
    def trusted(self) -> bool:
        """Whether neither false alarms nor wrong names are surely more than one in twenty."""
        return all(
            clopper_pearson(hits, total)[0] <= ALLOWED
            for hits, total in ((self.raised, len(self.empty)), (self.wrong, self.planted))
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        tables: dict[str, dict[str, list[Found]]] = {"effects": {}, "outsiders": {}}
        for found in self.found:
            table = tables["outsiders" if found.plant.outside else "effects"]
            table.setdefault(found.plant.effect, []).append(found)
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
