"""The result of `calib geometry`: values with intervals, the size of the noise, residuals of each route."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from calib.documents import Result, plain_fields
from calib.errors import BadInputError
from calib.kinematics.adequacy import GeometryVerdict, Judgement
from calib.kinematics.blunders import Fault
from calib.kinematics.joint_fit import MEAN_RADIUS, Delay
from calib.kinematics.readings import implausible
from calib.kinematics.uncertainty import Freedom
from calib.types import FloatArray, IntArray

if TYPE_CHECKING:
    from pandas import DataFrame


class Channels(NamedTuple):
    """Residuals along the path, across it, and in heading."""

    x_m: float
    y_m: float
    theta_rad: float

    @staticmethod
    def rms(residuals: FloatArray) -> "Channels":
        """Return the root mean square of each column of residuals, shape (n, 3); NaN where none was measured."""
        return Channels(*np.sqrt(Channels.mean(np.square(residuals))).tolist())

    @staticmethod
    def mean(values: FloatArray) -> "Channels":
        """Return the mean of each column of values, shape (n, 3), that are not NaN; NaN without any."""
        n = np.isfinite(values).sum(axis=0)
        return Channels(*(np.nansum(values, axis=0) / np.where(n, n, np.nan)).tolist())


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter: nominal value, estimate, standard deviation, 95 % interval, degrees of freedom."""

    name: str = field(metadata={"json": False})
    nominal: float
    value: float
    std: float = field(metadata={"json": "sd"})
    ci95: tuple[float, float]
    dof: float

    @staticmethod
    def of(name: str, nominal: float, value: float, std: float, dof: float) -> "Estimate":
        """Return an estimate with its interval; see `Estimate`."""
        from scipy.special import stdtrit

        half = std * float(stdtrit(dof, 0.975))
        return Estimate(name, nominal, value, std, (value - half, value + half), dof)

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.ci95[1] - self.ci95[0])


@dataclass(frozen=True, slots=True)
class RouteResidual:
    """Root mean squares of a kind of route before and after the calibration, and the mean after."""

    kind: str
    n: int
    before_rms: Channels
    after_rms: Channels
    after_mean: Channels

    def to_dict(self) -> dict[str, Any]:
        """Return plain values."""
        columns = ("before_rms", "after_rms", "after_mean")
        return plain_fields(self, **{name: getattr(self, name)._asdict() for name in columns})


@dataclass(frozen=True, slots=True)
class Transfer:
    """End position error of held-out runs of the estimate, before and after."""

    left_out: str
    n: int
    before_rms_m: float
    after_rms_m: float


