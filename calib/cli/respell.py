"""Short and earlier spellings, put into today's words before anything is parsed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

#: the studies of ``calib simulate study``
_STUDIES: Final = ("symmetric", "asymmetric", "corrected")
_COMMANDS: Final = ("route", "journey", "study", "replay")
#: options of today's ``calib simulate journey`` that its ``route`` has not
_LAW: Final = ("--law", "--model", "--load", "--payload", "--payload-at", "--reference-load")


def respelled(arguments: Sequence[str]) -> list[str]:
    """Return the arguments as today's commands spell them.

    ``calib simulate --replay C`` is ``calib simulate replay C``; ``calib simulate corrected`` is ``calib simulate
    study corrected``; ``calib simulate custom --route R`` is ``calib simulate route R``, or ``calib simulate journey
    R`` with a law. ``calib fleet FOLDER`` is ``calib fleet run FOLDER``.
    """
    words = list(arguments)
    if len(words) > 1 and words[0] == "fleet" and words[1] not in ("run", "simulate", "-h", "--help"):
        return ["fleet", "run", *words[1:]]
    if not words or words[0] != "simulate" or (len(words) > 1 and words[1] in ("-h", "--help")):
        return words
    rest = words[1:]
    if rest and rest[0] in _COMMANDS:
        if rest[0] == "route" and _has(rest, _LAW):
            rest[0] = "journey"
        return ["simulate", *rest]
    if _has(rest, ("--replay",)) and not any(name in rest for name in (*_STUDIES, "custom")):
        return ["simulate", "replay", *_taken(rest, "--replay")]
    if rest and rest[0] in _STUDIES:
        return ["simulate", "study", *rest]
    if rest and rest[0] == "custom":
        name = "journey" if _has(rest, _LAW) else "route"
        return ["simulate", name, *_taken(rest[1:], "--route")]
    return words


def _has(words: Sequence[str], names: Sequence[str]) -> bool:
    return any(word.split("=", 1)[0] in names for word in words)


def _taken(words: Sequence[str], option: str) -> list[str]:
    """Return the words with the values of `option` as arguments, the option itself left out."""
    return [word.removeprefix(f"{option}=") for word in words if word != option]
