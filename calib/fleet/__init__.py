"""Many vehicles: one task a vehicle and file, sums that add, and the fleet's view."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any, Final
from warnings import catch_warnings

import numpy as np
from scipy.special import chdtri, digamma, polygamma, stdtr, stdtrit

from calib.documents import plain_fields
from calib.types import BoolArray, FloatArray, floats, grouped

COVERAGE: Final = 0.95
#: false discovery rate of named vehicles (Benjamini and Hochberg): each costs a visit
FALSE_SHARE: Final = 0.01
#: family-wise error rate of a short list (Holm)
FALSE_CHANCE: Final = 0.01
#: median of |z| of a standard normal
MEDIAN_ABS_NORMAL: Final = 0.6744897501960817
#: robust standard deviations of vehicles omitted from the fleet's mean and spread
OUTLIER_SPREADS: Final = 5.0
#: median deviations to which values are clipped before labels are compared
CLIP_DEVIATIONS: Final = 4.0
#: keeps quotients finite where all is equal
SMALLEST_VARIANCE: Final = 1e-300


@dataclass(frozen=True, slots=True)
class Population:
    """A quantity over the fleet."""

    mean: float
    mean_ci95: tuple[float, float]
    spread: float
    spread_ci95: tuple[float, float]
    within: float
    n: int


def population(values: FloatArray, std: FloatArray) -> Population | None:
    """Return a quantity's mean and spread over vehicles; None with fewer than three."""
    n = len(values)
    if n < 3:
        return None
    variance = std**2
    tail = 0.5 * (1.0 - COVERAGE)
    targets = (float(n - 1), float(chdtri(n - 1, 1 - tail)), float(chdtri(n - 1, tail)))
    between, high, low = (_between(values, variance, target) for target in targets)
    weight = 1.0 / (between + variance)
    mean = float(weight @ values / weight.sum())
    spread_of_mean = float(np.sqrt(weight @ (values - mean) ** 2 / (n - 1) / weight.sum()))
    half = float(stdtrit(n - 1, 1 - tail)) * spread_of_mean
    within, spread, *spread_ci95 = np.sqrt([np.median(variance), between, low, high]).tolist()
    return Population(mean, (mean - half, mean + half), spread, (spread_ci95[0], spread_ci95[1]), within, n)


def _between(values: FloatArray, variance: FloatArray, target: float) -> float:
    variance = np.maximum(variance, 1e-30 + 1e-12 * float(np.max(variance)))

    def excess(between: float) -> float:
        weight = 1.0 / (between + variance)
        return float(weight @ (values - weight @ values / weight.sum()) ** 2) - target

    # weights are at most 1 / between, so Q is at most the squares over it
    return _root(excess, float(np.sum((values - values.mean()) ** 2)) / target)


def _root(falling: Callable[[float], float], high: float) -> float:
    from scipy.optimize import brentq

    if falling(0.0) <= 0.0:
        return 0.0
    return float(brentq(falling, 0.0, 2.0 * high, xtol=1e-13 * high + 1e-300, rtol=1e-14))


