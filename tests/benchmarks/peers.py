"""Geometry beside its peers on the same recordings: ``python -m tests.benchmarks.peers FOLDER`` prints Markdown.

Peers: `scipy.optimize.least_squares` on the displacements or end poses, as a user would write it in numpy, and the
published procedures (Censi et al. 2013 for the Khepera, UMBmark for the squares). Seconds of the processor, the least
of several turns; reading the files is part of none of them.
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


def of_geometry(campaign: Campaign, **options: str) -> Values:
    """Return radii and track by `geometry`."""
    found = estimate_geometry(campaign, **options)  # type: ignore[arg-type]
    return {name: found[name].value for name in ("radius_left_m", "radius_right_m", "track_m")}


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


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the recordings")
    folder = parser.parse_args().folder
    sys.stdout.write("| recording | by | r left in mm | r right in mm | track in mm | s |\n")
    sys.stdout.write("| --- | --- | ---: | ---: | ---: | ---: |\n")
    tasks = {f"khepera_{name}": khepera_peers(folder, name) for name in ("l90", "lstraight")}
    tasks["optiodom/diff"] = optiodom_peers(folder)
    for recording, peers in tasks.items():
        for peer, work in peers.items():
            values, seconds = timed(work)
            cells = " | ".join(f"{1e3 * values[k]:.3f}" for k in ("radius_left_m", "radius_right_m", "track_m"))
            sys.stdout.write(f"| {recording} | {peer} | {cells} | {seconds:.2f} |\n")


if __name__ == "__main__":
    main()
