"""What was driven and measured: the campaign folder, its settings, run table and logs.

A raw run table becomes a `RunTable`, a campaign a folder of the same bytes each time.
"""

import itertools
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from decimal import Decimal
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS, Border, Campaign, RunTable
from calib.campaign.readers.sheets import SUMMARY
from calib.campaign.readers.table import RawTable, comma_evidence, notes_of_commas, numbers, time_format
from calib.campaign.settings import Recognised, converted, look_alike, recognise, second_column
from calib.campaign.settings_file import to_toml, written_settings
from calib.errors import LABEL_CHARACTERS, RUNS, BadFileError, BadInputError, refuse_beyond
from calib.io import write_folder
from calib.types import BoolArray, FloatArray, IntArray, StrArray, grouped

_KNOWN: Final = (*LABEL_COLUMNS, *NUMERIC_COLUMNS, "excluded")
#: in so many spreads no run agrees by chance with a statistic of others
_BY_CHANCE: Final = 1e-6
#: label -> what it may be, since checks and end poses rest on it, and what to do about others
_CHOICES: Final = {
    "direction": (("out", "back"), 'map it when ingesting: direction = {column = "...", values = {"..." = "out"}}'),
    "loop": (("closed", "open"), "write closed where the vehicle ended on its mark"),
}
_TRUE: Final = ("true", "1", "1.0", "yes", "y", "x")
_FALSE: Final = ("false", "0", "0.0", "no", "n", "", "-")


def run_table(raw: RawTable, shown: str, border: Border) -> RunTable:
    """Return the runs in the file's order, columns recognised and in SI units.

    Raises BadFileError where run_id is missing, a cell is no number, or (not
    lenient) a run_id repeats.
    """
    matched, line = _match(raw, shown, border), raw.line
    if "run_id" not in matched:
        actual = f"only {', '.join(list(raw.columns)[:12])[:200] or 'nothing'}"
        remedy = "name each run; 'calib ingest --describe FILE' proposes a mapping of other names"
        raise BadFileError(shown, actual, "a column run_id", remedy, column="run_id")
    refuse_beyond(len(line), RUNS, shown=shown, what="runs", remedy="divide the campaign into several")
    if not len(line):
        raise BadFileError(shown, found="no rows", expected="one row a run", remedy="add the runs")
    cells = {name: raw.columns[match.found] for name, match in matched.items()}
    known = [name for name in LABEL_COLUMNS if name in cells]
    labels: dict[str, StrArray] = {name: _texts(cells[name], name, shown, line) for name in known}
    _check_run_ids(labels["run_id"], line, shown, border)
    for name, (allowed, remedy) in _CHOICES.items():
        if name in labels:
            labels[name] = np.char.lower(labels[name])
            for row in np.flatnonzero(~np.isin(labels[name], ("", *allowed))):
                expected = f"{' or '.join(allowed)}, or an empty cell"
                actual = repr(str(labels[name][row])[:40])
                fault = BadFileError(shown, actual, expected, remedy, row=int(line[row]), column=name)
                border.fault(fault, name, str(labels["run_id"][row]))
    if "session" in labels:
        labels["session"] = _sessions(labels["session"], shown, border)
    excluded = _flags(cells.get("excluded", np.full(len(line), "")), shown, line)
    numbers_of_runs = _numbers(raw, matched, shown, border)
    for at, what in _summaries(labels, numbers_of_runs, ~excluded).items():
        text = f"{str(labels['run_id'][at])!r} is {what} of other rows and no run; it is not used, remove it"
        border.say(f"{shown}, row {line[at]}", text, "summary_row", level="suspicious")
        excluded[at] = True
    return RunTable(labels=labels, numbers=numbers_of_runs, excluded=excluded, line=line)


