"""A raw run table becomes the `RunTable` of later stages; a campaign a folder, of the same bytes each time."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS, Border, Campaign, RunTable
from calib.campaign.readers.table import RawTable, comma_evidence, mixed_decimal_marks, numbers
from calib.campaign.settings import Recognised, converted, look_alike, recognise, second_column
from calib.campaign.settings_file import to_toml, written_settings
from calib.errors import LABEL_CHARACTERS, RUNS, BadFileError, BadInputError, refuse_beyond
from calib.io import write_folder
from calib.types import BoolArray, FloatArray, IntArray, StrArray

_KNOWN: Final = (*LABEL_COLUMNS, *NUMERIC_COLUMNS, "excluded")
#: names of rows that sum up the others
_SUMMARY_NAMES: Final = (
    *("mean", "average", "avg", "sum", "total", "std"),
    *("mittel", "mittelwert", "summe", "moyenne", "media"),
)
#: no run has their mean or sum, to the whole count, by chance in both
_COUNTED: Final = ("counts_left", "counts_right")
_LEAST_COUNTED: Final = 2
#: different runs' counts scatter by more
_LEAST_SPREAD: Final = 5.0
#: of two runs each is the sum of the others where they are alike
_LEAST_ROWS: Final = 4
#: label -> what it may be, since checks and end poses rest on it, and what to do about others
_CHOICES: Final = {
    "direction": (("out", "back"), 'map it when ingesting: direction = {column = "...", values = {"..." = "out"}}'),
    "loop": (("closed", "open"), "write closed where the vehicle ended on its mark"),
}
_TRUE: Final = frozenset({"true", "1", "1.0", "yes", "y", "x"})
_FALSE: Final = frozenset({"false", "0", "0.0", "no", "n", "", "-"})


def run_table(raw: RawTable, shown: str, border: Border) -> RunTable:
    """Recognise columns, convert units, and check what later stages rely on.

    Rows in the file's order, SI units. Raises BadFileError where run_id is missing, a cell is no number, or (not
    lenient) a run_id repeats.
    """
    matched = _match(raw, shown, border)
    line = raw.line
    if "run_id" not in matched:
        expected = "a column run_id"
        remedy = "name each run; 'calib ingest' makes a run table out of any spreadsheet"
        raise BadFileError(
            shown, f"only {', '.join(list(raw.columns)[:12])[:200] or 'nothing'}", expected, remedy, column="run_id"
        )
    refuse_beyond(len(line), RUNS, shown=shown, what="runs", remedy="divide the campaign into several")
    if not len(line):
        raise BadFileError(shown, found="no rows", expected="one row a run", remedy="add the runs")
    known = {name: raw.columns[matched[name].found] for name in LABEL_COLUMNS if name in matched}
    labels: dict[str, StrArray] = {name: _texts(column, name, shown, line) for name, column in known.items()}
    _check_run_ids(labels["run_id"], line, shown, border)
    for name, (allowed, remedy) in _CHOICES.items():
        if name in labels:
            labels[name] = np.char.lower(labels[name])
            for row in np.flatnonzero(~np.isin(labels[name], ("", *allowed))):
                expected = f"{' or '.join(allowed)}, or an empty cell"
                found = repr(str(labels[name][row])[:40])
                fault = BadFileError(shown, found, expected, remedy, row=int(line[row]), column=name)
                border.fault(fault, name, str(labels["run_id"][row]))
    if "session" in labels:
        labels["session"] = _sessions(labels["session"], shown, border)
    excluded = np.zeros(len(line), dtype=np.bool_)
    if "excluded" in matched:
        excluded = _flags(raw.columns[matched["excluded"].found], shown, line)
    numbers_of_runs = _numbers(raw, matched, shown, border)
    summary = _summaries(labels["run_id"], numbers_of_runs, ~excluded)
    for row in np.flatnonzero(summary):
        text = f"{str(labels['run_id'][row])!r} is the mean or sum of other rows and no run; it is not used, remove it"
        border.say(f"{shown}, row {line[row]}", text, "summary_row", level="suspicious")
    return RunTable(labels=labels, numbers=numbers_of_runs, excluded=excluded | summary, line=line)


def _sessions(session: StrArray, shown: str, border: Border) -> StrArray:
    plain: dict[str, str] = {}
    written: dict[str, set[str]] = {}
    for label in dict.fromkeys(map(str, session)):
        key = unicodedata.normalize("NFKC", label).strip().casefold()
        with suppress(ValueError):
            key = _plain(float(key))
        plain.setdefault(key, label)
        written.setdefault(key, set()).add(label)
    double = {label: plain[key] for key, labels in written.items() if len(labels) > 1 for label in labels}
    if double:
        names = "; ".join(sorted(" and ".join(sorted(labels)) for labels in written.values() if len(labels) > 1))
        text = f"found {names[:200]}, spelled differently and taken as one session; spell each session in one way"
        border.say(f"{shown}, column session", text, "session_spelling", level="suspicious")
    return np.asarray([double.get(label, label) for label in map(str, session)], dtype=np.str_)


def _summaries(run_id: StrArray, columns: Mapping[str, FloatArray], used: BoolArray) -> BoolArray:
    named = used & np.isin(np.char.lower(run_id), _SUMMARY_NAMES)
    counted = [columns[name] for name in _COUNTED if name in columns and np.isfinite(columns[name]).all()]
    if len(counted) < _LEAST_COUNTED or used.sum() < _LEAST_ROWS:
        return np.asarray(named)
    table = np.stack(counted)
    n_others = used.sum() - 1
    others = np.where(used, table, 0.0).sum(axis=1)[:, None] - table
    # runs that all have the same counts are repeats
    varied = bool((np.std(table[:, used], axis=1) > _LEAST_SPREAD).all())
    alike = [varied & (np.abs(table - value) < 0.51) for value in (others, others / n_others)]
    return np.asarray(named | (used & np.any([each.all(axis=0) for each in alike], axis=0)))


def _match(raw: RawTable, shown: str, border: Border) -> dict[str, Recognised]:
    matched: dict[str, Recognised] = {}
    for found in raw.columns:
        match = recognise(found, _KNOWN)
        if match.name in matched:
            raise second_column(match, found, shown)
        matched[match.name] = match
        if match.said:
            border.say(f"{shown}, column {found}", match.said, "unit" if match.factor != 1.0 else "name")
        if match.unitless:
            text = f"names no unit and is not used as {match.unitless}; rename it to the unit it is in"
            border.say(f"{shown}, column {found}", text, "no_unit", level="suspicious")
    missing = [name for name in NUMERIC_COLUMNS if name not in matched]
    for match in matched.values():
        if match.name not in _KNOWN and not match.unitless and (wanted := look_alike(match.name, missing)):
            text = f"looks like {wanted} and is not used as it; rename it to {wanted} if it is, in its unit"
            border.say(f"{shown}, column {match.found}", text, "look_alike", level="suspicious")
    return matched


def _numbers(raw: RawTable, matched: Mapping[str, Recognised], shown: str, border: Border) -> dict[str, FloatArray]:
    known = [name for name in NUMERIC_COLUMNS if name in matched]
    further = [name for name in matched if name not in _KNOWN]
    evidence = comma_evidence([raw.columns[matched[name].found] for name in (*known, *further)])
    values: dict[str, FloatArray] = {}
    commas = False
    for name in (*known, *further):
        match = matched[name]
        cells = raw.columns[match.found]
        try:
            column, comma = numbers(
                cells, shown=shown, column=match.found, line=raw.line, decimal_comma=evidence, notes=border.notes
            )
        except BadFileError as error:
            if name in NUMERIC_COLUMNS:
                raise
            text = f"found {error.found}; the column is not numeric throughout and no covariate"
            border.say(f"{shown}, row {error.row}, column {match.found}", text, "text_column")
            continue
        commas = commas or comma
        values[name] = converted(column, match.factor, match.offset)
    if commas:
        border.say(shown, "decimal commas were read as decimal points", "decimal_comma")
        written = {matched[name].found: raw.columns[matched[name].found] for name in values}
        border.notes.extend(mixed_decimal_marks(written, shown, raw.line))
    return values


def _texts(cells: npt.NDArray[Any], column: str, shown: str, line: IntArray) -> StrArray:
    texts = ["" if cell is None else cell.strip() if isinstance(cell, str) else _plain(cell) for cell in cells]
    # all at once first: a fleet has many small run tables
    if not "".join(texts).isprintable() or max(map(len, texts), default=0) > LABEL_CHARACTERS:
        for text, row in zip(texts, map(int, line), strict=True):
            if any(ord(letter) < 32 for letter in text):
                remedy = "remove the control character"
                raise BadFileError(shown, repr(text[:40]), "a text on one line", remedy, row=row, column=column)
            limit, what = LABEL_CHARACTERS, "characters"
            refuse_beyond(len(text), limit, shown=shown, what=what, remedy="shorten the text", row=row, column=column)
    return np.asarray(texts, dtype=np.str_)


def _plain(cell: Any, whole_below: float = np.inf) -> str:
    number = float(cell)
    if np.isnan(number):
        return ""
    return str(int(number)) if number.is_integer() and abs(number) < whole_below else repr(number)


def _flags(cells: npt.NDArray[Any], shown: str, line: IntArray) -> BoolArray:
    texts = [text.lower() for text in _texts(cells, "excluded", shown, line)]
    for text, row in zip(texts, line, strict=True):
        if text not in _TRUE and text not in _FALSE:
            expected = "true, false or an empty cell"
            remedy = "correct the cell; the reason goes into exclusion_reason"
            raise BadFileError(shown, repr(text[:40]), expected, remedy, row=int(row), column="excluded")
    return np.asarray([text in _TRUE for text in texts], dtype=np.bool_)


def _check_run_ids(run_ids: Sequence[str] | StrArray, line: IntArray, shown: str, border: Border) -> None:
    first: dict[str, int] = {}
    for run_id, row in zip(map(str, run_ids), map(int, line), strict=True):
        if not run_id:
            raise BadFileError(shown, "an empty cell", "a name of the run", "name the run", row=row, column="run_id")
        if run_id in first:
            twice = f"{run_id!r}, as in row {first[run_id]}"
            remedy = "rename one run, or remove the row that was pasted twice"
            fault = BadFileError(shown, twice, "each run once", remedy, row=row, column="run_id")
            border.fault(fault, "duplicate_run", run_id)
        first.setdefault(run_id, row)


#: parts of a campaign folder; ``ingest`` adds its record and the recordings it cut
_OURS: Final = ("campaign.toml", "runs.csv", "logs", "ingest.json")
_RECORDINGS: Final = "recordings"
_INTEGER: Final = 2.0**53


def write_campaign(
    campaign: Campaign,
    folder: Path,
    *,
    force: bool = False,
    log_decimals: Mapping[str, int] | None = None,
    beside: Mapping[str, bytes] | None = None,
) -> Path:
    """Write ``campaign.toml``, ``runs.csv`` and ``logs/<run_id>.csv``, all of them or none, of one generation.

    Raises BadInputError where a campaign is there and `force` is False, or the folder cannot be written.

    Parameters
    ----------
    campaign, folder, force
        What is written and where (other files there stay); whether it replaces a campaign there.
    log_decimals
        Decimals of log columns, for example ``{"range_m": 4}``. Without it every number is written so that it reads
        back exactly, and times to the nanosecond.
    beside
        Further files of the same generation by their name in the folder: ``ingest.json``, ``recordings/...``.
    """

    def fill(scratch: Path) -> None:
        logs = _log_names(campaign)
        parts = ((name, _log_bytes(campaign.logs.of(run), log_decimals or {})) for run, name in logs.items())
        for name, data in chain(parts, (beside or {}).items()):
            (scratch / name).parent.mkdir(parents=True, exist_ok=True)
            (scratch / name).write_bytes(data)
        (scratch / "runs.csv").write_bytes(_runs_bytes(campaign.runs, logs))
        (scratch / "campaign.toml").write_text(to_toml(written_settings(campaign)), encoding="utf-8", newline="\n")

    folder = Path(folder)
    ingested = (folder / _OURS[-1]).is_file() or any(name.startswith(_RECORDINGS) for name in beside or ())
    # a folder of that name that no ingestion made is the user's
    return write_folder(folder, (*_OURS, _RECORDINGS) if ingested else _OURS, fill, force=force)


def _log_names(campaign: Campaign) -> dict[int, str]:
    names: dict[int, str] = {}
    taken: set[str] = set()
    for index in np.flatnonzero(campaign.logs.lengths > 0):
        stem = re.sub(r"[^A-Za-z0-9._-]", "_", str(campaign.runs.run_id[index])).lstrip(".") or "run"
        # compared without case, since some file systems do so
        name, number = stem[:100], 1
        while name.lower() in taken:
            number += 1
            name = f"{stem[:100]}_{number}"
        taken.add(name.lower())
        names[int(index)] = f"logs/{name}.csv"
    return names


def _runs_bytes(runs: RunTable, logs: Mapping[int, str]) -> bytes:
    first = [name for name in LABEL_COLUMNS if name in runs.labels and name not in {"log", "exclusion_reason"}]
    columns = {name: runs.labels[name].tolist() for name in first}
    for name in (*NUMERIC_COLUMNS, *runs.covariates):
        if name in runs.numbers:
            columns[name] = [_plain(value, _INTEGER) for value in runs.numbers[name]]
    if logs:
        columns["log"] = [logs.get(index, "") for index in range(len(runs))]
    if runs.excluded.any():
        columns["excluded"] = ["true" if flag else "" for flag in runs.excluded]
    if "exclusion_reason" in runs.labels:
        columns["exclusion_reason"] = runs.labels["exclusion_reason"].tolist()
    unknown = set(runs.labels) - set(LABEL_COLUMNS)
    if unknown:
        raise BadInputError(f"run table: found the text columns {sorted(unknown)}; expected {', '.join(LABEL_COLUMNS)}")
    return csv_bytes(columns)


def csv_bytes(columns: Mapping[str, Any]) -> bytes:
    """Return columns, shape (n_rows,) each, as a table of calib's form: CSV with line feeds, UTF-8."""
    import pandas as pd

    text: str = pd.DataFrame(columns).to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")


def _log_bytes(columns: Mapping[str, FloatArray], decimals: Mapping[str, int]) -> bytes:
    frame: dict[str, object] = {}
    for name in LOG_COLUMNS:
        if name not in columns:
            continue
        values = columns[name]
        if name in decimals:
            values = np.round(values, decimals[name])
        elif name == "t_s":
            values = np.round(values, 9)
        # minus zero has no integer form and would read back as plus zero
        whole = np.isfinite(values).all() and (values == np.rint(values)).all() and (np.abs(values) < _INTEGER).all()
        frame[name] = values.astype(np.int64) if whole else values + 0.0
    return csv_bytes(frame)
