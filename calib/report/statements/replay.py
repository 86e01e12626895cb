"""What a replay of logged runs says."""

from __future__ import annotations

from typing import Final

from calib.motion.studies.replay import Replay
from calib.report.blocks import Block, Column, Table, Text
from calib.report.numbers import fixed, left

_RADII: Final = {
    "model": "as the simulator believes",
    "constant": "law's radii, unladen, kept",
    "corrected": "law's radii at the load carried",
}
#: where a front wheel or four wheels drive the odometry
_BY_GEOMETRY: Final = {"model": "as the simulator believes", "corrected": "the coefficients' radii and lengths"}


def replay_content(replay: Replay) -> tuple[Block, ...]:
    """Return what a replay says."""
    name = replay.campaign + (" (simulated)" if replay.simulated else "")
    table = Table(
        f"{name}: end error of {int(replay.in_range.sum())} runs.",
        (left("Radii"), Column("rms", "m"), Column("rms heading", "mrad")),
        tuple(
            (title, fixed(replay.rms_m[key], 4), fixed(1e3 * replay.rms_heading_rad[key], 2))
            for key, title in (_BY_GEOMETRY if replay.by_geometry else _RADII).items()
        ),
    )
    left_out = [Text(f"{count} runs left out: {reason}.") for reason, count in replay.left_out.items() if count]
    if replay.by_geometry:
        runtime = Text("The vehicle's runtime reads two wheels on one axle; it was not fed.")
        return (table, runtime, *left_out)
    low, high = replay.ratio_ci95
    check = replay.runtime
    blocks: list[Block] = [
        table,
        Text(
            f"The correction makes the end error {replay.ratio:.1f} times smaller (95 % interval {low:.1f} to "
            f"{high:.1f})."
        ),
        Text(
            f"The vehicle's runtime on {check.runs} of these runs, {check.samples} samples: differs from the arrays "
            f"by at most {check.largest_difference_m:.2g} m and {check.largest_difference_rad:.2g} rad."
        ),
    ]
    blocks += [Text(f"The runtime refused {count} times: {status}.") for status, count in check.faults.items()]
    return (*blocks, *left_out)
