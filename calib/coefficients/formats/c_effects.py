"""The law and the named effects of a coefficient file as one C99 header: wheel angles in, wheel travel out.

The same motion as `calib.runtime.Effects`, for the loop of a simulator in C or C++. Effects on readings, at places of
the floor, at stops and of the steering do not act on the wheels; the header names those of the file. What an effect
does is a macro of its name in ``c_acts.j2``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import Artifact, ExportOptions, accepted_lines, c_number, rendered, templates
from calib.coefficients.sections import EffectSection

FILE_NAME: Final = "calib_effects.h"
#: forms that act through what a single run does not know, as in `calib.runtime.effects`
OTHER_FORMS: Final = ("change of load", "per session", "along the corridor alone", "other routes", "distance")
#: macro of an effect of a further column of the run table
COVARIATE: Final = "covariate"


def known_effects() -> set[str]:
    """Return the effects that act on the wheels, beside those of further columns."""
    macros = vars(templates().get_template("c_acts.j2").module)
    return {name for name in macros if not name.startswith("_")} - {COVARIATE}


@dataclass(frozen=True, slots=True)
class _Effect:
    """An effect as its macro reads it: sizes and settings as C numbers, 0 for a size that the form lacks."""

    name: str
    form: str
    settings: Mapping[str, float]
    sizes: Mapping[str, float]
    #: reference load of the law
    reference_N: float
    #: number of its further column; -1 without one
    column: int

    @property
    def act(self) -> str:
        """Its macro."""
        return COVARIATE if self.column >= 0 else self.name

    @property
    def reference(self) -> str:
        """Reference load of the law."""
        return c_number(self.reference_N)

    @property
    def wheel(self) -> str:
        """Wheel that a form of one wheel acts on."""
        return "left" if self.form.startswith("left") else "right"

    def has(self, size: str) -> bool:
        """Return whether the form has a size of this name."""
        return size in self.sizes

    def __getitem__(self, size: str) -> str:
        return c_number(self.sizes.get(size, 0.0))

    def setting(self, name: str, default: float) -> str:
        """Return a setting."""
        return c_number(self.settings.get(name, float(default)))

    def off(self, value: str) -> str:
        """Return how far a number of the run lies from where the effect is zero."""
        spread = c_number(self.settings.get("spread", 1.0) or 1.0)
        return f"calib_effects_off({value}, {self.setting('centre', 0.0)}, {spread})"


def render(file: CoefficientFile, options: ExportOptions) -> tuple[Artifact, ...]:
    """Return the header of a coefficient file, with the law alone where it has no effects; `options` change nothing."""
    del options
    known = known_effects()

    def acts(section: EffectSection) -> bool:
        of_column = section.effect.startswith("covariate:")
        return (of_column or section.effect in known) and not any(words in section.form for words in OTHER_FORMS)

    acting = [section for section in file.effects if acts(section)]
    others = [section.effect for section in file.effects if not acts(section)]
    covariates = [section.effect.partition(":")[2] for section in acting if ":" in section.effect]
    reference_N = file.wheels.left.reference_load.value
    effects = []
    for section in acting:
        sizes = {name: quantity.value for name, quantity in section.parameters.items()}
        column = section.effect.partition(":")[2]
        at = covariates.index(column) if column else -1
        effects.append(_Effect(section.effect, section.form, section.settings, sizes, reference_N, at))
    accepted = accepted_lines(file)
    data = rendered(
        "c_effects.h.j2", file=file, acting=effects, others=others, accepted=accepted, covariates=covariates
    )
    notes = (f"not in the header: {', '.join(others)}",) if others else ()
    return (Artifact(FILE_NAME, data, notes),)
