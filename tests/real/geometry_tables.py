"""What `calib geometry` makes of recordings of others, as tables: ``python -m tests.real.geometry_tables``.

Khepera III against the published values, full recordings and thirds; OptiOdom by routes and by ways of estimating, and
each recording held out in turn; OptiOdom's tricycle; the mecanum robot. The recordings stand in ``../shared/data``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Estimate, Geometry
from tests.kinematics.published import published, tuples_of
from tests.real import recordings

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data"
KEYS = ("l_diam", "r_diam", "axle", "l_x", "l_y", "l_theta")


def _say(text: str = "") -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def khepera() -> None:
    """Relative deviations from the published values, and the scatter of thirds beside what is stated of it."""
    _say("Khepera III: deviation from the published values: the published procedure (largest of six), the general one")
    for base in ("l90", "lstraight"):
        thirds: list[Geometry] = []
        for part in ("", "_0", "_1", "_2"):
            name = f"{base}{part}"
            folder = FOLDER / f"khepera_{base}"
            wanted = json.loads((folder / f"{name}_results.json").read_text(encoding="utf-8"))
            rebuilt = published(*tuples_of(folder / f"{name}.tuple"))
            worst = max(abs(rebuilt[key] / wanted[key] - 1.0) for key in KEYS)
            found = estimate_geometry(recordings.khepera(FOLDER, name))
            ours = (2 * found["radius_left_m"].value, 2 * found["radius_right_m"].value, found["track_m"].value)
            off = [100 * (mine / wanted[key] - 1) for mine, key in zip(ours, KEYS[:3], strict=True)]
            yaw = found["sensor_yaw_rad"].value - wanted["l_theta"]
            _say(f"  {name:13s} {worst:7.1e}   l_diam {off[0]:+.3f} %  r_diam {off[1]:+.3f} %  axle {off[2]:+.3f} %"
                 f"  yaw {1e3 * yaw:+.1f} mrad")  # fmt: skip
            thirds += [found] if part else []
        for name in ("radius_left_m", "radius_right_m", "track_m"):
            values = np.array([third[name].value for third in thirds])
            stated = np.sqrt(np.mean([third[name].std ** 2 for third in thirds]))
            _say(f"  {base} thirds, {name}: scatter {values.std(ddof=1):.2e} m, stated {stated:.2e} m")


def differential() -> None:
    """Ways of estimating one vehicle, and each recording held out."""
    campaign = recordings.optiodom_differential(FOLDER)
    nominal = campaign.model.track_m / (0.5 * (campaign.model.radius_left_m + campaign.model.radius_right_m))
    squares, circles = ["square_cw", "square_ccw"], ["circular_cw", "circular_ccw"]
    rows = {
        "all routes, end poses": estimate_geometry(campaign, using="end_poses", leave_out="session"),
        "all routes, windows": estimate_geometry(campaign, using="windows"),
        "squares, least squares": estimate_geometry(campaign, using="end_poses", kinds=squares),
        "circles": estimate_geometry(campaign, using="end_poses", kinds=circles),
    }

    def interval(one: Estimate, by: float = 1.0) -> str:
        return f"{one.value / by:.5f} ({one.ci95[0] / by:.5f} to {one.ci95[1] / by:.5f})"

    _say("\nOptiOdom, differential: r_R / r_L, and track over radius over nominal")
    for name, row in rows.items():
        of, n = row.clusters
        ratio, wide = row.ratio("radius_right_m", "radius_left_m"), row.track_over_radius()
        _say(f"  {name:24s} {row.n_runs:3d} runs  {interval(ratio)}  {interval(wide, nominal)}  {n} {of}s")
    mark = rows["squares, least squares"].umbmark
    said = [
        f"{value:.5f} ({value - 1.96 * std:.5f} to {value + 1.96 * std:.5f})"
        for value, std in ((mark.E_d, mark.E_d_std), (mark.E_b, mark.E_b_std))
    ]
    _say(f"  {'squares, UMBmark':24s} {mark.n_cw + mark.n_ccw:3d} runs  {said[0]}  {said[1]}")
    _say("  held out: runs, end position error before and after, mm")
    for out in rows["all routes, end poses"].transfer:
        _say(f"    {out.left_out} {out.n:3d}  {1e3 * out.before_rms_m:6.1f} {1e3 * out.after_rms_m:6.1f}")


def others() -> None:
    """The tricycle against its makers' calibration, the mecanum robot against an independent fit."""
    _say("\nOptiOdom, tricycle: makers' 0.03115 m, 0.1522 m, -0.0197 rad")
    for one in estimate_geometry(recordings.optiodom_tricycle(FOLDER)).estimates:
        _say(f"  {one.name:20s} {one.value:.5f} ({one.ci95[0]:.5f} to {one.ci95[1]:.5f})")
    for bag in ("bag1", "bag2"):
        found = estimate_geometry(recordings.mecanum(FOLDER, bag))
        _say(
            f"\nMecanum {bag}: independent fit of bag2 0.0680 m, 0.360 m; undetermined: {', '.join(found.undetermined)}"
        )
        for one in found.estimates[:2]:
            _say(f"  {one.name:30s} {one.value:.5f} ({one.ci95[0]:.5f} to {one.ci95[1]:.5f})")


if __name__ == "__main__":
    khepera()
    differential()
    others()
