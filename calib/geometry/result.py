"""What `calib geometry` finds: values with intervals, what stayed open, and how well each route is met."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.delays import Delay
from calib.geometry.gross import Fault
from calib.geometry.parts import CHANNELS, Estimate, RouteResidual, RunPath, Transfer
from calib.geometry.umbmark import Umbmark
from calib.geometry.words import (
    HEADER,
    ROUTE_HEADER,
    TRANSFER_HEADER,
    cells,
    columns,
    html_table,
    route_cells,
    transfer_cells,
)

__all__ = ["Geometry"]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Radii, track and sensor of a vehicle, estimated together.

    Parameters
    ----------
    name : str
        Name of the campaign.
    simulated : bool
        True where a program made the data.
    drive : str
        ``differential``, ``tricycle`` or ``mecanum``.
    source : str
        What drives the odometry: ``rear``, ``front`` or ``wheels``.
    using : str
        ``end_poses`` or ``windows``.
    n_runs, n_segments : int
        Runs, and stretches of them, that were used.
    estimates : tuple of Estimate
        Parameters that the data determine.
    covariance : array of float, shape (n_estimates, n_estimates)
        Joint covariance in the same order.
    undetermined : tuple of str
        Parameters that the data cannot determine; they stayed at their nominal value.
    held : mapping of str to float
        Parameters that were not asked for, and those undetermined, at their nominal value.
    clusters : tuple of (str, int)
        What was taken for independent (``run``, ``block``, ``session``, ``route``), and how many there are.
    noise : mapping of str to float
        Standard deviations of the noise's components.
    residual_rms : tuple of float
        Along, across (m), heading (rad), after the calibration.
    outliers : tuple of str
        Runs that the noise cannot explain.
    faults : tuple of Fault
        Gross faults that were recognised.
    mirrored : bool
        Whether the data met a mirrored solution better, which was turned round.
    umbmark : Umbmark
        What squares both ways say on their own.
    routes : tuple of RouteResidual
        Table by route.
    transfer : tuple of Transfer
        Recordings left out in turn, where that was asked for.
    notes : tuple of str
        What the user should know.
    delays : tuple of Delay
        Delay of each recording, where they differ beyond chance; ``delay_s`` is then what they have in common.
    inputs : mapping of str to str
        Path of an input -> its SHA-256.
    paths : tuple of RunPath
        Paths before and after, for a figure; empty where nobody asked.
    """

    name: str
    simulated: bool
    drive: str
    source: str
    using: str
    n_runs: int
    n_segments: int
    estimates: tuple[Estimate, ...]
    covariance: FloatArray
    undetermined: tuple[str, ...]
    held: Mapping[str, float]
    clusters: tuple[str, int]
    noise: Mapping[str, float]
    residual_rms: tuple[float, float, float]
    outliers: tuple[str, ...]
    faults: tuple[Fault, ...]
    mirrored: bool
    umbmark: Umbmark
    routes: tuple[RouteResidual, ...]
    transfer: tuple[Transfer, ...] = ()
    notes: tuple[str, ...] = ()
    delays: tuple[Delay, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    paths: tuple[RunPath, ...] = ()

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
    def passed(self) -> bool:
        """Whether no gross fault was recognised and something was determined."""
        return not self.faults and bool(self.estimates)

    def correlation(self) -> FloatArray:
        """Return the correlation matrix of the estimates."""
        std = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(std, std))

    def ratio(self, over: str, under: str) -> Estimate:
        """Return the ratio of two parameters with its interval, as the joint covariance gives it.

        Parameters
        ----------
        over, under : str
            Names of parameters that were determined.
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
        dof = min(self[part].dof for part in (*over, *under))
        half = std * float(stdtrit(dof, 0.975))
        return Estimate(name, nominal[0] / nominal[1], value, std, (value - half, value + half), dof)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values: the keys of ``calib geometry --json``."""
        parameters = {e.name: e.to_dict() for e in self.estimates if e.name != "delay_s"}
        delay = next((e.to_dict() for e in self.estimates if e.name == "delay_s"), {})
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
            "delay_s": delay,
            "delays": [one.to_dict() for one in self.delays],
            "noise": dict(self.noise),
            "residual_rms": dict(zip(CHANNELS, self.residual_rms, strict=True)),
            "outliers": list(self.outliers),
            "faults": [{"code": fault.code, "text": fault.text} for fault in self.faults],
            "mirrored_solution": self.mirrored,
            "umbmark": self.umbmark.to_dict(),
            "routes": [route.to_dict() for route in self.routes],
            "transfer": [one.to_dict() for one in self.transfer],
            "notes": list(self.notes),
        }

    def heading(self) -> str:
        """Return the first line: what was estimated from what."""
        stretches = "end poses" if self.using == "end_poses" else f"{self.n_segments} windows"
        of, n = self.clusters
        runs = f"{self.n_runs} {'run' if self.n_runs == 1 else 'runs'}"
        return f"{self.name}: {self.drive}, {runs}, {stretches}; intervals from {n} {of}s" + (
            " - SIMULATED DATA" if self.simulated else ""
        )

    def sentences(self) -> list[str]:
        """Return what is to be said beside the table of parameters."""
        lines = []
        if self.undetermined:
            lines.append(f"Not determined by these runs, left at the nominal value: {', '.join(self.undetermined)}.")
        lines += [f"Wrong: {fault.text}." for fault in self.faults]
        if self.outliers:
            lines.append(f"Outliers, hardly weighed: {', '.join(self.outliers)}.")
        if self.delays:
            told = ", ".join(f"{one.label} {one.value_s:.4f} s" for one in self.delays)
            lines.append(f"The reference lags by another delay in each recording, taken out of each: {told}.")
        umbmark = self.umbmark
        if umbmark.applies:
            driven = f"{umbmark.n_cw} clockwise, {umbmark.n_ccw} counter-clockwise squares of {umbmark.side_m:.3g} m"
            lines.append(
                f"UMBmark ({driven}): E_d {umbmark.E_d:.5f}, "
                f"E_b {umbmark.E_b:.5f}, c_L {umbmark.c_left:.5f}, c_R {umbmark.c_right:.5f}."
            )
        return lines + list(self.notes)

    def summary(self) -> str:
        """Return the whole result as text."""
        lines = [self.heading(), ""]
        rows = [HEADER, *(cells(estimate) for estimate in self.estimates)]
        lines += columns(rows)
        lines += ["", *self.sentences(), ""]
        lines += columns([ROUTE_HEADER, *(route_cells(route) for route in self.routes)])
        if self.transfer:
            lines += ["", "End position error of what was left out in turn, mm"]
            lines += columns([TRANSFER_HEADER, *(transfer_cells(row) for row in self.transfer)])
        return "\n".join(lines) + "\n"

    def __repr__(self) -> str:
        values = ", ".join(f"{e.name}={e.value:.6g}({e.std:.1g})" for e in self.estimates)
        return f"Geometry({self.name!r}, {self.n_runs} runs, {values})"

    def _repr_html_(self) -> str:
        said = "".join(f"<p>{escape(line)}</p>" for line in self.sentences())
        rows = [HEADER, *(cells(estimate) for estimate in self.estimates)]
        return f"<p>{escape(self.heading())}</p>{html_table(rows)}{said}"