def outlying(values: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each vehicle's distance from the fleet in standard deviations, and its p-value by Student's t."""
    away = np.abs(values - np.median(values))
    variance = std**2 + SMALLEST_VARIANCE

    def excess(spread: float) -> float:
        return float(np.median(away / np.sqrt(spread**2 + variance))) - MEDIAN_ABS_NORMAL

    spread = _root(excess, float(np.median(away)) / MEDIAN_ABS_NORMAL)
    usual = away / np.sqrt(spread**2 + variance) < OUTLIER_SPREADS
    fleet = population(values[usual], std[usual])
    if fleet is None:
        return np.zeros(len(values)), np.ones(len(values))
    z = (values - fleet.mean) / np.sqrt(fleet.spread**2 * (1.0 + 1.0 / fleet.n) + variance)
    return np.asarray(z), np.asarray(2.0 * stdtr(fleet.n - 1.0, -np.abs(z)))


def false_discovery(p_values: FloatArray, share: float = FALSE_SHARE, method: str = "fdr_bh") -> BoolArray:
    """Return which findings are significant at a false discovery rate of `share`; NaN is no finding."""
    from statsmodels.stats.multitest import multipletests

    p = floats(p_values)
    significant, known = np.zeros(p.shape, dtype=np.bool_), np.isfinite(p)
    if known.any():
        significant[known] = multipletests(p[known], share, method)[0]
    return significant


def familywise(p_values: FloatArray, chance: float = FALSE_CHANCE) -> BoolArray:
    """Return which findings are significant at a family-wise error rate of `chance`; NaN is no finding."""
    return false_discovery(p_values, chance, "holm")


def moderated(variance: FloatArray, dof: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return wheels' variances shrunk towards the fleet's, and their degrees of freedom (Smyth 2004).

    The prior's are two standard errors low, and no variance falls: one wheel may scatter as no other.
    """
    n, half = len(dof), 0.5 * dof
    if n < 2 * FEWEST_COMPARED:
        return variance, dof
    log = np.log(variance) - digamma(half) + np.log(half)
    squares = (log - log.mean()) ** 2 * n / (n - 1) - polygamma(1, half)
    # two wheels share sessions: half as many are independent
    excess, prior = float(squares.mean() + 2.0 * squares.std() / np.sqrt(0.5 * n)), 0.5 * float(half.sum())
    if excess > 0.0:
        # trigamma is just above 1 / x + 1 / (2 x^2)
        prior = min(prior, (1.0 + np.sqrt(1.0 + 2.0 * excess)) / (2.0 * excess))
    usual = np.exp(log.mean() + digamma(prior) - np.log(prior))
    return np.maximum((prior * usual + half * variance) / (prior + half), variance), 2.0 * (prior + half)


@dataclass(frozen=True, slots=True)
class Difference:
    """Mean of a label's vehicles minus that of the others."""

    size: float
    ci95: tuple[float, float] = field(metadata={"json": "size_ci95"})
    p_value: float
    n_showing: int


def difference_of(values: FloatArray, inside: BoolArray) -> Difference:
    """Compare the vehicles inside a label with the others by Welch's test."""
    from scipy.stats import ttest_ind

    one, other = (_clipped(values[side]) for side in (inside, ~inside))
    with catch_warnings(action="ignore"):  # equal vehicles: NaN
        test = ttest_ind(one, other, equal_var=False)
        low, high = map(float, test.confidence_interval(COVERAGE))
    size = float(one.mean() - other.mean())
    away = values[inside] - float(np.median(values[~inside]))
    return Difference(size, (low, high), float(test.pvalue), int((np.sign(size) * away > 0.5 * abs(size)).sum()))


def _clipped(values: FloatArray) -> FloatArray:
    median = float(np.median(values))
    width = CLIP_DEVIATIONS * max(float(np.median(np.abs(values - median))), SMALLEST_VARIANCE)
    return np.clip(values, median - width, median + width)


#: fewest vehicles judged against each other, or with a label
FEWEST_COMPARED: Final = 5
#: fewest vehicles that share a finding
FEWEST_SHARING: Final = 3


@dataclass(frozen=True, slots=True)
class VehicleResult:
    """Result of a task for one vehicle: id, key of its files, plain JSON values; `why` it failed."""

    name: str
    key: str
    values: Mapping[str, Any] = field(default_factory=dict)
    why: str = ""

    @property
    def status(self) -> str:
        """``done`` or ``failed``."""
        return "failed" if self.why else "done"


Labels = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class Outlier:
    """A vehicle far from the fleet's mean in a quantity."""

    vehicle: str = field(metadata={"json": "id"})
    quantity: str
    value: float
    fleet: float = field(metadata={"json": False})
    z: float

    @property
    def why(self) -> str:
        """The sentence for people."""
        name, scale, unit = shown_quantity(self.quantity)
        value, away = f"{scale * self.value:.6g} {unit}", f"{scale * (self.value - self.fleet):+.3g} {unit}"
        value, away = value.rstrip(), f"{away.rstrip()} from the fleet's mean"
        return f"{name}: {value}, {away} ({abs(self.z):.1f} standard deviations)"

    def to_dict(self) -> dict[str, object]:
        """Return it as plain JSON values."""
        return plain_fields(self, why=self.why)


@dataclass(frozen=True, slots=True)
class LabelDifference:
    """A quantity in which a label's vehicles differ from the others."""

    label: str
    value: str
    quantity: str
    n_vehicles: int
    difference: Difference = field(metadata={"json": False})

    @property
    def what(self) -> str:
        """The difference."""
        name, scale, unit = shown_quantity(self.quantity)
        return f"{name} {f'{scale * self.difference.size:+.3g} {unit}'.rstrip()} from the others'"

    @property
    def sentence(self) -> str:
        """The sentence for people."""
        return f"{self.difference.n_showing} of {self.n_vehicles} vehicles with {self.label} {self.value}: {self.what}"

    def to_dict(self) -> dict[str, object]:
        """Return it as plain JSON values."""
        return plain_fields(self, what=self.what, **plain_fields(self.difference), sentence=self.sentence)


@dataclass(frozen=True, slots=True)
class Quantities:
    """What a fleet shows in its vehicles' quantities."""

    populations: Mapping[str, Population]
    outliers: tuple[Outlier, ...]
    common: tuple[LabelDifference, ...]


#: quantity -> values, shape (n_vehicles,), NaN where a vehicle lacks it
Columns = Mapping[str, FloatArray]


def quantities_of(
    vehicles: Sequence[str], values: Columns, std: Columns, labels: Labels, drifting: frozenset[str] = frozenset()
) -> Quantities:
    """Return what a fleet shows in its vehicles' quantities; see `Columns` and `Labels`."""
    compared = [name for name, column in values.items() if np.isfinite(column).sum() >= FEWEST_COMPARED]
    common = _differences(vehicles, {name: values[name] for name in compared}, labels)
    own = {name: column.copy() for name, column in values.items()}
    for cause, inside in common:
        own[cause.quantity][inside] -= cause.difference.size
    apart = _outliers_of(vehicles, {name: own[name] for name in compared}, values, std)
    usual = ~np.isin(vehicles, [*(outlier.vehicle for outlier in apart), *drifting])
    populations = {}
    for name, column in own.items():
        known = usual & np.isfinite(column)
        if estimate := population(column[known], std[name][known]):
            populations[name] = estimate
    means = {name: populations[name].mean for name in compared if name in populations}
    middle = {name: float(np.nanmean(own[name])) for name in compared if name not in means} | means
    stay = (replace(one, fleet=one.fleet + middle[one.quantity]) for one in apart if one.vehicle not in drifting)
    return Quantities(populations, tuple(stay), tuple(cause for cause, _ in common))


def _labelled(vehicles: Sequence[str], labels: Labels) -> Iterator[tuple[str, str, BoolArray]]:
    for label, of_vehicle in sorted(labels.items()):
        own = np.array([of_vehicle.get(vehicle, "") for vehicle in vehicles], dtype=np.object_)
        yield from ((label, value, own == value) for value in sorted({*own} - {""}))


def _differences(vehicles: Sequence[str], values: Columns, labels: Labels) -> list[tuple[LabelDifference, BoolArray]]:
    # the most significant first: beside one that differs all others seem to, the other way
    residual, labelled = {name: column.copy() for name, column in values.items()}, [*_labelled(vehicles, labels)]
    differences = []
    for _ in range(len(labelled) * len(residual)):
        candidates = []
        for label, value, with_label in labelled:
            for name, column in residual.items():
                known = np.isfinite(column)
                inside = with_label[known]
                if FEWEST_COMPARED <= inside.sum() <= (~inside).sum():  # the larger part is the fleet itself
                    difference = difference_of(column[known], inside)
                    candidates.append((LabelDifference(label, value, name, int(inside.sum()), difference), with_label))
        significant = familywise(np.array([one.difference.p_value for one, _ in candidates]))
        if not (further := [*compress(candidates, significant)]):
            break
        clearest, inside = min(further, key=lambda one: (one[0].difference.p_value, one[0].value, one[0].quantity))
        residual[clearest.quantity][inside] -= clearest.difference.size
        differences.append((clearest, inside))
    return differences


def _outliers_of(vehicles: Sequence[str], own: Columns, values: Columns, std: Columns) -> tuple[Outlier, ...]:
    # `Outlier.fleet` holds the shift by labels; the mean is added later
    names = list(own)
    z, p_value = np.zeros((len(vehicles), len(names))), np.full((len(vehicles), len(names)), np.nan)
    for k, name in enumerate(names):
        known = np.isfinite(own[name])
        z[known, k], p_value[known, k] = outlying(own[name][known], std[name][known])
    outliers = []
    for row in map(int, np.flatnonzero(false_discovery(p_value).any(axis=1))):
        name = names[k := int(np.argmax(np.abs(z[row])))]
        value = float(values[name][row])
        outliers.append(Outlier(vehicles[row], name, value, value - float(own[name][row]), float(z[row, k])))
    return tuple(sorted(outliers, key=lambda one: (-abs(one.z), one.vehicle)))


def shown_quantity(quantity: str) -> tuple[str, float, str]:
    """Return a quantity's name for people, and factor to and name of its unit there."""
    by_slip = ("_s2_per_m2", 1.0, "s²/m²"), ("_s2_per_m", 1.0, "s²/m")
    lengths = ("_m_per_N", 1e6, "µm/N"), ("_m", 1e3, "mm")
    for suffix, scale, unit in (*by_slip, *lengths, ("_rad", 1e3, "mrad"), ("_s", 1e3, "ms")):
        if quantity.endswith(suffix):
            return quantity.removesuffix(suffix).removesuffix("_ref").replace("_", " "), scale, unit
    return quantity.replace("_", " "), 1.0, ""


@dataclass(frozen=True, slots=True)
class SharedCause:
    """A finding that many vehicles share, of the whole fleet or of a label."""

    what: str
    label: str
    value: str
    n_showing: int
    n_vehicles: int
    p_value: float = 1.0

    @property
    def sentence(self) -> str:
        """The sentence for people."""
        whose = f"vehicles with {self.label} {self.value}" if self.label else "vehicles"
        return f"{self.n_showing} of {self.n_vehicles} {whose}: {self.what}"

    def to_dict(self) -> dict[str, object]:
        """Return it as plain JSON values."""
        return plain_fields(self, sentence=self.sentence)


def shared_causes(records: Sequence[VehicleResult], labels: Labels) -> tuple[SharedCause, ...]:
    """Return what many vehicles share, the whole fleet first."""
    done = [record for record in records if record.status == "done"]
    names = [record.name for record in done]
    findings = _findings(done)
    counted = Counter(what for codes in findings for what in codes)
    often = [(what, count) for what, count in counted.most_common() if count >= FEWEST_SHARING]
    whole = [SharedCause(what, "", "", count, len(done)) for what, count in often]
    by_label: list[SharedCause] = []
    for what, _ in sorted(often):
        shows = np.array([what in codes for codes in findings])
        by_label += [_compared(what, *having, shows) for having in _labelled(names, labels)]
    special = compress(by_label, false_discovery(np.array([cause.p_value for cause in by_label])))
    return (*whole, *sorted(special, key=lambda cause: (cause.p_value, cause.what, cause.value)))


def _findings(records: Sequence[VehicleResult]) -> list[set[str]]:
    places = _places(records)
    findings = []
    for record in records:
        codes = {str(code) for level in ("wrong", "suspicious") for code in record.values.get(level, ())}
        for cause in record.values.get("causes", ()):
            effect = str(cause["effect"])
            at, size = cause.get("x_m", np.inf), cause.get("size_m", 0.0)
            x_m = next((x_m for x_m in places.get(effect, ()) if abs(at - x_m) <= size), None)
            codes.add(effect if x_m is None else f"{effect.replace('_', ' ')} at x = {x_m:g} m")
        findings.append(codes)
    return findings


def _places(records: Sequence[VehicleResult]) -> dict[str, list[float]]:
    causes = [cause for record in records for cause in record.values.get("causes", ()) if "x_m" in cause]
    named = grouped((str(cause["effect"]), (float(cause["x_m"]), float(cause["size_m"]))) for cause in causes)
    places: dict[str, list[float]] = {}
    for effect, pairs in named.items():
        x, size = np.array(pairs).T
        near = np.abs(x[:, None] - x) <= size[:, None]
        left = np.ones(len(x), dtype=np.bool_)
        while (counts := np.where(left, (near & left).sum(axis=1), 0)).max() >= FEWEST_SHARING:
            middle = int(np.argmax(counts))
            places.setdefault(effect, []).append(float(x[middle]))
            left &= ~near[middle]
    return places


def _compared(what: str, label: str, value: str, inside: BoolArray, shows: BoolArray) -> SharedCause:
    from scipy.stats import fisher_exact

    table = [[int((shows & side).sum()), int((~shows & side).sum())] for side in (inside, ~inside)]
    p_value = float(fisher_exact(table, alternative="greater").pvalue)
    return SharedCause(what, label, value, table[0][0], int(inside.sum()), p_value)
