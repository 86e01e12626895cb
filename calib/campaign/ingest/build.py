"""Build a campaign folder of raw laboratory files."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Final

import numpy as np

from calib.campaign import csv_bytes, write_campaign
from calib.campaign.ingest import OF_FOLDERS, folders_of, listed_files
from calib.campaign.ingest import runs as run_tables
from calib.campaign.ingest.logs import MappedLog
from calib.campaign.ingest.mapping import SHEET, bad_line, read_mapping
from calib.campaign.ingest.runs import Rows, mapped_runs, match_logs, names_runs, with_lookups
from calib.campaign.ingest.segmentation import Ingestion, Segment, end_values, segment_recordings
from calib.campaign.logs import LogStack, detect_wrap_bits
from calib.campaign.model import Border, Campaign, Note, RunTable, stacked
from calib.campaign.readers import RawTable, holds_recording, read_table
from calib.campaign.readers.table import object_array
from calib.campaign.readers.workbook import sheet_names
from calib.campaign.settings import WHEEL_LOADS, Encoder, OdometryModel
from calib.campaign.settings_file import parse_settings
from calib.documents import plain, to_json
from calib.errors import BadInputError
from calib.io import refuse_existing, sha256_file
from calib.types import Progress, grouped, silent, stepped

RECORDINGS: Final = "recordings"
_SMALL_BYTES: Final = 1 << 16
_LISTED_ROWS: Final = 8
_NUMBER: Final = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?![\w.:-])")


@dataclass(frozen=True, slots=True)
class Ingested:
    """A campaign built of laboratory files."""

    folder: Path
    campaign: Campaign
    #: path as given -> SHA-256
    sources: Mapping[str, str]
    notes: tuple[Note, ...]
    cuts: tuple[Segment, ...] = ()

    @property
    def n_runs(self) -> int:
        """Runs of the campaign."""
        return len(self.campaign.runs)

    @property
    def n_logs(self) -> int:
        """Runs that have a log."""
        return int(self.campaign.logs.present.sum())


def ingest(
    sources: Sequence[Path],
    into: Path,
    *,
    mapping: Path | None = None,
    force: bool = False,
    dry_run: bool = False,
    progress: Progress = silent,
) -> Ingested:
    """Make a campaign folder; ``ingest.json`` records the sources' hashes.

    Parameters and refusals: see `calib.api.results.ingest`; `dry_run` writes nothing.
    """
    paths = [Path(source) for source in sources]
    for path in [*paths, *([mapping] if mapping else [])]:
        if path.resolve().is_relative_to(into.resolve()):
            expected = "sources elsewhere, since they are left untouched; give another folder to make"
            raise BadInputError(f"{path}: found a source inside the campaign to be made; expected {expected}")
    if not dry_run:
        refuse_existing([into / "campaign.toml"], force=force)
    read = read_mapping(mapping)
    settings = parse_settings(read.settings, read.shown, into.name or "campaign")
    work = Ingestion(read, settings, Border(lenient=False), progress)
    # a mapping names no format; what it omits is written as assumed
    work.border.notes.extend(note for note in settings.notes if note.code not in {"format", "default_vehicle"})
    if mapping:
        work.hashes[read.shown] = sha256_file(mapping)
    campaign = _campaign(paths, work)
    if not dry_run:
        whole = {name: log.columns | {"t_s": np.round(log.columns["t_s"], 9)} for name, log in work.recordings.items()}
        beside = {f"{RECORDINGS}/{name}.csv": csv_bytes(columns) for name, columns in whole.items()}
        beside["ingest.json"] = to_json(_record(work)).encode("utf-8")
        write_campaign(campaign, into, force=force, beside=beside)
    return Ingested(into, campaign, work.hashes, tuple(work.border.notes), tuple(work.segments))


def _campaign(paths: Sequence[Path], work: Ingestion) -> Campaign:
    first, table = paths[0], _run_table(paths[0], work)
    files = listed_files(paths if table is None else paths[1:])
    if table is None and work.mapping.table_file is not None:
        first = work.mapping.table_file
        table = _run_table(first, work)
    elif table is None and first.is_dir() and work.mapping.table.columns:
        # a folder's table stands beside logs or their folders, or in each
        inside = [path for path in files if path.parent == first] or files[:1]
        beside = [path for path in inside if not holds_recording(path)]
        tables = ((path, _run_table(path, work, named=True)) for path in beside)
        first, table = next(((path, rows) for path, rows in tables if rows is not None), (first, None))
    files = [path for path in files if table is None or path.resolve() != first.resolve()]
    runs = None
    if table is not None and (further := _further_tables(first, table, files, work)):
        parts, files, known = {first: table, **further}.items(), [], Rows()
        parts_of = (mapped_runs(raw, work.mapping, work.settings, str(path), work.border, known) for path, raw in parts)
        runs = stacked([*parts_of])
    elif table is not None and work.mapping.table.sheets:
        runs = _runs_of_sheets(first, work)
    elif table is not None:
        sheets = run_tables.files_of_sheets(work.mapping, first, files, work.hashes)
        files = [path for path in files if path not in sheets.values()]
        table, work.mapping = with_lookups(table, work.mapping, first, work.border, sheets)
        runs = mapped_runs(table, work.mapping, work.settings, str(first), work.border)
    if work.mapping.cut is not None:
        if not files:
            raise BadInputError("sources: found no recording to cut; expected one beside the run table; name it")
        groups = [*run_tables.files_of_runs(files, work.mapping.log).values()] or [{"": path} for path in files]
        read = {next(iter(one.values())): work.read_log(one) for one in stepped(groups, work.progress, "recordings")}
        runs, logs = segment_recordings(work, runs, table, read)
    else:
        runs, logs = _runs_with_logs(first, table, runs, files, work)
    _exchange_wheels(runs, logs, work)
    runs = _with_ends(runs, logs)
    encoder = _with_wrap_bits(logs, work)
    stack = LogStack(len(runs))
    for index in sorted(logs):
        stack.add(index, {name: values for name, values in logs[index].columns.items() if name != "cut"})
    named = {index: (str(runs.run_id[index]), log.shown) for index, log in logs.items()}
    finished = stack.finished(encoder, named, work.border)
    model = _with_reference_load(work, runs)
    return replace(
        work.settings, model=model, encoder=encoder, runs=runs, logs=finished, notes=tuple(work.border.notes)
    )


def _runs_with_logs(
    first: Path, table: RawTable | None, runs: RunTable | None, files: Sequence[Path], work: Ingestion
) -> tuple[RunTable, dict[int, MappedLog]]:
    shown = str(first)
    matched: dict[int, dict[str, Path]] | None = None
    missing: dict[int, str] = {}
    if runs is None:
        several = [*run_tables.files_of_runs(files, work.mapping.log)]
        names = object_array(several or [path.stem for path in files])
        shown = "the files given"
        raw = RawTable({"run_id": names}, np.arange(1, len(names) + 1, dtype=np.int64))
        runs = mapped_runs(raw, work.mapping, work.settings, shown, work.border)
        matched = None if several else {index: {"": path} for index, path in enumerate(files)}
    if matched is None:
        if work.mapping.log.run_sheet and not files:
            files = [first / name for name in sheet_names(first, shown)]
        matched, missing = match_logs(runs, files, work.mapping.log, shown, work.border, table)
    logs = work.read_logs(matched)
    return _without_logs(runs, missing, shown, work.border), logs


def _with_reference_load(work: Ingestion, runs: RunTable) -> OdometryModel:
    settings, loads = work.settings, np.stack([runs.number(name) for name in WHEEL_LOADS])
    model, known = settings.model, loads[np.isfinite(loads)]
    assumed = model.reference_load_N == settings.vehicle.unladen_load_N and "vehicle.mass_kg" in settings.assumed
    if not (assumed and len(known)):
        return model
    mean_N = float(np.round(known.mean(), 0))
    text = f"{mean_N:g} N, the mean load measured: neither it nor vehicle.mass_kg is given"
    work.border.notes.append(Note("info", "campaign.toml, model.reference_load_N", text, "assumed"))
    return replace(model, reference_load_N=mean_N)


def _run_table(path: Path, work: Ingestion, *, named: bool = False) -> RawTable | None:
    if not path.exists():
        raise BadInputError(f"{path}: found no such file; expected a run table or a recording; correct the path")
    if path.is_dir() or holds_recording(path):
        return None
    sheets, layout = work.mapping.table.sheets, work.mapping.table.layout
    raw = read_table(path, str(path), None, replace(layout, sheet=sheets[0]) if sheets else layout)
    if named and not names_runs(raw, work.mapping):
        return None
    mapped = any(line.column for line in work.mapping.table.columns.values())
    sources = [line.column for line in work.mapping.log.columns.values()]
    log_columns = {*sources, *(name.partition(":")[2] for name in sources)} - {""} or {"t_s"}
    if not mapped and not names_runs(raw, work.mapping) and log_columns & set(raw.columns):
        return None
    work.hashes[str(path)] = sha256_file(path)
    if not sheets:
        work.border.notes.extend(raw.notes)
    return raw


def _further_tables(first: Path, table: RawTable, files: Sequence[Path], work: Ingestion) -> dict[Path, RawTable]:
    section = work.mapping.table
    stated = any(work.mapping.log.model_dump(exclude={"lag"}).values())
    if stated or work.mapping.cut or section.sheets or "log" in table.columns:
        return {}
    tables: dict[Path, RawTable] = {}
    for path in files:
        if holds_recording(path) or path.stat().st_size > 4 * first.stat().st_size + _SMALL_BYTES:
            return {}
        tables[path] = read_table(path, str(path), None, section.layout)
        if list(tables[path].columns) != list(table.columns):
            return {}
    work.hashes |= {str(path): sha256_file(path) for path in tables}
    if apart := folders_of((first, *tables)):
        work.border.say(apart, OF_FOLDERS, "folders", level="suspicious")
    return tables


def _runs_of_sheets(path: Path, work: Ingestion) -> RunTable:
    section, tables = work.mapping.table, []
    for sheet in section.sheets:
        shown = f"{path}, sheet {sheet!r}"
        raw = read_table(path, shown, None, replace(section.layout, sheet=sheet))
        work.border.notes.extend(raw.notes)
        if any(line.column == SHEET for line in section.columns.values()):
            raw = replace(raw, columns={SHEET: object_array([sheet] * len(raw.line)), **raw.columns})
        raw, mapping = with_lookups(raw, work.mapping, path, work.border, {})
        tables.append(mapped_runs(raw, mapping, work.settings, shown, work.border))
    named = [str(run_id) for runs in tables for run_id in runs.run_id]
    if len({*named}) < len(named):
        text = "runs of several sheets have the same names; the sheet's name stands before each"
        work.border.say(str(path), text, "run_names")
        tables = [
            replace(runs, labels={**runs.labels, "run_id": np.char.add(f"{sheet} ", runs.run_id)})
            for sheet, runs in zip(section.sheets, tables, strict=True)
        ]
    runs = stacked(tables)
    numbered = runs.run_id.tolist() == named and all(name.isdecimal() for name in named)
    return runs.select(np.argsort([int(name) for name in named], kind="stable")) if numbered else runs


def _without_logs(runs: RunTable, missing: Mapping[int, str], shown: str, border: Border) -> RunTable:
    counted = np.isfinite(runs.number("counts_left") + runs.number("counts_right"))
    excluded = runs.excluded.copy()
    reasons = runs.label("exclusion_reason").astype(object)
    for index, name in missing.items():
        text = f"no log {name} was found for this run"
        if not counted[index] and not excluded[index]:
            excluded[index], reasons[index] = True, f"no log {name} was found"
            text += "; it stays in the table, excluded"
        where = f"{shown}, row {int(runs.line[index])}"
        border.say(where, text, "no_log", level="suspicious", run_id=str(runs.run_id[index]))
    reason = {"exclusion_reason": reasons.astype(np.str_)} if missing and excluded.any() else {}
    return replace(runs, labels={**runs.labels, **reason}, excluded=excluded)


def _exchange_wheels(runs: RunTable, logs: dict[int, MappedLog], work: Ingestion) -> None:
    names = {str(run_id): index for index, run_id in enumerate(runs.run_id)}
    for run_id in work.mapping.log.swapped:
        log = logs.get(names.get(run_id, -1))
        if log is None or not {"counts_left", "counts_right"} <= set(log.columns):
            known = f"one of {', '.join(list(names)[:8])}, ... that has a log"
            raise bad_line(work.mapping.shown, "log", "swapped", run_id, known)
        exchanged = {"counts_left": log.columns["counts_right"], "counts_right": log.columns["counts_left"]}
        logs[names[run_id]] = replace(log, columns=log.columns | exchanged)
        work.border.say(log.shown, "left and right were exchanged, as the mapping says", "exchanged", run_id=run_id)


def _with_ends(runs: RunTable, logs: Mapping[int, MappedLog]) -> RunTable:
    numbers = dict(runs.numbers)
    for index, log in logs.items():
        for name, value in end_values(log.columns).items() if log.from_start else ():
            numbers[name] = column = numbers.get(name, np.full(len(runs), np.nan)).copy()
            column[index] = round(value, 9) if np.isnan(column[index]) else column[index]
    return replace(runs, numbers=numbers)


def _with_wrap_bits(logs: Mapping[int, MappedLog], work: Ingestion) -> Encoder:
    encoder = work.settings.encoder
    if encoder.wrap_bits is not None:
        return encoder
    widths = [log.wrap_bits for log in logs.values()]
    for name in {name for log in logs.values() for name in log.columns if name.startswith("counts_")}:
        counted = [log.columns for log in logs.values() if name in log.columns]
        counts, time_s = (np.concatenate([columns[one] for columns in counted]) for one in (name, "t_s"))
        widths.append(detect_wrap_bits(counts, np.cumsum([0, *(len(columns[name]) for columns in counted)]), time_s))
    if (bits := max(filter(None, widths), default=None)) is None:
        return encoder
    text = f"counters overflow at {bits} bits, by their jumps; wrap_bits = {bits} is written into campaign.toml"
    work.border.say(f"{work.mapping.shown}, encoder.wrap_bits", text, "wrap_bits")
    return replace(encoder, wrap_bits=bits)


def _record(work: Ingestion) -> dict[str, object]:
    record: dict[str, object] = {
        "sources": [{"path": name, "sha256": digest} for name, digest in sorted(work.hashes.items())],
        "notes": [{"where": note.where, "text": note.text} for note in work.border.notes],
        "summary": [{"where": note.where, "text": note.text} for note in merged_notes(work.border.notes)],
    }
    if work.segments:
        record["cuts"] = plain(work.segments)
        record["recordings"] = {
            name: {"start_ns": log.start_ns, "lags": plain(log.lags)} for name, log in work.recordings.items()
        }
    return record


def merged_notes(notes: Sequence[Note]) -> tuple[Note, ...]:
    """Return notes, those merged that differ in file, row, run and numbers alone."""

    def kind(note: Note) -> tuple[str, ...]:
        file, column = _file_and_column(note.where)
        return note.level, note.code, PurePath(file).suffix + column, _NUMBER.sub("#", note.text)

    groups = grouped((kind(note), note) for note in notes)
    return tuple(group[0] if len(group) == 1 else _merged(group) for group in groups.values())


def _file_and_column(where: str) -> tuple[str, str]:
    file, _, place = where.partition(", ")
    column = re.search(r"column .*", place)
    return file, column[0] if column else "" if place.startswith("row") else place


def _merged(group: Sequence[Note]) -> Note:
    first, column = group[0], _file_and_column(group[0].where)[1]
    files = list(dict.fromkeys(_file_and_column(note.where)[0] for note in group))
    if len(files) > 1:
        where = f"{len(files)} files, {PurePath(files[0]).name} .. {PurePath(files[-1]).name}"
    else:
        rows = [match[1] for note in group if (match := re.search(r"row (\d+)", note.where))]
        dots = " ..." if len(rows) > _LISTED_ROWS else ""
        where = files[0] + (f", rows {', '.join(rows[:_LISTED_ROWS])}{dots}" if rows else "")
    spans = iter(zip(*(_NUMBER.findall(note.text) for note in group), strict=True))

    def span(match: re.Match[str]) -> str:
        texts = sorted(dict.fromkeys(next(spans)), key=float)
        return match[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}"

    where += f", {column}" if column else ""
    return Note(first.level, where, _NUMBER.sub(span, first.text), first.code)
