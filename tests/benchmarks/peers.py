"""Geometry beside its peers on the same recordings: ``python -m tests.benchmarks.peers FOLDER`` prints Markdown.

Peers: `scipy.optimize.least_squares` on the displacements or end poses, as a user would write it in numpy, and the
published procedures (Censi et al. 2013 for the Khepera, UMBmark for the squares) or figures (tricycle, mecanum).
Seconds of the processor, the least of several turns; reading the files is part of none of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from calib.campaign.model import Campaign
from calib.campaign.wheels import WHEEL_COLUMNS
from calib.kinematics.assemble import of_kinds
from calib.kinematics.estimate import estimate_geometry
from tests.kinematics.published import predicted, published, tuples_of
from tests.real import recordings

#: turns of which the quickest counts
TURNS: Final = 3
#: stated scatter of one step of the scan matcher: x and y in m, heading in rad
STEP_SIGMA: Final = np.array([2e-3, 2e-3, 5e-3])
#: OptiTrack at the end of a run: x and y in m, heading in rad
END_SIGMA: Final = np.array([5e-4, 5e-4, 2e-3])
#: residuals beyond so many sigmas weigh less in the robust variant, SciPy's `f_scale`
ROBUST_FROM: Final = 2.0

Values = Mapping[str, float]
#: by whom -> how, and the position error that values leave, in mm
Peers = tuple[dict[str, Callable[[], Values]], Callable[[Values], float]]
#: samples a window of the mecanum robot: some four seconds
WINDOW: Final = 200


def timed(work: Callable[[], Values]) -> tuple[Values, float]:
    """Return what a call gives, and the least seconds of the processor that it took."""
    seconds = []
    for _ in range(TURNS):
        begun = time.process_time()
        values = work()
        seconds.append(time.process_time() - begun)
    return values, min(seconds)


def khepera_peers(folder: Path, name: str) -> dict[str, Callable[[], Values]]:
    """Return the ways to the radii, the track and the laser's yaw of one Khepera recording."""
    source = recordings.available(folder, f"khepera_{name.split('_', maxsplit=1)[0]}/{name}.tuple")
    turned, moved = tuples_of(source)
    campaign = recordings.khepera(folder, name)

    def by_scipy(loss: str) -> Values:
        start = np.array([0.0205, 0.0205, 0.0885, 0.0, 0.0, campaign.reference.sensor_yaw_rad])
        fit = least_squares(
            lambda x: ((predicted(x, turned) - moved) / STEP_SIGMA).ravel(), start, loss=loss, f_scale=ROBUST_FROM
        )
        return dict(zip(("radius_left_m", "radius_right_m", "track_m"), fit.x[:3], strict=True))

    def by_paper() -> Values:
        found = published(turned, moved)
        return {
            "radius_left_m": found["l_diam"] / 2,
            "radius_right_m": found["r_diam"] / 2,
            "track_m": found["axle"],
        }

    return {
        "`geometry`": lambda: of_geometry(campaign),
        "`least_squares`, linear": lambda: by_scipy("linear"),
        "`least_squares`, soft L1": lambda: by_scipy("soft_l1"),
        "published procedure": by_paper,
    }


def of_geometry(
    campaign: Campaign, names: tuple[str, ...] = ("radius_left_m", "radius_right_m", "track_m"), **options: str
) -> Values:
    """Return radii and track, or the named parameters, by `geometry`; nominal where it does not determine them."""
    values = estimate_geometry(campaign, **options).values  # type: ignore[arg-type]
    return {name: values[name] for name in names}


def end_poses(values: np.ndarray, campaign: Campaign) -> np.ndarray:
    """Return the end pose (n_runs, 3) of each run by plain odometry, from rest at the origin."""
    left_m, right_m, track_m = values
    per_rad = campaign.encoder.counts_per_rev_left / (2 * np.pi)
    ends = np.zeros((len(campaign.runs), 3))
    for run in range(len(campaign.runs)):
        log = campaign.logs.of(run)
        left, right = (np.diff(log[f"counts_{side}"]) / per_rad for side in ("left", "right"))
        way, turn = 0.5 * (right_m * right + left_m * left), (right_m * right - left_m * left) / track_m
        heading = log["ref_theta_rad"][0] + np.concatenate(([0.0], np.cumsum(turn)))
        middle = heading[:-1] + turn / 2
        ends[run] = (
            log["ref_x_m"][0] + (way * np.cos(middle)).sum(),
            log["ref_y_m"][0] + (way * np.sin(middle)).sum(),
            heading[-1],
        )
    return ends


