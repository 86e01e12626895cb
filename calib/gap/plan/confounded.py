"""How far from the causes of a hypothesis the other effects are on some runs: near ones are confounded with them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from calib.gap.effects.effect import Effect, Family, Form
from calib.gap.effects.radii import DIRECTIONS, NAMES, AnySpeed, RadiusScale, SpeedRadius, TrackWidth
from calib.gap.effects.reference import ReferenceScale
from calib.gap.inference.fit import CALIBRATION_SD
from calib.gap.inference.linear_model import WhitenedSystem
from calib.gap.inference.marginal_likelihood import Nuisance
from calib.gap.inference.noise import Noise
from calib.gap.plan.identifiability import SEPARATION_SD, aliases_of, sizes_on
from calib.gap.predict import Path
from calib.types import FloatArray

#: prior standard deviation, in typical sizes, of named effects while aliases of one are sought
OTHER_EFFECTS_SD: Final = 3.0
#: off by the same share: radii and track, and what does the same without another measure of length
SCALED: Final = (RadiusScale.id, TrackWidth.id, ReferenceScale.id)

#: named causes, and how far from them each effect is
Distances = tuple[tuple[str, ...], dict[str, float]]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Named causes at their sizes, on some runs."""

    system: WhitenedSystem
    effects: Mapping[str, Effect]  #: the library, by id
    offered: Mapping[str, Sequence[Form]]  #: its forms on these runs, calibration apart
    forms: Sequence[Form] = ()  #: of the named effects
    theta: Sequence[FloatArray] = ()  #: each shape (n_parameters,)
    off: tuple[str, ...] = ()  #: named calibration parameters
    values: FloatArray = field(default_factory=lambda: np.zeros(3))  #: shape (3,): relative size of each of `NAMES`
    #: of a reference that alone measures lengths; by what residuals exceed the noise, squared
    unaided: Mapping[str, Sequence[Form]] = field(default_factory=dict)
    variance_factor: float = 1.0

    @property
    def named(self) -> tuple[str, ...]:
        """Its effects and the parameters that are off."""
        return (*(form.effect for form in self.forms), *self.off)

    @cached_property
    def _own(self) -> dict[str, list[Form]]:
        s = self.system.path.s
        return {name: effect.forms(s) for name, effect in self.effects.items() if effect.calibration}

    @cached_property
    def _any_speed(self) -> list[Form]:
        return AnySpeed().forms(self.system.path.s)

    def on(self, path: Path, noise: Noise, among: Collection[str]) -> Hypothesis:
        """Return it on other runs, to compare with some effects alone."""
        effects = {name: one for name, one in self.effects.items() if name in {*among, *self.named, *NAMES}}
        offered = {name: one.forms(path.s) for name, one in effects.items() if not one.calibration}
        sizes = sizes_on(offered, self.forms, self.theta).values()
        system = WhitenedSystem(path, path, noise, [form for forms in offered.values() for form in forms])
        forms, theta = [form for form, _ in sizes], [size for _, size in sizes]
        return Hypothesis(system, effects, offered, forms, theta, self.off, self.values)

    @property
    def sizes(self) -> dict[str, tuple[Form, FloatArray]]:
        """Form and size of its effects, of radii and of the track."""
        own = zip(self._own.items(), self.values.tolist(), strict=True)
        sized = {name: (forms[0], np.array([size])) for (name, forms), size in own if abs(size) > 1e-12}
        return sized | {form.effect: (form, size) for form, size in zip(self.forms, self.theta, strict=True)}

    def distances(self, within: float = SEPARATION_SD, times: FloatArray | None = None) -> list[Distances]:
        """Return for each cause the effects `within` so many standard deviations of it, sizes free.

        For radii and track together where that confounds them, else for each. `times`: how often each observation is
        made, (n_obs,).
        """
        system = self.system if times is None else self.system.repeated(times)
        found = [self._of_effect(number, system, within) for number in range(len(self.forms))]
        per_unit, off = system.calibration / CALIBRATION_SD, self.off
        free = [system.calibration[:, 3:], *(OTHER_EFFECTS_SD * system.columns(form) for form in self.forms)]

        def near(names: Sequence[str], others: Sequence[FloatArray], forms: Mapping[str, Sequence[Form]]) -> Distances:
            numbers = [NAMES.index(name) for name in names]
            contribution = per_unit @ DIRECTIONS[numbers].T @ self.values[numbers]
            if forms is scaled:
                contribution = contribution / np.sqrt(self.variance_factor)
            nuisance = Nuisance.of(np.concatenate([*free, *others], axis=1))
            return tuple(names), aliases_of(system, nuisance, contribution, forms, self.named, within)

        scaled = {**self.offered, **self.unaided}
        if self.unaided and set(off).issuperset(SCALED[:2]):
            ratio = [per_unit @ DIRECTIONS[[NAMES.index(name)]].T for name in off if name not in SCALED]
            _, alike = near(SCALED[:2], [CALIBRATION_SD[0] * column for column in ratio], scaled)
            if alike.pop(ReferenceScale.id, np.inf) < SEPARATION_SD:
                found.append((SCALED, alike))
                off = tuple(name for name in off if name not in SCALED)
        if len(off) > 1:
            # one cause may look like two parameters off (counts lost on one wheel)
            found.append(near(off, [], self.offered))
            if min(found[-1][1].values(), default=np.inf) < SEPARATION_SD:
                return found
            found = found if within > SEPARATION_SD else found[:-1]
        for name in off:
            others = []
            for other, direction in zip(NAMES, DIRECTIONS, strict=True):
                if other != name:
                    column = (per_unit @ direction)[:, None]
                    # what is not off may be off by what does not show
                    undetected = SEPARATION_SD / max(float(np.linalg.norm(column)), 1e-12)
                    others.append(column * (CALIBRATION_SD[0] if other in off else undetected))
            found.append(near([name], others, {**self.offered, **self._own}))
        return found

    def _of_effect(self, number: int, system: WhitenedSystem, within: float) -> Distances:
        form, theta = self.forms[number], self.theta[number]
        others = [OTHER_EFFECTS_SD * system.columns(other) for other in self.forms if other is not form]
        contribution = np.asarray(system.columns(form) @ (theta / form.typical))
        near = _absorbing(system, contribution, within)
        own = min(near.values(), default=np.inf) < SEPARATION_SD or self.effects[form.effect].needs_calibration
        for held in (False, True):
            calibration = self._undetected(system) if held else system.calibration
            compared = {
                name: forms
                for name, forms in self.offered.items()
                if held == (own or self.effects[name].needs_calibration)
            }
            nuisance = Nuisance.of(np.concatenate([calibration, *others], axis=1))
            if SpeedRadius.id in compared and self.effects[form.effect].family is Family.DIRECTION:
                compared[SpeedRadius.id] = self._any_speed
            near |= aliases_of(system, nuisance, contribution, compared, self.named, within)
        return (form.effect,), near

    def _undetected(self, system: WhitenedSystem) -> FloatArray:
        """Return the recalibration, whitened: what is not off varies by what does not show alone."""
        columns = system.calibration / CALIBRATION_SD @ DIRECTIONS.T
        limits = SEPARATION_SD / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        free = columns * np.where([name in self.off for name in NAMES], CALIBRATION_SD[0], limits)
        return np.concatenate([free, system.calibration[:, 3:]], axis=1)


def _absorbing(system: WhitenedSystem, contribution: FloatArray, within: float) -> dict[str, float]:
    """Return the recalibration parameters that absorb a contribution (n_rows,), and what they leave."""
    left = Nuisance.of(system.calibration).scalar(contribution[:, None], contribution[:, None])[0, 0]
    if not (left < within**2 and contribution @ contribution > SEPARATION_SD**2):
        return {}
    columns = system.calibration / CALIBRATION_SD @ DIRECTIONS.T
    sizes = np.linalg.lstsq(columns, contribution)[0] * np.linalg.norm(columns, axis=0)
    left_sd = 0.0 if left < SEPARATION_SD**2 else float(np.sqrt(left))
    return {name: left_sd for name, size in zip(NAMES, sizes.tolist(), strict=True) if abs(size) > SEPARATION_SD}
