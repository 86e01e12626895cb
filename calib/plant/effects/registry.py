"""Every form of every effect that the plant knows."""

from __future__ import annotations

from typing import Final

from calib.errors import BadInputError
from calib.plant.effects import floor, instruments, motion, outside, wheels
from calib.plant.effects.form import Form

__all__ = ["ALL", "effects", "find", "forms_of"]

ALL: Final[tuple[Form, ...]] = (*wheels.FORMS, *motion.FORMS, *floor.FORMS, *instruments.FORMS, *outside.FORMS)


def effects() -> tuple[str, ...]:
    """Return the ids of all effects, each once, in the registry's order."""
    return tuple(dict.fromkeys(form.effect for form in ALL))


def forms_of(effect: str) -> tuple[Form, ...]:
    """Return the forms of an effect.

    Raises
    ------
    BadInputError
        Where there is no such effect.
    """
    found = tuple(form for form in ALL if form.effect == effect)
    if not found:
        raise BadInputError(f"effect {effect!r} found; expected one of {', '.join(effects())}; name one of these")
    return found


def find(effect: str, form: str = "") -> Form:
    """Return one form of an effect; its first where `form` is empty or not known for it.

    Raises
    ------
    BadInputError
        Where there is no such effect, or no such form of it.
    """
    found = forms_of(effect)
    if not form:
        return found[0]
    for one in found:
        if one.form == form:
            return one
    raise BadInputError(
        f"form {form!r} of {effect} found; expected one of {', '.join(one.form for one in found)}; name one of these"
    )
