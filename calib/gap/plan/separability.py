"""How far what one effect does lies from all that another could do, on runs driven and on runs not yet driven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.gap.effects.effect import Effect, Form
from calib.gap.evidence.marginal import CALIBRATION_SD, Nuisance, columns_of_forms, project, rows
from calib.gap.evidence.noise import Noise
from calib.gap.evidence.noise_kernels import COMPONENTS, kernels, masked, quantisation
from calib.gap.predict.path import Path
from calib.gap.verdict.alternatives import NEAR, STRETCH

#: whitened norm at which an effect is seen
SEEN: Final = 5.0
#: steps between one parameter's direction and the next, where an effect has several of no known proportion
_DIRECTIONS: Final = (1.0, 0.7, -0.8, 0.9, -0.6, 0.5, -0.7, 0.8)


def noise_at(path: Path, scales: Mapping[str, float]) -> Noise:
    """Return the noise of units that need not have been driven yet; a scale that is missing takes its prior median."""
    scale = np.array([scales.get(name, median) for name, median, _ in COMPONENTS])
    covariance = np.tensordot(scale**2, kernels(path), axes=1) + quantisation(path)
    return Noise(masked(covariance, path.s.usable), dict(scales), float("inf"), np.ones(len(path.s)))


class Signatures:
    """Whitened signatures of a library on some units, and from them the distances on any subset of the units.

    Parameters
    ----------
    path : Path
        The units, about the path to linearise.
    noise : Noise
        Their noise.
    effects : sequence of Effect
        The library.
    sizes : mapping of str to (form, sizes), optional
        Form and size of effects that were fitted; the others are taken at typical size in the form that shows best.
    """

    def __init__(
        self,
        path: Path,
        noise: Noise,
        effects: Sequence[Effect],
        sizes: Mapping[str, tuple[Form, FloatArray]] | None = None,
    ) -> None:
        given = sizes or {}
        self.names: list[str] = []
        self.own_calibration: list[bool] = []
        blocks = [path.calibration * CALIBRATION_SD]
        truths: list[FloatArray] = []
        self.forms: list[tuple[int, int, int]] = []
        calibration = rows(path, noise, blocks[0])
        position = 4
        self.offered = {effect.id: effect.forms(path.s) for effect in effects}
        every = [form for forms in self.offered.values() for form in forms] + [form for form, _ in given.values()]
        known = {id(form): columns for form, columns in zip(every, columns_of_forms(path, every), strict=True)}
        self._places: dict[int, tuple[int, FloatArray]] = {}
        for effect in effects:
            forms = self.offered[effect.id]
            if not forms:
                continue
            number = len(self.names)
            shown: list[FloatArray] = []
            self.names.append(effect.id)
            self.own_calibration.append(effect.calibration)
            for form in forms:
                columns = known[id(form)]
                largest = np.array([p.largest / p.typical for p in form.parameters]) * STRETCH
                blocks.append(columns * largest)
                self._places[id(form)] = position, largest
                self.forms.append((number, position, position + columns.shape[2]))
                position += columns.shape[2]
                if effect.id not in given:
                    shown.append(columns @ np.resize(np.array(_DIRECTIONS), columns.shape[2]))
            if effect.id in given:
                form, theta = given[effect.id]
                shown.append(known[id(form)] @ (theta / form.typical))
            # an effect is asked of in the form that shows best
            free = calibration[:, 3:] if effect.calibration else calibration
            left = project(Nuisance.of(free), rows(path, noise, np.stack(shown, axis=2)))
            truths.append(shown[int(np.argmax((left**2).sum(axis=0)))])
        self.first_truth = position
        blocks.append(np.stack(truths, axis=2) if truths else np.zeros((len(path.s), 6, 0)))
        self.columns = rows(path, noise, np.concatenate(blocks, axis=2))
        self.unit = np.repeat(np.arange(len(path.s))[:, None], 6, axis=1)[path.s.usable]

    def of_form(self, form: Form) -> FloatArray:
        """Return the whitened signatures of one of the `offered` forms in typical sizes, (n_rows, n_parameters)."""
        first, largest = self._places[id(form)]
        return np.asarray(self.columns[:, first : first + len(largest)] / largest)

    def gram(self, units: BoolArray) -> FloatArray:
        """Return the scalar products of all columns over some units (n_units,)."""
        kept = self.columns[units[self.unit]]
        gram: FloatArray = kept.T @ kept
        return gram

    def distances(self, gram: FloatArray, truths: Sequence[int] | None = None) -> tuple[FloatArray, FloatArray]:
        """Return how well each effect is seen (n_truths,), and how far it is from each other one (n_truths, n_effects).

        The signal is the whitened norm beside a free recalibration (for the calibration's own three: as it is); the
        distance is the norm of what the other effect leaves of it, whatever its size within what is plausible; infinite
        from itself. `truths` are the numbers of the effects to ask of, by default all.
        """
        asked = np.arange(len(self.names)) if truths is None else np.asarray(truths, dtype=np.int64)
        own = np.asarray(self.own_calibration)
        target = self.first_truth + asked
        square = gram[target, target]
        signal = np.zeros(len(asked))
        distance = np.full((len(asked), len(self.names)), np.inf)
        for calibration in (False, True):
            mine = own[asked] == calibration
            if not mine.any():
                continue
            free = np.arange(4)[3:] if calibration else np.arange(4)
            signal[mine] = np.sqrt(self._left(gram, free, target[mine], square[mine]))
            for number, first, last in self.forms:
                if own[number] and not calibration:
                    near = signal[mine]
                else:
                    index = np.concatenate([free, np.arange(first, last)])
                    near = np.sqrt(self._left(gram, index, target[mine], square[mine]))
                distance[mine, number] = np.minimum(distance[mine, number], near)
        distance[np.arange(len(asked)), asked] = np.inf
        return signal, distance

    @staticmethod
    def _left(gram: FloatArray, index: np.ndarray, target: np.ndarray, square: FloatArray) -> FloatArray:
        inner = gram[np.ix_(index, index)] + np.eye(len(index))
        cross = gram[np.ix_(index, target)]
        return np.asarray(np.maximum(square - (cross * np.linalg.solve(inner, cross)).sum(axis=0), 0.0))

    def told_apart(self, gram: FloatArray) -> BoolArray:
        """Return which effects are seen and stand apart from every other by `NEAR` and more, shape (n_effects,)."""
        signal, distance = self.distances(gram)
        return np.asarray((distance.min(axis=1) >= NEAR) & (signal >= NEAR))
