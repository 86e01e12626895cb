"""The result of `calib geometry`: values with intervals, what was not determined, and the residuals of each route."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.kinematics.adequacy import GeometryVerdict, Judgement
from calib.kinematics.blunders import Fault
from calib.kinematics.delays import Delay
from calib.kinematics.umbmark import Umbmark
from calib.kinematics.uncertainty import Freedom
from calib.result import Result
from calib.types import FloatArray, IntArray

if TYPE_CHECKING:
    from pandas import DataFrame

#: residual channels and their units
CHANNELS: Final = ("x_m", "y_m", "theta_rad")


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter: nominal value, estimate, sd, 95 % interval, degrees of freedom of what runs say."""

    name: str
    nominal: float
    value: float
    std: float
    ci95: tuple[float, float]
    dof: float

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as plain values."""
        return {
            "value": self.value,
            "sd": self.std,
            "ci95": list(self.ci95),
            "dof": self.dof,
            "nominal": self.nominal,
        }


@dataclass(frozen=True, slots=True)
class RouteResidual:
    """Residuals of one kind of route: root mean squares before and after, and what is left on average.

    Each triple is along, across (m) and in heading (rad).
    """

    kind: str
    n: int
    before_rms: tuple[float, float, float]
    after_rms: tuple[float, float, float]
    after_mean: tuple[float, float, float]

    def to_dict(self) -> dict[str, Any]:
        """Return the row as plain values."""
        return {
            "kind": self.kind,
            "n": self.n,
            "before_rms": dict(zip(CHANNELS, self.before_rms, strict=True)),
            "after_rms": dict(zip(CHANNELS, self.after_rms, strict=True)),
            "after_mean": dict(zip(CHANNELS, self.after_mean, strict=True)),
        }


@dataclass(frozen=True, slots=True)
class Transfer:
    """End position error of held-out runs of the estimate, before and after."""

    left_out: str
    n: int
    before_rms_m: float
    after_rms_m: float


@dataclass(frozen=True, slots=True, eq=False)
class RunTrace:
    """One run: the sensor's path by nominal and calibrated odometry, and by the reference, aligned.

    With a reference along the path, the paths are rotated and shifted as a whole, since its first pose is as noisy as
    any; with an end pose alone they begin at the start.
    """

    #: labels
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
    #: True where a program made the data
    simulated: bool
    #: ``differential``, ``tricycle`` or ``mecanum``
    drive: str
    #: what drives the odometry: ``rear``, ``front`` or ``wheels``
    source: str
    #: ``end_poses`` or ``windows``
    using: str
    #: runs, and stretches of them, that were used
    n_runs: int
    n_segments: int
    #: parameters that the data determine
    estimates: tuple[Estimate, ...]
    #: joint covariance in the same order, shape (n_estimates, n_estimates)
    covariance: FloatArray
    #: parameters that the data cannot determine; they stayed at their nominal value
    undetermined: tuple[str, ...]
    #: parameters that were not asked for, and those undetermined, at their nominal value
    held: Mapping[str, float]
    #: what was taken for independent (``run``, ``block``, ``session``, ``route``), and how many there are
    clusters: tuple[str, int]
    #: standard deviations of the noise's components
    noise: Mapping[str, float]
    #: along, across (m), heading (rad), after the calibration
    residual_rms: tuple[float, float, float]
    #: runs that the noise cannot explain
    outliers: tuple[str, ...]
    #: blunders that were recognised
    faults: tuple[Fault, ...]
    #: whether the data met a mirrored solution better, which was turned round
    mirrored: bool
    #: what squares both ways say on their own
    umbmark: Umbmark
    #: table by route
    routes: tuple[RouteResidual, ...]
    #: recordings held out in turn, where that was asked for
    transfer: tuple[Transfer, ...] = ()
    #: what the user should know
    notes: tuple[str, ...] = ()
    #: delay of each recording, where they differ beyond chance; ``delay_s`` is then what they have in common
    delays: tuple[Delay, ...] = ()
    #: path of an input -> its SHA-256
    inputs: Mapping[str, str] = field(default_factory=dict)
    #: paths before and after, for a figure; empty where nobody asked
    paths: tuple[RunTrace, ...] = ()
    #: degrees of freedom of sums of the estimates; None: those of the estimates themselves hold
    freedom: Freedom | None = None
    #: whether the estimates are to be used, with the figures and reasons; None where nobody judged
    judgement: Judgement | None = None

    def __getitem__(self, name: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(f"{name}: found no estimate; there are {', '.join(e.name for e in self.estimates)}")

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter, those held at their nominal value."""
        return {**self.held, **{estimate.name: estimate.value for estimate in self.estimates}}

    @property
    def verdict(self) -> GeometryVerdict:
        """Whether the estimates are to be used: ``calibrated``, ``doubtful`` or ``wrong``."""
        if self.judgement is not None:
            return self.judgement.verdict
        return GeometryVerdict.WRONG if self.faults else GeometryVerdict.CALIBRATED

    @property
    def why(self) -> tuple[str, ...]:
        """What speaks against the estimates; empty where they are to be used."""
        if not self.estimates:
            return ("these runs determine no parameter",)
        return tuple(fault.text for fault in self.faults) if self.judgement is None else self.judgement.why

    @property
    def misfit(self) -> bool:
        """Whether the residuals or the lengths themselves speak against the estimates, blunders aside."""
        faults = {fault.text for fault in self.faults}
        return self.judgement is not None and any(reason not in faults for reason in self.judgement.why)

    @property
    def passed(self) -> bool:
        """Whether the estimates are to be used."""
        return self.verdict is GeometryVerdict.CALIBRATED and bool(self.estimates)

    @property
    def table(self) -> DataFrame:
        """Estimates as a pandas table, a row a parameter."""
        from pandas import DataFrame

        rows = [{"parameter": one.name, **one.to_dict()} for one in self.estimates]
        low, high = ([row["ci95"][at] for row in rows] for at in (0, 1))
        table = DataFrame(rows, columns=["parameter", "nominal", "value", "sd", "dof"])
        return table.assign(ci95_low=low, ci95_high=high).set_index("parameter")

    def correlation(self) -> FloatArray:
        """Return the correlation matrix of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(std, std))

    def ratio(self, over: str, under: str) -> Estimate:
        """Return the ratio of two parameters with its interval, as the joint covariance gives it.

        `over`, `under`: names of parameters that were determined.
        """
        return self._derived(f"{over}/{under}", {over: 1.0}, {under: 1.0})

    def track_over_radius(self) -> Estimate:
        """Return the track over the mean radius, which turns alone determine and closed paths determine best."""
        return self._derived("track over mean radius", {"track_m": 1.0}, {"radius_left_m": 0.5, "radius_right_m": 0.5})

    def _derived(self, name: str, over: Mapping[str, float], under: Mapping[str, float]) -> Estimate:
        from scipy.special import stdtrit

        parts = [sum(weight * self[part].value for part, weight in side.items()) for side in (over, under)]
        nominal = [sum(weight * self[part].nominal for part, weight in side.items()) for side in (over, under)]
        value = parts[0] / parts[1]
        slope = np.array(
            [
                over.get(estimate.name, 0.0) / parts[1] - value * under.get(estimate.name, 0.0) / parts[1]
                for estimate in self.estimates
            ]
        )
        std = float(np.sqrt(max(slope @ self.covariance @ slope, 0.0)))
        dof = self.freedom.of(slope) if self.freedom else min(self[part].dof for part in (*over, *under))
        half = std * float(stdtrit(dof, 0.975))
        return Estimate(name, nominal[0] / nominal[1], value, std, (value - half, value + half), dof)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values: the keys of ``calib geometry --json``."""
        parameters = {e.name: e.to_dict() for e in self.estimates if e.name != "delay_s"}
        common_delay = next((e.to_dict() for e in self.estimates if e.name == "delay_s"), {})
        return {
            "name": self.name,
            "simulated": self.simulated,
            "drive": self.drive,
            "from": self.source,
            "using": self.using,
            "n_runs": self.n_runs,
            "n_segments": self.n_segments,
            "parameters": parameters,
            "undetermined": list(self.undetermined),
            "held": dict(self.held),
            "covariance": {"names": [e.name for e in self.estimates], "matrix": self.covariance.tolist()},
            "clusters": {"of": self.clusters[0], "n": self.clusters[1]},
            "delay_s": common_delay,
            "delays": [delay.to_dict() for delay in self.delays],
            "noise": dict(self.noise),
            "residual_rms": dict(zip(CHANNELS, self.residual_rms, strict=True)),
            "outliers": list(self.outliers),
            "faults": [asdict(fault) for fault in self.faults],
            "mirrored_solution": self.mirrored,
            "umbmark": self.umbmark.to_dict(),
            "routes": [route.to_dict() for route in self.routes],
            "transfer": [asdict(left_out) for left_out in self.transfer],
            "notes": list(self.notes),
            "verdict": self.verdict.value,
            "adequacy": None if self.judgement is None else asdict(self.judgement.adequacy),
            "why": list(self.why),
        }
