"""What was found in a campaign, what is wrong, what is suspicious: said before anyone computes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.campaign.checks import counts, design, distances, loads, plausible, poses, settings
from calib.campaign.model import Campaign, Note
from calib.types import BoolArray, FloatArray, Progress, silent, stepped

Span = tuple[float, float]
_SPANS = ("load_left_N", "load_right_N", "distance_m", "speed_mps", "temperature_C", "counts_left", "counts_right")


#: Looks at a campaign and yields what it finds.
Check = Callable[[Campaign], Iterator[Note]]

#: name of a check -> function, in the order of the report
CHECKS: Final[dict[str, Check]] = {
    check.__name__: check
    for check in (
        design.assumed_values,
        distances.missing_values,
        distances.distance_span,
        distances.distance_against_log,
        poses.distance_against_pose,
        counts.reversed_wheels,
        counts.count_scale,
        counts.counts_against_log,
        settings.late_logs,
        settings.counts_per_revolution,
        settings.log_clock,
        settings.heading_turns,
        settings.pose_resolution,
        settings.rounded_values,
        settings.shifted_sessions,
        counts.swapped_wheels,
        counts.turn_direction,
        counts.clock,
        counts.count_jumps,
        counts.log_speed,
        design.far_from_repeats,
        design.pasted_rows,
        loads.wheel_loads,
        loads.loads_against_payload,
        loads.reference_load,
        poses.mirrored_ends,
        poses.turned_frame,
        poses.bearing_of_ends,
        poses.stated_uncertainties,
        poses.track_against_bows,
        design.load_and_session,
        design.few_loads,
        plausible.model_against_vehicle,
        plausible.implausible,
    )
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


#: notes of the reading that change a result: columns not used, rows that are no runs, sessions joined
_OF_READING: Final = frozenset({"no_unit", "look_alike", "summary_row", "session_spelling"})
#: checks whose findings a fit and a diagnosis report by themselves, or that change neither
_NOT_OF_RESULTS: Final = frozenset(
    {"assumed_values", "missing_values", "load_and_session", "few_loads", "implausible", "clock"}
)
#: findings of one check that a result lists
_MOST_LISTED: Final = 3


def notes_for_results(campaign: Campaign) -> tuple[str, ...]:
    """Return what a fit or a diagnosis says of its data first: each changes the answer, and the answer shows none."""
    kept = campaign.included()
    lists = [[note for note in campaign.notes if note.code in _OF_READING]]
    checks = [check for name, check in CHECKS.items() if name not in _NOT_OF_RESULTS]
    lists += [list(check(kept)) for check in (*checks, settings.odd_lengths)]
    said = []
    for notes in lists:
        said += [f"{note.where}: {note.text}." for note in notes[:_MOST_LISTED]]
        if len(notes) > _MOST_LISTED:
            said.append(f"{len(notes) - _MOST_LISTED} more of this kind ({notes[0].code}): 'calib check' lists them.")
    return tuple(dict.fromkeys(said))


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
