"""What a diagnosis says of a planted campaign, held against what was planted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

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