def _sessions(session: StrArray, shown: str, border: Border) -> StrArray:
    where, labels = f"{shown}, column session", [str(label) for label in session]
    if any(time_format(label) not in {None, "time_of_day"} for label in labels):
        labels = [re.split(",?[T ]", label)[0] if time_format(label) else label for label in labels]
        border.say(where, f"times of day are no sessions: the {len(set(labels))} days are taken", "session_days")
    if 2 < len(set(labels)) == len(labels):
        text = "each run is a session of its own, so that no session shows its scatter; name days or halls"
        border.say(where, text, "session_spelling", level="suspicious")
    meant = grouped((_session_meant(label), label) for label in dict.fromkeys(labels))
    if several := [alike for alike in meant.values() if len(alike) > 1]:
        names = "; ".join(sorted(" and ".join(sorted(alike)) for alike in several))
        text = f"found {names[:200]}, spelled differently and taken as one session; spell each session in one way"
        border.say(where, text, "session_spelling", level="suspicious")
    return np.asarray([meant[_session_meant(label)][0] for label in labels], dtype=np.str_)


def _session_meant(label: str) -> str:
    plain = unicodedata.normalize("NFKC", label).strip().casefold()
    with suppress(ValueError):
        return _plain(float(plain))
    return plain


def _summaries(labels: Mapping[str, StrArray], columns: Mapping[str, FloatArray], used: BoolArray) -> dict[int, str]:
    run_id, session = labels["run_id"], labels.get("session", np.full(len(used), ""))
    reasons = {row: "a summary" for row in np.flatnonzero(used).tolist() if SUMMARY.fullmatch(run_id[row])}
    table = np.stack([columns.get(name, np.full(len(used), np.nan)) for name in NUMERIC_COLUMNS], axis=1)
    form = [re.sub(r"\d+", "0", name) for name in map(str, run_id)]
    looked_at = np.asarray(form) != Counter(form).most_common(1)[0][0]
    looked_at[-1] = True
    for row in np.flatnonzero(used & looked_at).tolist():
        others = np.flatnonzero(used & ~np.isin(np.arange(len(used)), [row, *reasons]))
        above = others[others < row]
        last = max((at for at in reasons if at < max(above, default=0)), default=-1)
        for block in (above, above[above > last], above[session[above] == session[row]], others):
            if row not in reasons and (what := _statistic(table[row], table[block])):
                reasons[row] = f"the {what}"
    return reasons


def _statistic(row: FloatArray, others: FloatArray) -> str:
    known = np.isfinite(row) & (np.isfinite(others).sum(axis=0) > 1)
    known[known] = np.nanstd(others[:, known], axis=0) > 0
    row, others = row[known], others[:, known]
    exponents = [min(0, int(Decimal(repr(float(value))).normalize().as_tuple().exponent)) for value in row]
    allowed = 0.51 * 10.0 ** np.asarray(exponents, dtype=np.float64) + 1e-9 * np.abs(row)
    chance = np.minimum(1.0, 2 * allowed / np.nanstd(others, axis=0))
    if np.prod(chance) > _BY_CHANCE or (np.abs(others - row) <= allowed).all(axis=1).any():
        return ""
    numbers_of = {
        name: getattr(np, f"nan{name}")(others, axis=0) for name in ("mean", "sum", "median", "std", "min", "max")
    }
    numbers_of["sample std"] = np.nanstd(others, axis=0, ddof=1)
    return next((name for name, of in numbers_of.items() if (np.abs(of - row) <= allowed).all()), "")


def _match(raw: RawTable, shown: str, border: Border) -> dict[str, Recognised]:
    matched: dict[str, Recognised] = {}
    for header in raw.columns:
        match = recognise(header, _KNOWN)
        if match.name in matched:
            raise second_column(match, header, shown)
        matched[match.name] = match
        border.recognised(shown, match)
        if match.unitless:
            text = f"names no unit and is not used as {match.unitless}; rename it to the unit it is in"
            border.say(f"{shown}, column {header}", text, "no_unit", level="suspicious")
    missing = [name for name in NUMERIC_COLUMNS if name not in matched]
    for match in matched.values():
        if match.name not in _KNOWN and not match.unitless and (wanted := look_alike(match.name, missing)):
            text = f"looks like {wanted} and is not used as it; rename it to {wanted} if it is, in its unit"
            border.say(f"{shown}, column {match.found}", text, "look_alike", level="suspicious")
    return matched


