"""The best that any diagnosis can do on a campaign: how often the likeliest effect is the true one, all being known.

From the Gram matrix of whitened signatures, a recalibration projected out: an effect is drawn from the library, it acts
at the wanted signal, noise is added, and the posterior probability of each effect is computed exactly. The mean of the
largest is the share of cases that the best rule gets right; no rule gets more, near-aliases being what they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.types import FloatArray

#: false alarms that the gate allows
ALARMS: Final = 0.05
#: draws of effect and noise; the standard error of a share is then at most 0.018
DRAWS: Final = 800
#: directions weaker than this, relative to the strongest, are rounding
RANK: Final = 1e-9
#: evidences that differ by less are the same but for rounding
ALIKE_NATS: Final = 1e-6


@dataclass(frozen=True, slots=True)
class Ceiling:
    """What the best rule reaches on one campaign at one signal."""

    free: float  #: share of true effects named, where it is known that there is one
    #: the same behind a gate that lets `ALARMS` of the empty campaigns through; what does not pass is a miss
    gated: float


@dataclass(frozen=True, slots=True, eq=False)
class _Space:
    """What one form of an effect can do: an orthonormal basis (n_rows, n_directions), by one sign only or by both."""

    effect: int
    basis: FloatArray
    one_sign: bool


def ceiling_of(
    signatures: Mapping[str, Sequence[FloatArray]],
    signal: float,
    rng: np.random.Generator,
    *,
    one_sign: Sequence[str] = (),
    draws: int = DRAWS,
) -> Ceiling | None:
    """Return the ceiling of a campaign, the effects of the library being as likely as each other.

    Parameters
    ----------
    signatures : mapping of str to sequence of array of float, each shape (n_rows, n_directions)
        Effect -> what each of its forms can do, whitened, a recalibration projected out.
    signal : float
        Norm at which the true effect acts.
    rng : numpy.random.Generator
        Draws effects, directions and noise.
    one_sign : sequence of str
        Effects of which only positive sizes have a meaning.
    draws : int
        How many.

    Returns
    -------
    Ceiling or None
        None where no effect leaves anything.
    """
    spaces = _spaces(signatures, one_sign)
    if not spaces:
        return None
    present, spaces, frame = _framed(spaces)
    noise = rng.standard_normal((2, draws, frame.shape[1]))
    truth = rng.integers(len(present), size=draws)
    seen = noise[0] + signal * np.stack([_direction(spaces, int(effect), rng) for effect in truth])
    evidence, empty = (_log_evidence(spaces, len(present), readings, signal) for readings in (seen, noise[1]))
    level = np.quantile(_log_mean(empty), 1 - ALARMS)
    largest = np.exp(evidence.max(axis=1) - _log_mean(evidence)) / len(present)
    return Ceiling(float(largest.mean()), float((largest * (_log_mean(evidence) > level)).mean()))


def ceiling_of_truth(
    signatures: Mapping[str, Sequence[FloatArray]],
    effect: str,
    left: FloatArray,
    signal: float,
    rng: np.random.Generator,
    *,
    one_sign: Sequence[str] = (),
    draws: int = DRAWS,
) -> Ceiling:
    """Return how often the same rule names one effect, as it acts in one case: what it misses there is nobody's.

    Of effects that leave exactly the same it names each as often as the others.

    Parameters
    ----------
    signatures, signal, rng, one_sign, draws
        As for `ceiling_of`.
    effect : str
        The true one.
    left : array of float, shape (n_rows,)
        What it leaves in this case, whitened, a recalibration projected out. Of an effect that is not among the
        signatures the rule knows this direction.
    """
    known = signatures if effect in signatures else {**signatures, effect: [left[:, None]]}
    number = list(known).index(effect)
    present, spaces, frame = _framed(_spaces(known, one_sign), left)
    noise = rng.standard_normal((2, draws, frame.shape[1]))
    seen = noise[0] + signal * (left @ frame) / np.linalg.norm(left)
    evidence, empty = (_log_evidence(spaces, len(present), readings, signal) for readings in (seen, noise[1]))
    level = np.quantile(_log_mean(empty), 1 - ALARMS)
    tied = evidence > evidence.max(axis=1, keepdims=True) - ALIKE_NATS
    hit = tied[:, present.index(number)] / tied.sum(axis=1)
    return Ceiling(float(hit.mean()), float((hit * (_log_mean(evidence) > level)).mean()))


def _framed(spaces: Sequence[_Space], *further: FloatArray) -> tuple[list[int], list[_Space], FloatArray]:
    """Return the effects present, and their spaces in the frame (n_rows, n) that all of it happens in.

    The rest of the noise says the same of every effect. `further` vectors (n_rows,) are in the frame too.
    """
    present = sorted({space.effect for space in spaces})
    every = [*(space.basis for space in spaces), *(vector[:, None] for vector in further)]
    frame, _ = np.linalg.qr(np.concatenate(every, axis=1))
    return present, [_Space(present.index(s.effect), frame.T @ s.basis, s.one_sign) for s in spaces], frame


def _spaces(signatures: Mapping[str, Sequence[FloatArray]], one_sign: Sequence[str]) -> list[_Space]:
    spaces = []
    for number, (effect, forms) in enumerate(signatures.items()):
        for columns in forms:
            norms = np.linalg.norm(columns, axis=0)
            kept = columns[:, norms > 0] / norms[norms > 0]
            left, size, _ = np.linalg.svd(kept, full_matrices=False)
            rank = int((size > max(RANK * size.max(initial=0.0), 1e-6)).sum())
            if rank == 1:
                # one direction keeps its sign
                spaces.append(_Space(number, kept[:, :1], effect in one_sign))
            elif rank > 1:
                spaces.append(_Space(number, left[:, :rank], False))
    return spaces


def _direction(spaces: Sequence[_Space], effect: int, rng: np.random.Generator) -> FloatArray:
    """Return what a drawn form of an effect leaves, at a signal of 1, in a drawn direction."""
    own = [space for space in spaces if space.effect == effect]
    space = own[int(rng.integers(len(own)))]
    drawn = rng.standard_normal(space.basis.shape[1])
    if space.one_sign:
        drawn = np.abs(drawn)
    direction: FloatArray = space.basis @ (drawn / np.linalg.norm(drawn))
    return direction / np.linalg.norm(direction)


def _log_evidence(spaces: Sequence[_Space], n_effects: int, readings: FloatArray, signal: float) -> FloatArray:
    """Return the log of each effect's likelihood against noise alone, its direction averaged out, (n, n_effects)."""
    by_effect: list[list[FloatArray]] = [[] for _ in range(n_effects)]
    for space in spaces:
        by_effect[space.effect].append(_log_likelihood(space, readings, signal))
    return np.stack([_log_mean(np.stack(forms, axis=1)) for forms in by_effect], axis=1)


