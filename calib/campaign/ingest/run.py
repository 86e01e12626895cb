"""Make a campaign out of raw laboratory files: a run table with one log a run, or recordings that are cut into runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.ingest.log_files import listed_files
from calib.campaign.ingest.mapping import bad_line, read_mapping
from calib.campaign.ingest.parts import Work, parts_cut, parts_matched, parts_of_files, run_table
from calib.campaign.ingest.pieces import Part
from calib.campaign.ingest.poses import end_values
from calib.campaign.ingest.table import mapped_runs
from calib.campaign.log_stack import LogStack
from calib.campaign.model import Campaign, Note, RunTable
from calib.campaign.settings import Encoder
from calib.campaign.settings_file import parse_settings
from calib.campaign.wraps import detect_wrap_bits
from calib.campaign.write import write_campaign
from calib.errors import BadInputError
from calib.files import refuse_existing, sha256_file, to_json
from calib.progress import Progress, silent

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
    work = Work(read, settings, Border(lenient=False), progress=progress)
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


def _campaign(paths: Sequence[Path], work: Work) -> Campaign:
    table = run_table(paths[0], work)
    first = paths[0]
    others = listed_files(paths if table is None else paths[1:])
    if table is None and work.mapping.table_file is not None:
        first = work.mapping.table_file
        table = run_table(first, work)
    others = [path for path in others if table is None or path.resolve() != first.resolve()]
    runs = None if table is None else mapped_runs(table, work.mapping, str(first), work.border)
    if work.mapping.cut is not None:
        runs, parts = parts_cut(runs, table, others, work)
    elif runs is None:
        runs, parts = parts_of_files(others, work)
    else:
        runs, parts = parts_matched(runs, others, str(first), work)
    parts = _exchanged(runs, parts, work)
    runs, parts = _ends(runs, parts)
    return _assembled(runs, parts, work)


def _exchanged(runs: RunTable, parts: dict[int, Part], work: Work) -> dict[int, Part]:
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


def _assembled(runs: RunTable, parts: Mapping[int, Part], work: Work) -> Campaign:
    encoder = _with_wrap(parts, work)
    names = {index: (str(runs.run_id[index]), part.shown) for index, part in parts.items()}
    stack = LogStack(len(runs))
    for index in sorted(parts):
        stack.add(index, {name: values for name, values in parts[index].columns.items() if name != "cut"})
    logs = stack.finished(encoder, names, work.border)
    return replace(work.settings, encoder=encoder).campaign(runs, logs, notes=tuple(work.border.notes))


def _with_wrap(parts: Mapping[int, Part], work: Work) -> Encoder:
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


def _record(work: Work) -> dict[str, Any]:
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
