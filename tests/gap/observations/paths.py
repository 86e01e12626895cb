"""True paths with exact counts and poses, for the tests of this room; told in complex numbers, not by calib."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.campaign.model import Campaign, Logs, RunTable
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.vehicle import Vehicle

TRACK_M, RADIUS_M, COUNTS = 0.5, 0.1, 1e6
Piece = tuple[float, float]
ROUTE: list[Piece] = [(3.0, 0.0), (1.5, 1.0), (2.0, 0.0), (1.0, -0.8)]


class Truth:
    """One path: pieces of (length, curvature) in steps of a centimetre or so, driven at half a metre a second."""

    def __init__(self, pieces: Sequence[Piece], start: complex = 0.0, heading: float = 0.0, steps: int = 600) -> None:
        way = sum(abs(length) for length, _ in pieces)
        ds, turn = [0.0], [0.0]
        for length, kappa in pieces:
            n = max(2, round(steps * abs(length) / way))
            ds += [length / n] * n
            turn += [abs(length) / n * kappa] * n
        self.ds, turns = np.array(ds), np.array(turn)
        self.heading = heading + np.cumsum(turns)
        # exact chords of exact arcs
        chord = self.ds * np.sinc(0.5 * turns / np.pi)
        self.place = start + np.cumsum(chord * np.exp(1j * (self.heading - 0.5 * turns)))
        self.left = np.cumsum(self.ds - 0.5 * TRACK_M * turns)
        self.right = np.cumsum(self.ds + 0.5 * TRACK_M * turns)
        self.t = np.cumsum(np.abs(self.ds)) / 0.5 + 1e-3 * np.arange(len(ds))

    def counts(self) -> dict[str, np.ndarray]:
        """Time and exact counts of both wheels."""
        scale = COUNTS / (2 * np.pi * RADIUS_M)
        return {"t_s": self.t, "counts_left": self.left * scale, "counts_right": self.right * scale}

    def end(self) -> np.ndarray:
        """End pose seen from the start."""
        moved = (self.place[-1] - self.place[0]) * np.exp(-1j * self.heading[0])
        return np.array([moved.real, moved.imag, self.heading[-1] - self.heading[0]])


def seen(truth: Truth, sensor: complex = 0.0, yaw: float = 0.0, *, in_map: bool) -> dict[str, np.ndarray]:
    """Poses of a sensor on the vehicle: in the map, or as its own motion since its own start pose."""
    place = truth.place + sensor * np.exp(1j * truth.heading)
    heading = truth.heading + yaw
    if not in_map:
        place, heading = (place - place[0]) * np.exp(-1j * heading[0]), heading - heading[0]
    return {"ref_x_m": place.real, "ref_y_m": place.imag, "ref_theta_rad": heading}


def campaign_of(
    logs: Sequence[dict[str, np.ndarray]],
    reference: Reference | None = None,
    numbers: dict[str, np.ndarray] | None = None,
    **labels: Sequence[str],
) -> Campaign:
    """A campaign of one log a run."""
    n = len(logs)
    names = sorted({name for log in logs for name in log})
    lengths = [len(log["t_s"]) for log in logs]
    columns = {
        name: np.concatenate([log.get(name, np.full(k, np.nan)) for log, k in zip(logs, lengths, strict=True)])
        for name in names
    }
    return Campaign(
        root=None,
        name="made",
        simulated=True,
        vehicle=Vehicle(track_m=TRACK_M, wheel_radius_m=RADIUS_M),
        encoder=Encoder(COUNTS, COUNTS),
        model=OdometryModel(RADIUS_M, RADIUS_M, TRACK_M, 300.0),
        rangefinder=Rangefinder(),
        reference=reference or Reference(),
        runs=RunTable(
            labels={"run_id": np.array([f"r{i}" for i in range(n)]), **{k: np.array(v) for k, v in labels.items()}},
            numbers=numbers or {},
            excluded=np.zeros(n, dtype=bool),
            line=np.arange(n) + 2,
        ),
        logs=Logs(np.concatenate(([0], np.cumsum(lengths))).astype(np.int64), columns),
    )
