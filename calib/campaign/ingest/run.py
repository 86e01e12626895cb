"""Make a campaign out of raw laboratory files: a run table with one log a run, or recordings that are cut into runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.ingest.log_files import listed_files, match_logs
from calib.campaign.ingest.mapping import MappingFile, bad_line, read_mapping
from calib.campaign.ingest.pieces import Part, cut_recordings
from calib.campaign.ingest.poses import end_values
from calib.campaign.ingest.streams import MappedLog, read_mapped
from calib.campaign.ingest.table import mapped_runs, names_runs
from calib.campaign.log_stack import LogStack
from calib.campaign.model import Campaign, Note, RunTable
from calib.campaign.readers import RawTable, holds_recording, read_table
from calib.campaign.readers.table import objects
from calib.campaign.settings import Encoder
from calib.campaign.settings_file import Settings, parse_settings
from calib.campaign.wraps import detect_wrap_bits
from calib.campaign.write import write_campaign
from calib.errors import BadInputError
from calib.files import refuse_existing, sha256_file, to_json
from calib.progress import Progress, silent, stepped

RECORD: Final = "ingest.json"
RECORDINGS: Final = "recordings"


@dataclass(frozen=True, slots=True)
class Ingested:
    """What was made."""

    #: the campaign
    folder: Path
    #: rows and logs taken
    n_runs: int
    n_logs: int
    #: SHA-256 of every file read, by its path as given
    sources: Mapping[str, str]
    #: what was recognised, converted and left out
    notes: tuple[Note, ...]
    campaign: Campaign
    #: for each run cut out of a recording: its source, start and end in seconds and nanoseconds
    cuts: tuple[Mapping[str, Any], ...] = ()


@dataclass(slots=True)
class _Work:
    """What an ingestion gathers on its way."""

    mapping: MappingFile
    settings: Settings
    border: Border
    hashes: dict[str, str] = field(default_factory=dict)
    whole: dict[str, MappedLog] = field(default_factory=dict)
    cuts: list[dict[str, Any]] = field(default_factory=list)
    progress: Progress = silent


def ingest(
    sources: Sequence[Path],
    into: Path,
    *,
    mapping: Path | None = None,
    force: bool = False,
    dry_run: bool = False,
    progress: Progress = silent,
) -> Ingested:
    """Make a campaign folder; the sources are only read, and their hashes recorded in ``ingest.json``.

    Parameters
    ----------
    sources : sequence of Path
        The run table first, where there is one, then logs or recordings, or folders of them.
    into : Path
        The campaign to make.
    mapping : Path, optional
        TOML file as the text of `calib.campaign.ingest.mapping` shows.
    force : bool
        Replace a campaign that stands there.
    dry_run : bool
        Do everything but write.
    progress : callable
        See `calib.progress.Progress`.

    Returns
    -------
    Ingested
        Summary.

    Raises
    ------
    BadInputError
        Where a source cannot be used, the mapping names a column that is not there, or the target exists.
    """
    if not sources:
        raise BadInputError("sources: found none; expected the run table first, then logs; name the files")
    paths = [Path(source) for source in sources]
    _keep_apart([*paths, *([mapping] if mapping else [])], into)
    if not dry_run:
        refuse_existing([into / "campaign.toml"], force=force)
    read = read_mapping(mapping)
    settings = parse_settings(read.settings, read.shown, into.name or "campaign")
    work = _Work(read, settings, Border(lenient=False), progress=progress)
    # a mapping is no campaign.toml: it names no format, and what it leaves out is written as assumed
    work.border.notes.extend(note for note in settings.notes if note.code not in {"format", "default_vehicle"})
    if mapping:
        work.hashes[read.shown] = sha256_file(mapping)
    campaign = _campaign(paths, work)
    if not dry_run:
        beside = {f"{RECORDINGS}/{name}.csv": _csv(log.columns) for name, log in work.whole.items()}
        beside[RECORD] = to_json(_record(work)).encode("utf-8")
        write_campaign(campaign, into, force=force, beside=beside)
    n_logs = int(campaign.logs.present.sum())
    notes = tuple(work.border.notes)
    return Ingested(into, len(campaign.runs), n_logs, work.hashes, notes, campaign, tuple(work.cuts))


def _campaign(paths: Sequence[Path], work: _Work) -> Campaign:
    table = _table(paths[0], work)
    first = paths[0]
    others = listed_files(paths if table is None else paths[1:])
    if table is None and work.mapping.table_file is not None:
        first = work.mapping.table_file
        table = _table(first, work)
    others = [path for path in others if table is None or path.resolve() != first.resolve()]
    runs = None if table is None else mapped_runs(table, work.mapping, str(first), work.border)
    if work.mapping.cut is not None:
        runs, parts = _cut(runs, table, others, work)
    elif runs is None:
        runs, parts = _a_run_a_file(others, work)
    else:
        runs, parts = _matched(runs, others, str(first), work)
    parts = _exchanged(runs, parts, work)
    runs, parts = _ends(runs, parts)
    return _assembled(runs, parts, work)


def _table(first: Path, work: _Work) -> RawTable | None:
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


def _read(path: Path, work: _Work) -> MappedLog:
    shown = str(path)
    log = read_mapped(path, shown, work.mapping, work.settings.encoder, work.border)
    files = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
    work.hashes |= {str(file): sha256_file(file) for file in files}
    return log


def _cut(
    runs: RunTable | None, table: RawTable | None, recordings: Sequence[Path], work: _Work
) -> tuple[RunTable, dict[int, Part]]:
    if not recordings:
        raise BadInputError("sources: found no recording to cut; expected one beside the run table; name it")
    read = {path: _read(path, work) for path in stepped(recordings, work.progress, "recordings")}
    runs, parts, whole, cuts = cut_recordings(runs, table, read, work.mapping, work.settings, work.border)
    work.whole, work.cuts = whole, cuts
    return runs, parts


def _a_run_a_file(files: Sequence[Path], work: _Work) -> tuple[RunTable, dict[int, Part]]:
    """Take each file for a run of its own, called by the file's name."""
    raw = RawTable({"run_id": objects([path.stem for path in files])}, np.arange(1, len(files) + 1, dtype=np.int64))
    runs = mapped_runs(raw, work.mapping, "the files given", work.border)
    parts = {
        index: Part.of(_read(path, work), str(path), work.mapping, work.settings)
        for index, path in enumerate(stepped(files, work.progress, "logs"))
    }
    return runs, parts


