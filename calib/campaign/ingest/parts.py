"""What is read on the way in: the run table, and each run's part of the logs or recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.campaign.faults import Border
from calib.campaign.ingest.log_files import match_logs
from calib.campaign.ingest.mapping import MappingFile
from calib.campaign.ingest.pieces import Part, cut_recordings
from calib.campaign.ingest.streams import MappedLog, read_mapped
from calib.campaign.ingest.table import mapped_runs, names_runs
from calib.campaign.model import RunTable
from calib.campaign.readers import RawTable, holds_recording, read_table
from calib.campaign.readers.table import objects
from calib.campaign.settings_file import Settings
from calib.errors import BadInputError
from calib.files import sha256_file
from calib.progress import Progress, silent, stepped


@dataclass(slots=True)
class Work:
    """What an ingestion gathers on its way."""

    mapping: MappingFile
    settings: Settings
    border: Border
    hashes: dict[str, str] = field(default_factory=dict)
    whole: dict[str, MappedLog] = field(default_factory=dict)
    cuts: list[dict[str, Any]] = field(default_factory=list)
    progress: Progress = silent


def run_table(first: Path, work: Work) -> RawTable | None:
    """Return the run table where a source is one."""
    if not first.exists() or first.is_dir() or holds_recording(first):
        if not first.exists():
            raise BadInputError(f"{first}: found no such file; expected a run table or a recording; correct the path")
        return None
    shown = str(first)
    raw = read_table(first, shown, None, work.mapping.table_layout)
    if not names_runs(raw, work.mapping) and not any(line.column for line in work.mapping.table):
        logs = {line.column for line in work.mapping.log if line.column} or {"t_s"}
        if logs & set(raw.columns):
            return None
    work.hashes[shown] = sha256_file(first)
    work.border.notes.extend(raw.notes)
    return raw


def _read(path: Path, work: Work) -> MappedLog:
    shown = str(path)
    log = read_mapped(path, shown, work.mapping, work.settings.encoder, work.border)
    files = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
    work.hashes |= {str(file): sha256_file(file) for file in files}
    return log


def parts_cut(
    runs: RunTable | None, table: RawTable | None, recordings: Sequence[Path], work: Work
) -> tuple[RunTable, dict[int, Part]]:
    """Cut recordings into runs; without a run table, the cuts make one."""
    if not recordings:
        raise BadInputError("sources: found no recording to cut; expected one beside the run table; name it")
    read = {path: _read(path, work) for path in stepped(recordings, work.progress, "recordings")}
    runs, parts, whole, cuts = cut_recordings(runs, table, read, work.mapping, work.settings, work.border)
    work.whole, work.cuts = whole, cuts
    return runs, parts


def parts_of_files(files: Sequence[Path], work: Work) -> tuple[RunTable, dict[int, Part]]:
    """Take each file for a run of its own, called by the file's name."""
    raw = RawTable({"run_id": objects([path.stem for path in files])}, np.arange(1, len(files) + 1, dtype=np.int64))
    runs = mapped_runs(raw, work.mapping, "the files given", work.border)
    parts = {
        index: Part.of(_read(path, work), str(path), work.mapping, work.settings)
        for index, path in enumerate(stepped(files, work.progress, "logs"))
    }
    return runs, parts


def parts_matched(runs: RunTable, files: Sequence[Path], shown: str, work: Work) -> tuple[RunTable, dict[int, Part]]:
    """Give each run its log; one that lacks it, and counts in the table as well, is excluded."""
    matched, missing = match_logs(runs, files, work.mapping.log_files, shown, work.border)
    parts = {
        index: Part.of(_read(path, work), str(path), work.mapping, work.settings)
        for index, path in stepped(matched.items(), work.progress, "logs")
    }
    if not missing:
        return runs, parts
    counted = ~np.isnan(runs.number("counts_left")) & ~np.isnan(runs.number("counts_right"))
    excluded = runs.excluded.copy()
    reasons = runs.label("exclusion_reason").astype(object)
    for index, name in missing.items():
        text = f"no log {name} was found for this run"
        if not counted[index] and not excluded[index]:
            excluded[index] = True
            reasons[index] = f"no log {name} was found"
            text += "; it stays in the table, excluded"
        where = f"{shown}, row {int(runs.line[index])}"
        work.border.say(where, text, "no_log", level="suspicious", run_id=str(runs.run_id[index]))
    labels = dict(runs.labels)
    if excluded.any():
        labels["exclusion_reason"] = reasons.astype(np.str_)
    return replace(runs, labels=labels, excluded=excluded), parts