def _log_likelihood(space: _Space, readings: FloatArray, signal: float) -> FloatArray:
    """Return the log likelihood ratio (n,) of a signal of this norm, its direction uniform on the sphere.

    The mean of exp(z cos) over the sphere in k dimensions is a Bessel function: Gamma(k/2) (2/z)^(k/2-1) I_(k/2-1)(z).
    """
    from scipy.special import gammaln, ive

    inside = readings @ space.basis
    n_directions = space.basis.shape[1]
    if n_directions == 1:
        along = signal * inside[:, 0]
        both = np.logaddexp(along, -along) - np.log(2.0)
        return np.asarray((along if space.one_sign else both) - 0.5 * signal**2)
    z = np.maximum(signal * np.linalg.norm(inside, axis=1), 1e-12)
    order = 0.5 * n_directions - 1.0
    mean = gammaln(0.5 * n_directions) + order * np.log(2.0 / z) + np.log(ive(order, z)) + z
    return np.asarray(mean - 0.5 * signal**2)


def _log_mean(logs: FloatArray) -> FloatArray:
    """Return the log of the mean of exponentials along the second axis, shape (n,)."""
    largest = logs.max(axis=1)
    mean: FloatArray = largest + np.log(np.exp(logs - largest[:, None]).mean(axis=1))
    return mean