def _numbers(raw: RawTable, matched: Mapping[str, Recognised], shown: str, border: Border) -> dict[str, FloatArray]:
    names = [name for name in NUMERIC_COLUMNS if name in matched] + [name for name in matched if name not in _KNOWN]
    evidence = comma_evidence([raw.columns[matched[name].found] for name in names])
    values: dict[str, FloatArray] = {}
    commas = False
    for name in names:
        match = matched[name]
        try:
            column, comma = numbers(raw.columns[match.found], shown, match.found, raw.line, evidence, border.notes)
        except BadFileError as error:
            if name in NUMERIC_COLUMNS:
                raise
            text = f"found {error.found}; the column is not numeric throughout and no covariate"
            border.say(f"{shown}, row {error.row}, column {match.found}", text, "text_column")
            continue
        commas = commas or comma
        values[name] = converted(column, match.factor, match.offset)
    if commas:
        written = {matched[name].found: raw.columns[matched[name].found] for name in values}
        border.notes.extend(notes_of_commas(written, shown, raw.line))
    return values


def _texts(cells: npt.NDArray[Any], column: str, shown: str, line: IntArray) -> StrArray:
    texts = ["" if cell is None else cell.strip() if isinstance(cell, str) else _plain(cell) for cell in cells]
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
    texts = np.char.lower(_texts(cells, "excluded", shown, line))
    for row in np.flatnonzero(~np.isin(texts, (*_TRUE, *_FALSE))):
        actual, remedy = repr(str(texts[row])[:40]), "correct the cell; the reason goes into exclusion_reason"
        raise BadFileError(shown, actual, "true, false or an empty cell", remedy, row=int(line[row]), column="excluded")
    return np.isin(texts, _TRUE)


def _check_run_ids(run_ids: StrArray, line: IntArray, shown: str, border: Border) -> None:
    names, first, which = np.unique(run_ids, return_index=True, return_inverse=True)
    for at in np.flatnonzero((run_ids == "") | (first[which] < np.arange(len(run_ids)))):
        run_id, row = str(run_ids[at]), int(line[at])
        if not run_id:
            remedy = "name the run, or remove the row where it sums up others"
            raise BadFileError(shown, "an empty cell", "a name of the run", remedy, row=row, column="run_id")
        twice = f"{run_id!r}, as in row {line[first[which[at]]]}"
        remedy = "rename one run, or remove the row that was pasted twice"
        if 2 * len(names) <= len(run_ids):
            remedy = "give what stands in several rows of a run columns of their own"
        border.fault(
            BadFileError(shown, twice, "each run once", remedy, row=row, column="run_id"), "duplicate_run", run_id
        )


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

    Raises BadInputError where a campaign is there and `force` is False, or the folder cannot be written. Other files
    stay. `log_decimals`: as ``{"range_m": 4}``; other columns read back exactly; `beside`: see `write_folder`.
    """

    def fill(scratch: Path) -> None:
        logs = _log_names(campaign)
        parts = ((name, _log_bytes(campaign.logs.of(run), log_decimals or {})) for run, name in logs.items())
        for name, data in itertools.chain(parts, (beside or {}).items()):
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
        # some file systems ignore case
        free = (stem[:100] if number == 1 else f"{stem[:100]}_{number}" for number in itertools.count(1))
        name = next(name for name in free if name.lower() not in taken)
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
    if unknown := set(runs.labels) - set(LABEL_COLUMNS):
        raise BadInputError(f"run table: found the text columns {sorted(unknown)}; expected {', '.join(LABEL_COLUMNS)}")
    return csv_bytes(columns)


def csv_bytes(columns: Mapping[str, Any]) -> bytes:
    """Return columns, shape (n_rows,) each, as a table of calib's form: CSV with line feeds, UTF-8."""
    import pandas as pd

    text: str = pd.DataFrame(columns).to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")


def _log_bytes(columns: Mapping[str, FloatArray], decimals: Mapping[str, int]) -> bytes:
    frame: dict[str, object] = {}
    decimals = {"t_s": 9, **decimals}
    for name in (name for name in LOG_COLUMNS if name in columns):
        values = np.round(columns[name], decimals[name]) if name in decimals else columns[name]
        # minus zero has no integer form
        whole = np.isfinite(values).all() and (values == np.rint(values)).all() and (np.abs(values) < _INTEGER).all()
        frame[name] = values.astype(np.int64) if whole else values + 0.0
    return csv_bytes(frame)
