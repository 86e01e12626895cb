"""The noise of each run, its covariance over the channels and what supports it; and lack of fit.

Lack of fit is what no effect of the library explains: in y = C beta + sum_k S_k theta_k + R + noise, R is an offset
that each condition (or cell) has of its own, or a trend on the surroundings; its scale is averaged over a grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from calib.gap.inference import noise_components as components
from calib.gap.inference import repeatability
from calib.gap.observations import Channel, Observations
from calib.gap.predict import Path
from calib.types import BoolArray, FloatArray, IntArray

#: repeats with less a channel are joined with coarser ones
ENOUGH_DOF_PER_CHANNEL: Final = 15.0
#: and in all
ENOUGH_DOF: Final = 30.0
#: with fewer than this nothing was learnt
MIN_DOF: Final = 8.0
#: units of a neighbourhood, driven one after the other
NEIGHBOURS_TOGETHER: Final = 3
#: windows of a neighbourhood, each of a shape of its own
WINDOWS_TOGETHER: Final = 5
#: most that a noise level without repeats may exceed the stated one
MAX_NOISE_EXCESS: Final = 5.0
#: fewest units for stated sigmas alone
MIN_RUNS: Final = 4
#: excess over the stated noise level that is said first
REPORTED_EXCESS: Final = 4.0
#: excess of windows that needs no more support
STATED_EXCESS: Final = 2.0
#: a larger one may exceed what grows as noise does by this factor
MAX_GROWTH_RATIO: Final = 2.0
#: log of how much likelier repeats may be by their own noise level than by routes' (of 2 in 58 sound campaigns)
MAX_LOG_RATIO: Final = 4.6
#: windows joined to a longer one
JOINED_WINDOWS: Final = (1, 2, 4, 8)
MIN_WINDOWS: Final = 4
POSE_CHANNELS: Final = slice(1, 4)


class Basis(StrEnum):
    """What a noise level rests on."""

    REPEATS = "repeats"
    ROUTE = "runs of one route, with loads and speeds taken out as trends"
    NEIGHBOURS = "differences of neighbouring runs"
    WINDOWS = "windows of recordings, each against its neighbours"
    STATED = "the stated sigmas alone, for nothing was driven twice"
    NOTHING = "nothing: nothing was driven twice, and the sigmas were assumed"


#: basis, labels (n_units,) of units compared, trends between these that are no noise, least dof
_NoiseSupport = tuple[Basis, IntArray, FloatArray | None, float]


def _noise_supports(path: Path) -> Iterator[_NoiseSupport]:
    observations = path.s
    enough = max(ENOUGH_DOF, ENOUGH_DOF_PER_CHANNEL * float(observations.usable.any(axis=0).sum()))
    alike = Basis.WINDOWS if observations.windowed else Basis.REPEATS
    trends = _ambient(path)
    yield alike, observations.cell, None, enough
    yield alike, observations.condition, trends, enough
    near = Basis.WINDOWS if observations.windowed else Basis.NEIGHBOURS
    beside = repeatability.neighbours(observations.condition, NEIGHBOURS_TOGETHER)
    yield near, beside, components.session_steps(path), enough
    yield near, beside, None, enough
    if not observations.windowed:
        # few repeats leave the scales open: routes tell more
        loads = components.load_speed_trends(path)
        for laws, least in ((components.route_trends(path), enough), (loads, ENOUGH_DOF)):
            yield Basis.ROUTE, observations.kind, np.concatenate([laws, trends], axis=2), least
    yield alike, observations.condition, trends, MIN_DOF
    yield alike, observations.cell, None, MIN_DOF
    yield near, beside, None, MIN_DOF
    if observations.windowed:
        yield near, repeatability.neighbours(observations.run, WINDOWS_TOGETHER), None, MIN_DOF
    else:
        yield Basis.ROUTE, observations.kind, np.concatenate([loads, trends], axis=2), MIN_DOF
        yield Basis.ROUTE, observations.kind, loads, MIN_DOF


def _ambient(path: Path) -> FloatArray:
    return np.concatenate([components.ambient_trends(path), *components.ambient_interactions(path)], axis=2)


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariance of every unit, and what it rests on."""

    covariance: FloatArray  #: shape (n_units, 6, 6): over the channels; unit variance without one
    scales: dict[str, float]
    dof: float  #: from replicates, else 0
    weight: FloatArray  #: shape (n_units,): 1, less far from the repeats
    supported: bool = True
    support: str = ""  #: by what, in words; else why not
    #: shape (6,): median noise level over that of stated sigmas and typical walks; NaN without the channel
    excess: FloatArray = field(default_factory=lambda: np.full(6, np.nan))
    #: shape (n_units, 6): degrees of freedom of each level by itself, where replicates measure it
    levels_dof: FloatArray | None = None

    @property
    def finding(self) -> str:
        """What is said first of a noise level far above the stated sigmas."""
        most = int(np.nanargmax(self.excess)) if np.isfinite(self.excess).any() else 0
        if not (self.supported and self.excess[most] > REPORTED_EXCESS):
            return ""
        return (
            f"Replicate runs scatter in the {Channel(most).label} channel {self.excess[most]:.0f} times as much as "
            "the stated sigmas and typical wheels would: the noise level itself is a finding."
        )

    @cached_property
    def whitener(self) -> FloatArray:
        """Inverse Cholesky factor of each unit's covariance, shape (n_units, 6, 6)."""
        return components.whitener_of(self.covariance)

    @property
    def floor(self) -> FloatArray:
        """Standard deviation of each channel in each unit, shape (n_units, 6)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def estimate_noise(path: Path, gap: FloatArray) -> Noise:
    """Estimate the noise from replicates.

    `gap`: (n_units, 6), measured minus predicted about `path`; scales not determined keep their prior.
    """
    shapes = components.NoiseComponents.about(path)
    first, prior, tried = None, np.log(components.PRIOR_MEDIANS), set()
    for basis, labels, trends, enough in _noise_supports(path):
        grouped = repeatability.Replicates.by(labels)
        if len(grouped.units) == 0:
            continue
        whole = repeatability.ScaleLikelihood(path, gap, shapes, grouped, trends)
        if whole.dof < enough or (same := (basis, labels.tobytes(), whole.k)) in tried:
            continue
        tried.add(same)
        thinned = repeatability.thinned_replicates(grouped)
        part = whole if thinned is grouped else repeatability.ScaleLikelihood(path, gap, shapes, thinned, trends)
        log_scale = repeatability.most_likely_scales(whole if part.dof < MIN_DOF else part, prior)
        weight = np.ones(len(gap))
        weight[whole.grouped.units] = whole.weights(log_scale)
        noise = _noise(path, shapes, log_scale, weight, basis, whole.dof)
        noise = replace(noise, levels_dof=shapes.dof(log_scale, part.uncertainty(log_scale)))
        if noise.supported and not (basis is Basis.ROUTE and _contradicts_repeats(path, gap, shapes, log_scale)):
            return noise
        first = first or noise
    return first or _noise(path, shapes, prior, np.ones(len(gap)), Basis.STATED, 0.0)


def _contradicts_repeats(
    path: Path, gap: FloatArray, shapes: components.NoiseComponents, log_scale: FloatArray
) -> bool:
    grouped = repeatability.Replicates.by(path.s.condition)
    if len(grouped.units) == 0:
        return False
    repeats = repeatability.ScaleLikelihood(path, gap, shapes, grouped, _ambient(path))
    even = np.ones(len(grouped.units))
    best = repeatability.most_likely_scales(repeats, log_scale)
    return repeats.cost(log_scale, even)[0] - repeats.cost(best, even)[0] > MAX_LOG_RATIO


def _noise(
    path: Path, shapes: components.NoiseComponents, log_scale: FloatArray, weight: FloatArray, basis: Basis, dof: float
) -> Noise:
    covariance = shapes.covariance(log_scale, weight)
    scales = {
        name: float(np.exp(v))
        for (name, _, _), v, on in zip(components.COMPONENTS, log_scale, shapes.active, strict=True)
        if on
    }
    excess = _excess(shapes, covariance)
    supported, words = _support(path, covariance, basis, dof, excess)
    return Noise(covariance, scales, dof, weight, supported, words, excess)


def _excess(shapes: components.NoiseComponents, covariance: FloatArray) -> FloatArray:
    usable = shapes.usable
    stated = shapes.covariance(np.log(components.PRIOR_MEDIANS), np.ones(len(usable)))
    ratio = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) / np.diagonal(stated, axis1=1, axis2=2))
    return np.array([float(np.median(ratio[on, k])) if (on := usable[:, k]).any() else np.nan for k in range(6)])


def _support(path: Path, covariance: FloatArray, basis: Basis, dof: float, excess: FloatArray) -> tuple[bool, str]:
    if basis is Basis.STATED:
        if path.s.sigmas_assumed:
            return False, str(Basis.NOTHING)
        if len(path.s) < MIN_RUNS:
            return False, f"nothing: {len(path.s)} runs, none driven twice"
        return True, str(basis)
    counted = f"{basis} ({dof:.0f} degrees of freedom)"
    most = float(np.nanmax(excess))
    if basis is Basis.REPEATS:
        of_session = np.stack([path.s.condition, np.unique(path.s.labels["session"], return_inverse=True)[1]])
        if most <= MAX_NOISE_EXCESS or np.unique(of_session, axis=1).shape[1] < len(path.s):
            return True, counted
        words = f"{counted}, each in another session, scatter {most:.3g} times as much as the stated sigmas"
        return False, f"nothing: {words}; a repeat within a session tells noise from what differs between them"
    if most > MAX_NOISE_EXCESS:
        words = f"{counted} scatter {most:.3g} times as much as the stated sigmas, and no repeats say why"
        return False, f"nothing: {words}"
    if most <= STATED_EXCESS or basis is not Basis.WINDOWS:
        return True, counted
    if (growth := window_growth(path)) is None:
        return False, f"nothing: {counted} scatter more than stated, and there are too few to see how that grows"
    heading, (lengths_m, parts) = Channel.HEADING, growth
    floor = float(np.sqrt(covariance[path.s.usable[:, heading], heading, heading].mean()))
    if floor > MAX_GROWTH_RATIO * np.sqrt(parts[0] + parts[1]):
        return False, f"nothing: what differs between {counted} grows in proportion to their length, as no noise does"
    return True, f"{counted}, of {lengths_m[0]:.2g} to {lengths_m[-1]:.2g} m"


def window_growth(path: Path) -> tuple[FloatArray, FloatArray] | None:
    """Return how the heading's residual grows with the length of windows; None if too few.

    Mean lengths (n_lengths,) of windows joined, and the mean square in the shortest that is constant, grows with the
    length, and with its square, (3,).
    """
    from scipy.optimize import nnls

    chains, seen = _chains(path), path.s.measured[:, Channel.HEADING] - path.end[:, 2]
    lengths, squares = [], []
    for joined in JOINED_WINDOWS:
        firsts = [first for a, b in chains for first in range(a, b - joined + 1, joined)]
        if len(firsts) < MIN_WINDOWS:
            break
        windows = np.array(firsts)[:, None] + np.arange(joined)
        lengths.append(path.s.length_m[windows].sum(axis=1).mean())
        squares.append((seen[windows].sum(axis=1) ** 2).mean())
    if len(lengths) < len(JOINED_WINDOWS) - 1:
        return None
    length, square = np.array(lengths), np.array(squares)
    times = length / length[0]
    laws = np.stack([np.ones(len(times)), times, times**2], axis=1)
    weight = 1.0 / (np.maximum(square, 1e-300) * np.sqrt(times))
    return length, np.asarray(nnls(laws * weight[:, None], square * weight)[0])


def _chains(path: Path) -> list[tuple[int, int]]:
    observations = path.s
    posed = np.asarray(observations.usable[:, POSE_CHANNELS].all(axis=1))
    follows = (np.diff(observations.run) == 0) & (np.diff(observations.window) == 1)
    breaks = np.flatnonzero(~(follows & posed[1:] & posed[:-1])) + 1
    edges = [0, *breaks.tolist(), len(posed)]
    return [(a, b) for a, b in pairwise(edges) if posed[a]]


INTERACTION: Final = "interaction"
#: radii that scatter between recordings: noise that windows share
SCATTER: Final = "recordings"
#: fewest recordings that show a scatter beside their mean
MIN_RECORDINGS: Final = 3
#: largest relative scatter of radii: the largest plausible step between sessions
LARGEST_SCATTER: Final = 1e-2
#: fewest offsets: a recalibration and an effect make some too
MIN_CELLS: Final = 8
#: standard deviation of the lack of fit, in noise levels of one run
LACK_OF_FIT_SCALES: Final = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0)


@dataclass(frozen=True, slots=True, eq=False)
class BlockColumns:
    """Own columns, of one number, of blocks of one length."""

    group: int  #: of the length in `Blocks.alike`
    same: IntArray | slice  #: which of the blocks of that length
    part: FloatArray  #: shape (n, length, q)


class Blocks:
    """Rows of the whitened system, a condition's together, conditions of as many rows side by side."""

    def __init__(self, s: Observations) -> None:
        unit, channel = np.nonzero(s.usable)
        _, condition, count = np.unique(s.condition[unit], return_inverse=True, return_counts=True)
        #: shape (n_rows,): of each ordered row among the usable (unit, channel) rows
        self.order = np.lexsort((condition, count[condition]))
        first = np.flatnonzero(np.diff(condition[self.order], prepend=-1))
        #: shape (n_blocks + 1,): rows of block b stand at ``starts[b]:starts[b + 1]``
        self.starts = np.append(first, len(self.order))
        #: shape (n_rows,): of each ordered row
        self.unit, self.channel = unit[self.order], channel[self.order]

    def __len__(self) -> int:
        return len(self.starts) - 1

    @cached_property
    def alike(self) -> list[tuple[IntArray, IntArray]]:
        """Blocks of each length: their numbers (n,), and the rows of each (n, length)."""
        lengths = np.diff(self.starts)
        alike = (np.flatnonzero(lengths == length) for length in np.unique(lengths))
        return [(numbers, self.starts[numbers][:, None] + np.arange(lengths[numbers[0]])) for numbers in alike]

    def alike_rows(self, values: FloatArray, group: int) -> FloatArray:
        """Return values (n_rows, k) of blocks of one length, a view (n, length, k)."""
        _, places = self.alike[group]
        return values[places[0, 0] : places[-1, -1] + 1].reshape(*places.shape, values.shape[1])

    def stacked(self, parts: Sequence[FloatArray]) -> list[BlockColumns]:
        """Join columns of each block's own, (n_rows of the block, q), where of one shape."""
        stacks = []
        for group, (numbers, _) in enumerate(self.alike):
            widths = np.array([parts[number].shape[1] for number in numbers])
            for width in np.unique(widths[widths > 0]):
                same = np.flatnonzero(widths == width)
                part = np.stack([parts[number] for number in numbers[same]])
                stacks.append(BlockColumns(group, slice(None) if len(same) == len(numbers) else same, part))
        return stacks

    def slices(self) -> list[slice]:
        """Return the rows of each block."""
        return [slice(int(a), int(b)) for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class LackOfFit:
    """One component of lack of fit."""

    name: str  #: what varies, and from where to where
    stacks: Sequence[BlockColumns] = ()  #: whitened, scaled to about the noise of a run
    common: FloatArray | None = None  #: shape (n_rows, q): whitened columns common to all blocks
    relative: float = 0.0  #: scatter of radii between recordings at a scale of 1

    @property
    def is_interaction(self) -> bool:
        """Whether it is a trend under other loads, speeds or turns."""
        return self.name == INTERACTION

    @property
    def is_scatter(self) -> bool:
        """Whether it is noise that windows of a recording share."""
        return self.name == SCATTER

    def is_plausible(self, scale: float) -> bool:
        """Whether radii scatter by so much."""
        return self.relative * scale <= LARGEST_SCATTER


def lack_of_fit_components(path: Path, noise: Noise, blocks: Blocks) -> list[LackOfFit]:
    """Return the components of lack of fit that these runs could show, linearised about `path`.

    What was driven once has no offset of its own.
    """
    s, unit = path.s, blocks.unit

    def whitened(columns: FloatArray) -> FloatArray:
        return (noise.whitener @ np.where(s.usable[:, :, None], columns, 0.0))[s.usable][blocks.order]

    calibration = whitened(path.calibration[:, :, :3])
    norm = np.sqrt((calibration**2).sum(axis=0) / max(len(s), 1))
    present = np.flatnonzero(s.usable.any(axis=0))
    wide = np.zeros((*s.usable.shape, len(present)))
    wide[:, present, np.arange(len(present))] = noise.floor[:, present]
    own, white = calibration / np.maximum(norm, 1e-12), whitened(wide)
    offsets = {
        "calibration": own,
        "radii": own[:, :2],
        "track": own[:, 2:],
        "channels": white,
        "heading": white[:, present == 3],
        "position": white[:, present < 3],
    }
    kinds = []
    cell, condition = (np.unique(labels, return_inverse=True)[1] for labels in (s.cell, s.condition))
    for grouping, cells in (("condition", s.condition), ("cell", s.cell)):
        by_cell, repeated = grouping == "cell", np.bincount(cells)[cells] > 1
        if len(np.unique(cells[repeated])) < MIN_CELLS or (by_cell and np.array_equal(cell, condition)):
            continue
        for name, columns in offsets.items():
            if not columns.any() or (by_cell and name not in ("calibration", "channels")):
                continue
            parts = [_spread(columns[rows], cells[unit[rows]], repeated[unit[rows]]) for rows in blocks.slices()]
            kinds.append(LackOfFit(f"{name} by {grouping}", blocks.stacked(parts)))
    run = s.run[unit]
    if s.windowed and len(np.unique(run)) >= MIN_RECORDINGS and own[:, :2].any():
        radii = own[:, :2].sum(axis=1, keepdims=True) if s.by_front else own[:, :2]
        columns = _spread(radii, run, np.ones(len(run), dtype=bool))
        kinds.append(LackOfFit(SCATTER, common=columns, relative=float(np.mean(1.0 / norm[:2]))))
    for number, trend in enumerate((components.ambient_trends(path), *components.ambient_interactions(path))):
        if trend.shape[2]:
            white = whitened(trend)
            scaled = white / np.maximum(np.sqrt((white**2).mean(axis=0)), 1e-12)
            kinds.append(LackOfFit("surroundings" if number == 0 else INTERACTION, common=scaled))
    return kinds


def _spread(columns: FloatArray, cells: IntArray, repeated: BoolArray) -> FloatArray:
    labels, index = np.unique(cells[repeated], return_inverse=True)
    columns_by_cell = np.zeros((len(columns), len(labels), columns.shape[1]))
    columns_by_cell[np.flatnonzero(repeated), index] = columns[repeated]
    return columns_by_cell.reshape(len(columns), -1)