@dataclass(frozen=True, slots=True)
class Umbmark:
    """Radius ratio and track factor from squares driven both ways."""

    #: there are squares of both senses
    applies: bool
    #: right diameter over left one; actual track over nominal one
    E_d: float = float("nan")
    E_b: float = float("nan")
    #: factors on the nominal diameters that keep their mean
    c_left: float = field(default=float("nan"), metadata={"json": "c_L"})
    c_right: float = field(default=float("nan"), metadata={"json": "c_R"})
    #: standard deviations from the scatter of the runs; NaN with fewer than two runs of a sense
    E_d_std: float = field(default=float("nan"), metadata={"json": "E_d_sd"})
    E_b_std: float = field(default=float("nan"), metadata={"json": "E_b_sd"})
    side_m: float = float("nan")
    n_cw: int = 0
    n_ccw: int = 0
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class RunTrace:
    """One run: the sensor's path by nominal and calibrated odometry, and by the reference.

    Of a reference along the path the paths are rotated and shifted as a whole; of an end pose they begin at the start.
    """

    run_id: str
    kind: str
    #: x and y of the sensor in m, shape (n_samples, 2)
    before_m: FloatArray
    after_m: FloatArray
    #: samples that the reference measured; the last one where it is an end pose, shape (n_poses,)
    seen: IntArray
    #: time of these samples, shape (n_poses,)
    t_s: FloatArray
    #: x and y of the sensor by the reference, NaN where it measured headings alone, shape (n_poses, 2)
    reference_m: FloatArray
    #: measured less predicted: along and to the left of the path in m, heading in rad, shape (n_poses, 3)
    residual_before: FloatArray
    residual_after: FloatArray


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Geometry(Result):
    """Radii, track and sensor of a vehicle, estimated together."""

    name: str
    simulated: bool
    #: of `calib.vehicle.DRIVES`
    drive: str
    #: of `calib.campaign.wheels.WHEEL_COLUMNS`
    source: str = field(metadata={"json": "from"})
    #: ``end_poses`` or ``windows``
    using: str
    n_runs: int
    n_segments: int
    estimates: tuple[Estimate, ...] = field(metadata={"json": False})
    #: joint covariance in the same order, shape (n_estimates, n_estimates)
    covariance: FloatArray
    #: held at nominal
    undetermined: tuple[str, ...]
    #: nominal values of parameters not estimated
    held: Mapping[str, float]
    #: independent: ``run``, ``block``, ``session`` or ``route``, and their number
    clusters: tuple[str, int]
    #: standard deviations of the noise's components, and expected of a further journey, larger where runs are few
    noise: Mapping[str, float]
    noise_expected: Mapping[str, float]
    residual_rms: Channels
    outliers: tuple[str, ...]
    faults: tuple[Fault, ...]
    #: whether a mirrored solution was corrected
    mirrored: bool = field(metadata={"json": "mirrored_solution"})
    judgement: Judgement = field(metadata={"json": False})
    umbmark: Umbmark
    routes: tuple[RouteResidual, ...]
    #: recordings held out in turn, where asked for
    transfer: tuple[Transfer, ...] = ()
    notes: tuple[str, ...] = ()
    #: delay of each recording, where they differ significantly; ``delay_s`` is then their common part
    delays: tuple[Delay, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict, metadata={"json": False})
    paths: tuple[RunTrace, ...] = field(default=(), metadata={"json": False})
    #: degrees of freedom of sums of the estimates; None: those of the estimates hold
    freedom: Freedom | None = field(default=None, metadata={"json": False})

    def __getitem__(self, name: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise BadInputError(f"{name}: found no estimate; expected one of {', '.join(e.name for e in self.estimates)}")

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter, those held at their nominal value."""
        return {**self.held, **{estimate.name: estimate.value for estimate in self.estimates}}

    @property
    def verdict(self) -> GeometryVerdict:
        """Whether the estimates are to be used: ``calibrated``, ``doubtful`` or ``wrong``."""
        return self.judgement.verdict

    @property
    def why(self) -> tuple[str, ...]:
        """Reasons against the estimates; empty where they are to be used."""
        return self.judgement.why

    @property
    def misfit(self) -> bool:
        """Whether residuals or lengths speak against the estimates, blunders aside."""
        faults = {fault.text for fault in self.faults}
        return any(reason not in faults for reason in self.why)

    @property
    def passed(self) -> bool:
        """Whether the estimates are to be used."""
        return self.verdict is GeometryVerdict.CALIBRATED

    def doubted(self, fault: Fault) -> "Geometry":
        """Return the result with a fault."""
        verdict = GeometryVerdict.DOUBTFUL if self.passed else self.verdict
        judgement = replace(self.judgement, verdict=verdict, why=(fault.text, *self.why))
        return replace(self, judgement=judgement, faults=(fault,))

    def with_wide_track(self, stated_m: float, fault: Fault) -> "Geometry":
        """Return the result beside the stated track, with the fault where no skid steering makes it so wide."""
        rows = (replace(row, nominal=stated_m) if row.name == "track_m" else row for row in self.estimates)
        wide = replace(self, estimates=tuple(rows))
        return self.doubted(fault) if implausible("track_m", wide.values["track_m"] / stated_m, 1.0, "skid") else wide

    @property
    def table(self) -> "DataFrame":
        """Estimates as a pandas table, a row a parameter."""
        from pandas import DataFrame

        names = ["parameter", "nominal", "value", "sd", "dof", "ci95_low", "ci95_high"]
        rows = [(e.name, e.nominal, e.value, e.std, e.dof, *e.ci95) for e in self.estimates]
        return DataFrame(rows, columns=names).set_index("parameter")

    def correlation(self) -> FloatArray:
        """Return the correlation matrix of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(std, std))

    def ratio(self, over: str, under: str) -> Estimate:
        """Return the ratio of two determined parameters, by name, with its interval by the joint covariance."""
        return self._derived(f"{over}/{under}", {over: 1.0}, {under: 1.0})

    def track_over_radius(self) -> Estimate:
        """Return the track over the mean radius: turns alone determine it."""
        return self._derived("track over mean radius", {"track_m": 1.0}, {"radius_left_m": 0.5, "radius_right_m": 0.5})

    @property
    def scaled(self) -> tuple[Estimate, ...]:
        """Radii and track where they rest on the nominal mean radius (paths that close); else none."""
        lengths = tuple(one for one in self.estimates if one.name in {"radius_left_m", "radius_right_m", "track_m"})
        return lengths if MEAN_RADIUS in self.undetermined and sum("radius" in one.name for one in lengths) == 2 else ()

    @property
    def ratios(self) -> tuple[Estimate, ...]:
        """What is determined of the lengths that the nominal mean radius scales; see `scaled`."""
        names = [one.name for one in self.scaled]
        of_radii = [self._derived("right_over_left", *({name: 1.0} for name in names[1::-1]))] if names else []
        of_track = [replace(self.track_over_radius(), name="track_over_radius")] if "track_m" in names else []
        return (*of_radii, *of_track)

    def _derived(self, name: str, over: Mapping[str, float], under: Mapping[str, float]) -> Estimate:
        over_at, under_at = (
            [sum(weight * getattr(self[part], kind) for part, weight in side.items()) for kind in ("value", "nominal")]
            for side in (over, under)
        )
        value = over_at[0] / under_at[0]
        names = [e.name for e in self.estimates]
        slope = np.array([over.get(name, 0.0) - value * under.get(name, 0.0) for name in names]) / under_at[0]
        std = float(np.sqrt(max(slope @ self.covariance @ slope, 0.0)))
        dof = self.freedom.of(slope) if self.freedom else min(self[part].dof for part in (*over, *under))
        return Estimate.of(name, over_at[1] / under_at[1], value, std, dof)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values: the keys of ``calib geometry --json``."""
        by_name = {e.name: plain_fields(e) for e in self.estimates}
        delay = by_name.pop("delay_s", {})
        mean = {MEAN_RADIUS: sum(one.nominal for one in self.scaled[:2]) / 2.0} if self.scaled else {}
        return plain_fields(
            self,
            parameters=by_name,
            covariance={"names": [e.name for e in self.estimates], "matrix": self.covariance},
            clusters=dict(zip(("of", "n"), self.clusters, strict=True)),
            held={**self.held, **mean},
            ratios={one.name: plain_fields(one) for one in self.ratios},
            delay_s=delay,
            residual_rms=self.residual_rms._asdict(),
            verdict=self.verdict,
            adequacy=self.judgement.adequacy,
            why=self.why,
        )
