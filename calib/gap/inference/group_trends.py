"""Trends as groups of replicates take part in them: a group knows the steps of its own sessions only."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from calib.gap.inference.noise_components import N_CHANNELS, STEP, Trends
from calib.types import FloatArray, IntArray

#: what each group may have of its own: a calibration and a mean in each channel
N_GROUP_COLUMNS: Final = 9
#: of sums of products in double precision, relative
_ROUNDING: Final = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class _Alike:
    units: slice  #: their units
    #: shape (n_units, 6, 9 + q): each group's own, the gap, and its trends
    columns: FloatArray
    #: shape (n_groups, q): gap and trends in the basis; its last is nothing
    index: IntArray
    #: places of their products among the groups' (one triangle) and the basis'
    there: IntArray
    place: IntArray

    @staticmethod
    def of(units: slice, columns: FloatArray, index: IntArray, n_basis: int) -> _Alike:
        known = index != n_basis - 1
        there = np.flatnonzero(known[:, :, None] & known[:, None, :] & np.tri(index.shape[1], dtype=bool))
        place = index[:, :, None] * n_basis + index[:, None, :]
        return _Alike(units, columns, index, there, place.ravel()[there])


@dataclass(frozen=True, slots=True, eq=False)
class GroupTrends:
    """Gap and trends of units, group by group in the order of the groups' sizes."""

    alike: list[_Alike]  #: groups of one size
    places: IntArray  #: of the products of all among those of the basis
    mix: FloatArray  #: shape (n_basis, 1 + k): gap and trends over the basis

    @staticmethod
    def of(trends: Trends, units: IntArray, group: IntArray, design: FloatArray, gap: FloatArray) -> GroupTrends | None:
        """Return those of units (n,) in groups (n,), see `Trends`; None where these know about half of the steps.

        `design` (n_units, 6, 9): what each group may have of its own; `gap` (n_units, 6): measured minus predicted.
        """
        n_shared, width = trends.shared.shape[2], trends.of_step.shape[2]
        steps = trends.steps()
        sessions = len(steps)
        known, place = np.unique(group * sessions + trends.session[units], return_inverse=True)
        of_group, session = np.divmod(known, sessions)
        slot = np.arange(len(known)) - np.searchsorted(of_group, of_group)
        slots = int(slot.max()) + 1
        if 2 * slots > sessions:
            return None
        first = 1 + n_shared + width
        columns = np.zeros((len(units), N_CHANNELS, first + width * slots))
        columns[:, :, 0], columns[:, :, 1 : 1 + n_shared] = gap[units], trends.shared[units]
        columns[:, :, 1 + n_shared : first] = trends.of_step[units] * STEP
        index = np.full((int(group.max()) + 1, columns.shape[2]), first + width * sessions)
        index[:, :first] = np.arange(first)
        mix = np.zeros((first + width * sessions + 1, 1 + trends.n_trends))
        mix[: 1 + n_shared, : 1 + n_shared] = np.eye(1 + n_shared)
        for wheel in range(width):
            here = first + width * slot + wheel
            columns[np.arange(len(units)), :, here[place]] = trends.of_step[units, :, wheel] * STEP
            index[of_group, here] = first + width * session + wheel
            # from the mean of all units, so all take part in a step
            away = steps.min(axis=0)
            own = 1 + n_shared + wheel
            mix[own:-1:width, own::width] = np.concatenate([away[None], steps - away])
        columns = np.concatenate([design[units], columns], axis=2)
        sizes = np.bincount(group)
        ends = np.concatenate([[0], np.cumsum(sizes)])
        edges = [0, *(np.flatnonzero(np.diff(sizes)) + 1).tolist(), len(sizes)]
        alike = []
        for low, high in pairwise(edges):
            # a group of few units knows no more sessions than that
            q = first + width * min(int(sizes[low]), slots)
            some = slice(int(ends[low]), int(ends[high]))
            of_some = np.ascontiguousarray(columns[some, :, : N_GROUP_COLUMNS + q])
            alike.append(_Alike.of(some, of_some, index[low:high, :q], len(mix)))
        return GroupTrends(alike, np.concatenate([some.place for some in alike]), mix)

    def solved(self, whitener: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """See `ScaleLikelihood.solved`; `prior`: (9,), precision of the groups' own."""
        from scipy.linalg import solve_triangular

        n_basis, middle = len(self.mix), 0.0
        products, held = [], []
        for alike in self.alike:
            n_groups = len(alike.index)
            white = (whitener[alike.units] @ alike.columns).reshape(n_groups, -1, alike.columns.shape[2])
            gram = white.transpose(0, 2, 1) @ white
            factor, half, log_det = group_factors(gram, prior)
            middle += log_det
            left = gram[:, N_GROUP_COLUMNS:, N_GROUP_COLUMNS:] - half.transpose(0, 2, 1) @ half
            products.append(left.ravel().take(alike.there))
            own = white[:, :, :N_GROUP_COLUMNS] @ factor.transpose(0, 2, 1)
            held.append((own, white[:, :, N_GROUP_COLUMNS:] - own @ half))
        added = np.bincount(self.places, np.concatenate(products), n_basis**2).reshape(n_basis, n_basis)
        dense = self.mix.T @ (added + added.T - np.diag(np.diag(added))) @ self.mix
        lower = np.linalg.cholesky(dense[1:, 1:] + np.eye(len(dense) - 1))
        basis = solve_triangular(lower, np.concatenate([dense[1:, :1], self.mix[:, 1:].T], axis=1), lower=True)
        along, mixed = basis[:, 0], basis[:, 1:]
        middle += float(dense[0, 0] - along @ along) + 2 * float(np.log(np.diag(lower)).sum())
        # of the gap, less what the trends explain
        beta, inside = -(along @ mixed), mixed.T @ mixed
        beta[0] = 1.0
        g, kept = np.empty(whitener.shape[:2]), np.empty_like(whitener)
        for alike, (own, residual) in zip(self.alike, held, strict=True):
            g[alike.units] = (residual @ beta[alike.index][:, :, None]).reshape(-1, N_CHANNELS)
            trend, index = residual[:, :, 1:], alike.index[:, 1:]
            within = inside.ravel().take(index[:, :, None] * n_basis + index[:, None, :])
            taken = _squares(own, own) + _squares(trend @ within, trend)
            kept[alike.units] = np.eye(N_CHANNELS) - taken
        return g, kept, middle


def group_factors(gram: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return F (n_groups, 9, 9), F^T F the inverse of own products, F times others (n_groups, 9, q), log determinant.

    `gram`: (n_groups, 9, 9 + q), products of own columns with these and others; `prior`: (9,), precision of the own.
    """
    own = gram[:, :N_GROUP_COLUMNS, :N_GROUP_COLUMNS] + np.diag(prior)
    # on a unit diagonal columns alike stay factorable
    root = np.sqrt(np.diagonal(own, axis1=1, axis2=2))
    lower = np.linalg.cholesky(own / (root[:, :, None] * root[:, None, :]) + _ROUNDING * np.eye(N_GROUP_COLUMNS))
    factor = np.linalg.inv(lower) / root[:, None, :]
    log_det = 2 * float((np.log(np.diagonal(lower, axis1=1, axis2=2)) + np.log(root)).sum())
    return factor, factor @ gram[:, :N_GROUP_COLUMNS, N_GROUP_COLUMNS:], log_det


def _squares(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the products of each unit's rows (n_groups, 6 n, k), shape (n_groups n, 6, 6)."""
    k = left.shape[2]
    return left.reshape(-1, N_CHANNELS, k) @ right.reshape(-1, N_CHANNELS, k).transpose(0, 2, 1)
