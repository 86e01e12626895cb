"""What was found in a campaign, what is wrong, what is suspicious: said before anyone computes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.checks.counts import (
    clock,
    count_jumps,
    count_scale,
    counts_against_log,
    log_speed,
    reversed_wheels,
    swapped_wheels,
    turn_direction,
)
from calib.campaign.checks.design import (
    assumed_values,
    far_from_repeats,
    few_loads,
    load_and_session,
    model_against_vehicle,
    pasted_rows,
)
from calib.campaign.checks.distances import (
    distance_against_log,
    distance_against_pose,
    distance_span,
    mirrored_ends,
    missing_values,
    track_against_bows,
)
from calib.campaign.checks.loads import loads_against_payload, wheel_loads
from calib.campaign.checks.plausible import implausible
from calib.campaign.checks.settings import (
    counts_per_revolution,
    heading_turns,
    late_logs,
    log_clock,
    pose_resolution,
)
from calib.campaign.model import Campaign, Note
from calib.types import BoolArray, FloatArray, Progress, silent, stepped

Span = tuple[float, float]
_SPANS = ("load_left_N", "load_right_N", "distance_m", "speed_mps", "temperature_C", "counts_left", "counts_right")


#: Looks at a campaign and yields what it finds.
Check = Callable[[Campaign], Iterator[Note]]

#: name of a check -> function; the order is the order of the report
CHECKS: Final[dict[str, Check]] = {
    "assumed_values": assumed_values,
    "missing_values": missing_values,
    "distance_span": distance_span,
    "distance_against_log": distance_against_log,
    "distance_against_pose": distance_against_pose,
    "reversed_wheels": reversed_wheels,
    "count_scale": count_scale,
    "counts_against_log": counts_against_log,
    "late_logs": late_logs,
    "counts_per_revolution": counts_per_revolution,
    "log_clock": log_clock,
    "heading_turns": heading_turns,
    "pose_resolution": pose_resolution,
    "swapped_wheels": swapped_wheels,
    "turn_direction": turn_direction,
    "clock": clock,
    "count_jumps": count_jumps,
    "log_speed": log_speed,
    "repeats": far_from_repeats,
    "pasted_rows": pasted_rows,
    "wheel_loads": wheel_loads,
    "loads_against_payload": loads_against_payload,
    "mirrored_ends": mirrored_ends,
    "track_against_bows": track_against_bows,
    "load_and_session": load_and_session,
    "few_loads": few_loads,
    "model_against_vehicle": model_against_vehicle,
    "implausible": implausible,
}


@dataclass(frozen=True, slots=True)
class CampaignContents:
    """What a campaign holds; spans are (smallest, largest), None where nothing was measured."""

    n_runs: int
    n_excluded: int
    sessions: dict[str, int]
    kinds: dict[str, int]
    payloads_kg: tuple[float, ...]
    load_left_N: Span | None
    load_right_N: Span | None
    distance_m: Span | None
    speed_mps: Span | None
    temperature_C: Span | None
    counts_left: Span | None
    counts_right: Span | None
    n_logs: int
    n_samples: int
    rate_Hz: Span | None
    duration_s: Span | None
    log_columns: tuple[str, ...]
    covariates: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What was found, and the notes by level."""

    campaign: str
    #: whether a program made the data
    simulated: bool
    found: CampaignContents
    #: faults to correct; things to look at; what was recognised and converted
    wrong: tuple[Note, ...]
    suspicious: tuple[Note, ...]
    info: tuple[Note, ...]

    @property
    def verdict(self) -> str:
        """``sound``, ``look at this`` where something is suspicious, or ``wrong``."""
        if self.wrong:
            return "wrong"
        return "look at this" if self.suspicious else "sound"

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong; suspicious things alone do not count."""
        return not self.wrong


def check_campaign(campaign: Campaign, progress: Progress = silent) -> CheckReport:
    """Run every check; nothing is changed or deleted.

    `campaign`: read leniently, so that faults of single runs are among its notes. The notes of the reading and of every
    check, those of a run that is flagged as excluded omitted but for faults.
    """
    excluded = {str(name) for name in campaign.runs.run_id[campaign.runs.excluded]}
    kept = campaign.included()
    notes = [note for note in campaign.notes if note.level != "suspicious" or note.run_id not in excluded]
    if len(kept.runs):
        for check in stepped(CHECKS.values(), progress, "checks"):
            notes.extend(check(kept))
    levels = {
        level: tuple(dict.fromkeys(note for note in notes if note.level == level))
        for level in ("wrong", "suspicious", "info")
    }
    return CheckReport(campaign.name, campaign.simulated, summarise(campaign), **levels)


def summarise(campaign: Campaign) -> CampaignContents:
    """Return what a campaign holds: runs, sessions, loads, spans and rates."""
    runs, logs = campaign.runs, campaign.logs
    present: BoolArray = logs.present
    duration = np.empty(0)
    rate = np.empty(0)
    if present.any():
        time = logs.columns["t_s"]
        duration = time[logs.offsets[1:][present] - 1] - time[logs.offsets[:-1][present]]
        rate = (logs.lengths[present] - 1)[duration > 0] / duration[duration > 0]
    payload = runs.number("payload_kg")
    return CampaignContents(
        n_runs=len(runs),
        n_excluded=int(runs.excluded.sum()),
        sessions=_counted(runs.label("session")),
        kinds=_counted(runs.label("kind")),
        payloads_kg=tuple(float(value) for value in np.unique(np.round(payload[np.isfinite(payload)], 3))),
        **{name: _span(runs.number(name)) for name in _SPANS},
        n_logs=int(present.sum()),
        n_samples=int(logs.offsets[-1]),
        rate_Hz=_span(rate),
        duration_s=_span(duration),
        log_columns=tuple(logs.columns),
        covariates=runs.covariates,
    )


def _span(values: FloatArray) -> Span | None:
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None


def _counted(labels: np.ndarray) -> dict[str, int]:
    names, first, count = np.unique(labels, return_index=True, return_counts=True)
    return {str(names[i]): int(count[i]) for i in np.argsort(first) if names[i]}
