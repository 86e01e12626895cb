"""Every form of every effect that the plant knows."""

from __future__ import annotations

from typing import Final

from calib.errors import BadInputError
from calib.plant.effects import surroundings, wheels
from calib.plant.world import Form

# the order is part of a sealed set: what is drawn from a seed follows it
ALL: Final[tuple[Form, ...]] = (
    *wheels.FORMS,
    *wheels.MOVING,
    *surroundings.FLOOR,
    *surroundings.INSTRUMENTS,
    *surroundings.OUTSIDE,
)


def effects() -> tuple[str, ...]:
    """Return the ids of all effects, each once, in the registry's order."""
    return tuple(dict.fromkeys(form.effect for form in ALL))


def forms_of(effect: str) -> tuple[Form, ...]:
    """Return the forms of an effect."""
    forms = tuple(form for form in ALL if form.effect == effect)
    if not forms:
        raise BadInputError(f"effect {effect!r} found; expected one of {', '.join(effects())}; name one of these")
    return forms


def find(effect: str, form: str = "") -> Form:
    """Return one form of an effect; its first where `form` is empty or not known for it."""
    forms = {known.form: known for known in forms_of(effect)}
    if form and form not in forms:
        raise BadInputError(f"form of {effect}: found {form!r}; expected one of {', '.join(forms)}; choose one")
    return forms[form or next(iter(forms))]