def _matched(runs: RunTable, files: Sequence[Path], shown: str, work: _Work) -> tuple[RunTable, dict[int, Part]]:
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


def _exchanged(runs: RunTable, parts: dict[int, Part], work: _Work) -> dict[int, Part]:
    """Exchange left and right in the logs of the runs that the mapping names."""
    names = {str(run_id): index for index, run_id in enumerate(runs.run_id)}
    out = dict(parts)
    for run_id in work.mapping.log_files.swapped:
        part = out.get(names.get(run_id, -1))
        if part is None or not {"counts_left", "counts_right"} <= set(part.columns):
            known = f"one of {', '.join(list(names)[:8])}, ... that has a log"
            raise bad_line(work.mapping.shown, "log", "swapped", run_id, known)
        columns = dict(part.columns)
        columns["counts_left"], columns["counts_right"] = columns["counts_right"], columns["counts_left"]
        out[names[run_id]] = replace(part, columns=columns)
        work.border.say(part.shown, "left and right were exchanged, as the mapping says", "exchanged", run_id=run_id)
    return out


def _ends(runs: RunTable, parts: Mapping[int, Part]) -> tuple[RunTable, dict[int, Part]]:
    """Fill distances and end poses that the table lacks from logs whose range and poses count from their start."""
    numbers = dict(runs.numbers)
    for index, part in parts.items():
        if not part.from_start:
            continue
        for name, value in end_values(part.columns).items():
            column = numbers.get(name)
            if column is None:
                column = numbers[name] = np.full(len(runs), np.nan)
            elif np.isnan(column[index]):
                column = numbers[name] = column.copy()
            if np.isnan(column[index]):
                column[index] = round(value, 9)
    return replace(runs, numbers=numbers), dict(parts)


def _assembled(runs: RunTable, parts: Mapping[int, Part], work: _Work) -> Campaign:
    encoder = _with_wrap(parts, work)
    names = {index: (str(runs.run_id[index]), part.shown) for index, part in parts.items()}
    stack = LogStack(len(runs))
    for index in sorted(parts):
        stack.add(index, {name: values for name, values in parts[index].columns.items() if name != "cut"})
    logs = stack.finished(encoder, names, work.border)
    return replace(work.settings, encoder=encoder).campaign(runs, logs, notes=tuple(work.border.notes))


def _with_wrap(parts: Mapping[int, Part], work: _Work) -> Encoder:
    """Return the encoder with the counter's width where overflows show it, so that the vehicle's runtime has it too."""
    encoder = work.settings.encoder
    if encoder.wrap_bits is not None:
        return encoder
    widths = {part.wrap_bits for part in parts.values() if part.wrap_bits is not None}
    for name in {name for part in parts.values() for name in part.columns if name.startswith("counts_")}:
        counts = [part.columns[name] for part in parts.values() if name in part.columns]
        offsets = np.concatenate(([0], np.cumsum([len(column) for column in counts]))).astype(np.int64)
        bits = detect_wrap_bits(np.concatenate(counts), offsets)
        if bits is not None:
            widths.add(bits)
    if not widths:
        return encoder
    bits = max(widths)
    text = f"counters overflow at {bits} bits, by their jumps; wrap_bits = {bits} is written into campaign.toml"
    work.border.say(f"{work.mapping.shown}, encoder.wrap_bits", text, "wrap_bits")
    return replace(encoder, wrap_bits=bits)


def _keep_apart(sources: Sequence[Path], into: Path) -> None:
    target = into.resolve()
    for source in sources:
        if source.resolve().is_relative_to(target):
            raise BadInputError(
                f"{source}: found a source inside the campaign to be made; expected sources elsewhere, since they are "
                "left untouched; give another folder to make"
            )


def _csv(columns: Mapping[str, FloatArray]) -> bytes:
    import pandas as pd

    frame = {name: np.round(values, 9) if name == "t_s" else values for name, values in columns.items()}
    text: str = pd.DataFrame(frame).to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")


def _record(work: _Work) -> dict[str, Any]:
    record: dict[str, Any] = {
        "sources": [{"path": name, "sha256": digest} for name, digest in sorted(work.hashes.items())],
        "notes": [{"where": note.where, "text": note.text} for note in work.border.notes],
    }
    if work.cuts:
        record["cuts"] = work.cuts
        record["recordings"] = {
            name: {
                "start_ns": log.start_ns,
                "lags": {key: {"lag_s": lag.lag_s, "ci95_s": list(lag.ci95_s)} for key, lag in log.lags.items()},
            }
            for name, log in work.whole.items()
        }
    return record
