"""Make a campaign out of raw lab files: a run table as exported from a spreadsheet, a mapping, one log a run.

The mapping is a TOML file, written once for a lab's export::

    name = "hall 3, spring"            # any key or section of campaign.toml: vehicle, encoder, model, ...
    [vehicle]
    track_mm = 700

    [table]                            # calib column = column of the lab's table
    run_id = "Run no."
    distance_m = {column = "Distance", unit = "mm"}
    counts_left = {column = "Enc L", factor = -1}
    session = {value = "monday"}       # the same for every run

    [log]                              # the same for the logs, and the file that holds a run's log
    file = "run_{run_id}.csv"          # or a table column named log; without both, the file whose stem is the run id
    t_s = {column = "time", unit = "ms"}
    counts_left = "EncL"

Columns that already carry calib's names, with any known unit, need no line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.columns import recognise, spelled
from calib.campaign.faults import Border
from calib.campaign.logs_file import LogFile, Renames, read_logs
from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS, Logs, Note, RunTable
from calib.campaign.readers import READERS, RawTable, read_table
from calib.campaign.runs_file import run_table
from calib.campaign.settings_file import load_toml, parse_settings
from calib.campaign.write import write_campaign
from calib.errors import BadFileError, BadInputError
from calib.files import sha256_file, write_json
from calib.units import SUFFIXES, split_suffix

__all__ = ["Ingested", "ingest"]

RECORD: Final = "ingest.json"
_TABLE: Final = (*LABEL_COLUMNS, *NUMERIC_COLUMNS, "excluded")


@dataclass(frozen=True, slots=True)
class Ingested:
    """What was made.

    Parameters
    ----------
    folder : Path
        The campaign.
    n_runs, n_logs : int
        Rows and logs taken.
    sources : mapping of str to str
        SHA-256 of every file read, by its path as given.
    notes : tuple of Note
        What was recognised, converted and left out.
    """

    folder: Path
    n_runs: int
    n_logs: int
    sources: Mapping[str, str]
    notes: tuple[Note, ...]


def ingest(sources: Sequence[Path], into: Path, *, mapping: Path | None = None, force: bool = False) -> Ingested:
    """Make a campaign folder; the sources are only read, and their hashes recorded in ``ingest.json``.

    Parameters
    ----------
    sources : sequence of Path
        The run table first, then logs or folders of logs.
    into : Path
        The campaign to make.
    mapping : Path, optional
        TOML file as this module's text shows.
    force : bool
        Replace a campaign that stands there.

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
    table_path, *others = (Path(source) for source in sources)
    _keep_apart([table_path, *others, *([mapping] if mapping else [])], into)
    shown_mapping = str(mapping) if mapping else "mapping"
    document = load_toml(mapping, shown_mapping) if mapping else {}
    table_map = _section(document, "table", shown_mapping)
    log_map = _section(document, "log", shown_mapping)
    template = log_map.pop("file", None)
    border = Border(lenient=False)

    shown = str(table_path)
    hashes: dict[str, str] = {}
    raw = read_table(table_path, shown)
    hashes[shown] = sha256_file(table_path)
    border.notes.extend(raw.notes)
    raw, factors = _renamed(raw, table_map, shown, shown_mapping)
    runs = _scaled(run_table(raw, shown, border), factors)
    settings = parse_settings(document, shown_mapping, into.name or "campaign")
    border.notes.extend(settings.notes)
    files = _match_logs(runs, _log_files(others, shown), template, shown, shown_mapping, border)
    renames = _renames(log_map, LOG_COLUMNS, shown_mapping, "log") if log_map else None
    logs = read_logs(files, len(runs), settings.encoder, border, renames) if files else Logs.empty(len(runs))
    hashes |= {name: sha256_file(path) for _, _, path, name in files}
    if mapping:
        hashes[shown_mapping] = sha256_file(mapping)
    campaign = settings.campaign(runs, logs)
    write_campaign(campaign, into, force=force)
    record = {
        "sources": [{"path": name, "sha256": digest} for name, digest in sorted(hashes.items())],
        "notes": [{"where": note.where, "text": note.text} for note in border.notes],
    }
    write_json(into / RECORD, record, force=True)
    return Ingested(into, len(runs), len(files), hashes, tuple(border.notes))


def _keep_apart(sources: Sequence[Path], into: Path) -> None:
    target = into.resolve()
    for source in sources:
        if source.resolve().is_relative_to(target):
            raise BadInputError(
                f"{source}: found a source inside the campaign to be made; expected sources elsewhere, since they are "
                "left untouched; give another --into"
            )


def _section(document: dict[str, Any], name: str, shown: str) -> dict[str, Any]:
    section = document.pop(name, {})
    if not isinstance(section, dict):
        raise BadFileError(
            shown, column=name, found=repr(section)[:60], expected=f"a section [{name}]", remedy="correct the mapping"
        )
    return dict(section)