def optiodom_peers(folder: Path) -> dict[str, Callable[[], Values]]:
    """Return the ways to the radii and the track of OptiOdom's differential drive, by the ends of its runs."""
    campaign = recordings.optiodom_differential(folder)
    runs = campaign.runs
    measured = np.stack([runs.number(name) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")], axis=1)

    def by_scipy(loss: str) -> Values:
        fit = least_squares(
            lambda x: ((end_poses(x, campaign) - measured) / END_SIGMA).ravel(),
            np.array([0.042, 0.042, 0.2]),
            loss=loss,
            f_scale=ROBUST_FROM,
        )
        return dict(zip(("radius_left_m", "radius_right_m", "track_m"), fit.x, strict=True))

    def by_umbmark() -> Values:
        mark = estimate_geometry(of_kinds(campaign, ["square_cw", "square_ccw"]), using="end_poses").umbmark
        assert mark is not None
        left = 2 * 0.042 / (mark.E_d + 1.0)
        return {"radius_left_m": left, "radius_right_m": mark.E_d * left, "track_m": mark.E_b * 0.2}

    return {
        "`geometry`, end poses": lambda: of_geometry(campaign, using="end_poses"),
        "`least_squares`, linear": lambda: by_scipy("linear"),
        "`least_squares`, soft L1": lambda: by_scipy("soft_l1"),
        "UMBmark on the squares (mean radius assumed)": by_umbmark,
    }


def steered_ends(values: np.ndarray, campaign: Campaign) -> np.ndarray:
    """Return the end pose (n_runs, 3) of each run of a steered front wheel by plain odometry, Eqs 12 to 14."""
    radius_m, wheelbase_m, zero_rad, scale = values
    ends = np.zeros((len(campaign.runs), 3))
    for run in range(len(campaign.runs)):
        log = campaign.logs.of(run)
        rolled = radius_m * np.diff(log["counts_front"]) * 2 * np.pi / campaign.encoder.front
        angle = zero_rad + scale * 0.5 * (log["steer_rad"][1:] + log["steer_rad"][:-1])
        turn = rolled * np.sin(angle) / wheelbase_m
        heading = log["ref_theta_rad"][0] + np.cumsum(turn)
        way, middle = rolled * np.cos(angle), heading - 0.5 * turn
        start = log["ref_x_m"][0], log["ref_y_m"][0]
        ends[run] = start[0] + way @ np.cos(middle), start[1] + way @ np.sin(middle), heading[-1]
    return ends


def tricycle_peers(folder: Path) -> Peers:
    """Return the ways to OptiOdom's tricycle, by the ends of its runs, and the makers' figures."""
    campaign = recordings.optiodom_tricycle(folder)
    names = ("front_radius_m", "wheelbase_m", "steering_zero_rad")
    runs = campaign.runs
    measured = np.stack([runs.number(name) for name in ("ref_x_m", "ref_y_m", "ref_theta_rad")], axis=1)

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.ravel((steered_ends(np.append(x, 1.0), campaign) - measured) / END_SIGMA)

    def by_scipy(loss: str) -> Values:
        fit = least_squares(residuals, (0.0325, 0.15, 0.0), loss=loss, f_scale=ROBUST_FROM, x_scale=(1e-3, 1e-2, 1e-2))
        return dict(zip(names, fit.x, strict=True))

    def off_mm(values: Values) -> float:
        own = np.array([values.get(name, 1.0) for name in (*names, "steering_scale")])
        off = steered_ends(own, campaign)[:, :2] - measured[:, :2]
        return float(1e3 * np.sqrt(np.mean(np.square(off).sum(axis=1))))

    return {
        "`geometry`, end poses": lambda: of_geometry(campaign, (*names, "steering_scale"), using="end_poses"),
        "`least_squares`, linear": lambda: by_scipy("linear"),
        "`least_squares`, soft L1": lambda: by_scipy("soft_l1"),
        "published (with further runs)": lambda: dict(zip(names, (0.03115, 0.1522, -0.0197), strict=True)),
    }, off_mm


def mecanum_moves(values: np.ndarray, log: Mapping[str, np.ndarray], per_rev: float) -> np.ndarray:
    """Return displacements (n_windows, 3) of a marker, turned by a yaw against the vehicle, by four wheels."""
    radius_m, arm_m, yaw_rad = values
    fl, fr, rl, rr = (np.diff(log[name]) * 2 * np.pi / per_rev for name in WHEEL_COLUMNS["wheels"])
    ahead, left = radius_m / 4 * (fl + fr + rl + rr), radius_m / 4 * (-fl + fr + rl - rr)
    turn = radius_m / 4 / arm_m * (-fl + fr - rl + rr)
    heading = np.concatenate(([0.0], np.cumsum(turn)))
    steps = (ahead + 1j * left) * np.exp(1j * (heading[:-1] + 0.5 * turn + yaw_rad))
    return _moves(np.concatenate(([0.0], np.cumsum(steps))), heading, yaw_rad)


def _moves(place: np.ndarray, heading: np.ndarray, yaw_rad: float = 0.0) -> np.ndarray:
    """Return displacements over windows of equal length, in the frame of their first pose; places are complex."""
    first, last = np.arange(0, len(place) - WINDOW, WINDOW), np.arange(WINDOW, len(place), WINDOW)
    moved = (place[last] - place[first]) * np.exp(-1j * (heading[first] + 2.0 * yaw_rad))
    return np.stack([moved.real, moved.imag, heading[last] - heading[first]], axis=1)


def mecanum_peers(folder: Path, bag: str) -> Peers:
    """Return the ways to a mecanum robot's radius and arm, by windows of its recording, and the published figures."""
    campaign = recordings.mecanum(folder, bag)
    log, per_rev = campaign.logs.of(0), campaign.encoder.counts_per_rev_left
    names = ("wheel_radius_m", "half_length_plus_half_width_m")
    measured = _moves(log["ref_x_m"] + 1j * log["ref_y_m"], log["ref_theta_rad"])

    def residuals(x: np.ndarray) -> np.ndarray:
        return np.ravel((mecanum_moves(x, log, per_rev) - measured) / END_SIGMA)

    def by_scipy(loss: str) -> Values:
        fit = least_squares(residuals, (0.07, 0.369, 0.0), loss=loss, f_scale=ROBUST_FROM, x_scale=(1e-3, 1e-2, 1e-2))
        return dict(zip(names, fit.x[:2], strict=True))

    def off_mm(values: Values) -> float:
        # the marker's yaw is nobody's parameter: the best one for each
        own = [values[name] for name in names]
        best = least_squares(lambda yaw: residuals(np.array([*own, yaw[0]])), (0.0,), loss="soft_l1")
        off = mecanum_moves(np.array([*own, best.x[0]]), log, per_rev) - measured
        return float(1e3 * np.sqrt(np.mean(np.square(off[:, :2]).sum(axis=1))))

    return {
        "`geometry`, windows": lambda: of_geometry(campaign, names),
        "`least_squares`, linear": lambda: by_scipy("linear"),
        "`least_squares`, soft L1": lambda: by_scipy("soft_l1"),
        "published": lambda: dict(zip(names, (0.0678, 0.353), strict=True)),
    }, off_mm


def main() -> None:
    """Print two tables: two wheels on an axle, and other drives with what each leaves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the recordings")
    parser.add_argument("--others", action="store_true", help="tricycle and mecanum alone")
    given = parser.parse_args()
    folder = given.folder
    if not given.others:
        sys.stdout.write("| recording | by | r left in mm | r right in mm | track in mm | s |\n")
        sys.stdout.write("| --- | --- | ---: | ---: | ---: | ---: |\n")
        tasks = {f"khepera_{name}": khepera_peers(folder, name) for name in ("l90", "lstraight")}
        tasks["optiodom/diff"] = optiodom_peers(folder)
        for recording, peers in tasks.items():
            for peer, work in peers.items():
                values, seconds = timed(work)
                cells = " | ".join(f"{1e3 * values[k]:.3f}" for k in ("radius_left_m", "radius_right_m", "track_m"))
                sys.stdout.write(f"| {recording} | {peer} | {cells} | {seconds:.2f} |\n")
    sys.stdout.write(
        "\n| recording | by | it finds | position off by, rms in mm | s |\n| --- | --- | --- | ---: | ---: |\n"
    )
    others = {"optiodom/tricyc": tricycle_peers(folder)}
    others |= {f"mecanum_optitrack/{bag}": mecanum_peers(folder, bag) for bag in ("bag1", "bag2")}
    for recording, (peers, off_mm) in others.items():
        for peer, work in peers.items():
            values, seconds = timed(work)
            cells = ", ".join(f"{name} {value:.4f}" for name, value in values.items())
            time_s = "" if peer.startswith("published") else f"{seconds:.2f}"
            sys.stdout.write(f"| {recording} | {peer} | {cells} | {off_mm(values):.1f} | {time_s} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
