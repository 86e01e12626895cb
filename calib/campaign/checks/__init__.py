"""Checks of a campaign before anyone computes: small functions, each in one file of its kind, and their registry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from calib.campaign.checks import assumed, counts, design, distances, loads, logs, references, repeats
from calib.campaign.model import Campaign, Note
from calib.campaign.plausible import implausible

__all__ = ["CHECKS", "Check"]

#: Looks at a campaign and yields what it finds.
Check = Callable[[Campaign], Iterator[Note]]

#: name of a check -> function; the order is the order of the report
CHECKS: Final[dict[str, Check]] = {
    "assumed_values": assumed.assumed_values,
    "missing_values": distances.missing_values,
    "distance_span": distances.distance_span,
    "distance_against_log": distances.distance_against_log,
    "distance_against_pose": references.distance_against_pose,
    "reversed_wheels": counts.reversed_wheels,
    "count_scale": counts.count_scale,
    "counts_against_log": counts.counts_against_log,
    "swapped_wheels": counts.swapped_wheels,
    "turn_direction": counts.turn_direction,
    "clock": logs.clock,
    "count_jumps": logs.count_jumps,
    "log_speed": logs.log_speed,
    "repeats": repeats.far_from_repeats,
    "pasted_rows": repeats.pasted_rows,
    "wheel_loads": loads.wheel_loads,
    "loads_against_payload": loads.loads_against_payload,
    "track_against_bows": references.track_against_bows,
    "load_and_session": design.load_and_session,
    "few_loads": design.few_loads,
    "model_against_vehicle": design.model_against_vehicle,
    "implausible": implausible,
}