def _renames(section: Mapping[str, Any], known: Sequence[str], shown: str, where: str) -> Renames:
    """Turn mapping lines into: column as found -> (calib name in the source's unit, factor)."""
    renames: dict[str, tuple[str, float]] = {}
    for name, entry in section.items():
        line = {"column": entry} if isinstance(entry, str) else entry
        if not isinstance(line, dict) or not isinstance(line.get("column"), str):
            if isinstance(line, dict) and "value" in line:
                continue
            raise _bad_line(shown, where, name, entry, 'a column name, or {column = "...", unit = "...", factor = 1}')
        unit, factor = line.get("unit"), line.get("factor", 1.0)
        if isinstance(factor, bool) or not isinstance(factor, int | float) or not 0 < abs(factor) < 1e12:
            raise _bad_line(shown, where, name, factor, "a factor that is a number other than 0")
        if set(line) - {"column", "unit", "factor"}:
            raise _bad_line(shown, where, name, sorted(set(line)), "the keys column, unit, factor")
        target = name
        if unit is None and ("[" in line["column"] or "(" in line["column"]):
            # the source names its own unit: Distance [mm]
            _, unit = split_suffix(spelled(line["column"]))
        if unit is not None:
            stem, suffix = split_suffix(name)
            if not isinstance(unit, str) or unit not in SUFFIXES or SUFFIXES[unit][0] != suffix:
                raise _bad_line(shown, where, name, unit, f"a unit of the same kind as {suffix}")
            target = f"{stem}_{unit}"
        if line["column"] in renames:
            raise _bad_line(shown, where, name, line["column"], "each source column once")
        renames[line["column"]] = (target, float(factor))
    unknown = [name for name in section if name not in known] if where == "log" else []
    if unknown:
        raise _bad_line(shown, where, unknown[0], unknown[0], f"one of file, {', '.join(known)}")
    return renames


def _bad_line(shown: str, where: str, name: str, found: Any, expected: str) -> BadFileError:
    return BadFileError(
        shown, column=f"{where}.{name}", found=repr(found)[:80], expected=expected, remedy="correct the mapping"
    )


def _renamed(
    raw: RawTable, section: Mapping[str, Any], shown: str, shown_mapping: str
) -> tuple[RawTable, dict[str, float]]:
    renames = _renames(section, _TABLE, shown_mapping, "table")
    columns: dict[str, Any] = {}
    for source, (target, _) in renames.items():
        if source not in raw.columns:
            raise BadFileError(
                shown,
                row=1,
                column=source,
                found=f"only {', '.join(raw.columns)[:200]}",
                expected="the column that the mapping names",
                remedy=f"correct table.{target} in {shown_mapping}",
            )
        columns[target] = raw.columns[source]
    for name, cells in raw.columns.items():
        # a column that the mapping has given is not taken a second time under its own name
        if name not in renames and recognise(name, _TABLE).name not in section:
            columns.setdefault(name, cells)
    for name, entry in section.items():
        if isinstance(entry, dict) and "value" in entry:
            cells = np.empty(len(raw.line), dtype=object)
            value = entry["value"]
            cells[:] = ("true" if value else "false") if isinstance(value, bool) else value
            if not isinstance(value, str | int | float):
                raise _bad_line(shown_mapping, "table", name, value, "a text or a number")
            columns[name] = cells
    factors = {recognise(target, _TABLE).name: factor for target, factor in renames.values() if factor != 1.0}
    return RawTable(columns, raw.line, raw.notes), factors


def _scaled(runs: RunTable, factors: Mapping[str, float]) -> RunTable:
    numbers = {name: column * factors.get(name, 1.0) for name, column in runs.numbers.items()}
    return replace(runs, numbers=numbers)


def _log_files(others: Sequence[Path], shown: str) -> list[Path]:
    files: list[Path] = []
    for source in others:
        if source.is_dir():
            files += sorted(path for path in source.iterdir() if path.is_file() and path.suffix.lower() in READERS)
        elif source.is_file():
            files.append(source)
        else:
            raise BadInputError(f"{source}: found no such file; expected a log or a folder of logs; correct the path")
    table = Path(shown).resolve()
    return [path for path in files if path.resolve() != table]


def _match_logs(
    runs: RunTable, files: Sequence[Path], template: Any, shown: str, shown_mapping: str, border: Border
) -> list[LogFile]:
    if template is not None and (not isinstance(template, str) or "{run_id}" not in template):
        raise _bad_line(shown_mapping, "log", "file", template, 'a name that holds {run_id}, as "run_{run_id}.csv"')
    named = runs.labels.get("log")
    taken: set[Path] = set()
    matched: list[LogFile] = []
    for index, (run_id, row) in enumerate(zip(map(str, runs.run_id), map(int, runs.line), strict=True)):
        wanted = str(named[index]) if named is not None else (template or "").replace("{run_id}", run_id)
        if named is not None and not wanted:
            continue
        if wanted:
            name = wanted.replace("\\", "/").rpartition("/")[2].lower()
            found = [path for path in files if path.name.lower() == name]
        else:
            found = [path for path in files if path.stem == run_id]
        if len(found) > 1 or (wanted and files and not found):
            raise BadFileError(
                shown,
                row=row,
                column="log",
                found=f"{len(found)} source files named {wanted or run_id!r}",
                expected="one log for the run",
                remedy="name the file or its folder among the sources, or correct log.file of the mapping",
            )
        if found:
            taken.add(found[0])
            matched.append((index, run_id, found[0], str(found[0])))
        elif files or wanted:
            border.say(f"{shown}, row {row}", "no log was found for this run", "no_log", run_id=run_id)
    for path in files:
        if path not in taken:
            border.say(str(path), "belongs to no run of the table and was left out", "unused_source")
    return matched
