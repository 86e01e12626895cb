"""Read a campaign folder: settings, run table, logs, and what follows; a file becomes a campaign on the way."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.log_reading import read_logs
from calib.campaign.logs import log_files, rewrap_total
from calib.campaign.model import Border, Campaign, Logs, RunTable
from calib.campaign.readers import READERS, is_bag_folder, read_table
from calib.campaign.references import with_references
from calib.campaign.runs_file import run_table
from calib.campaign.settings_file import read_settings
from calib.campaign.wheels import SPEEDS, with_counts
from calib.errors import BadFileError, BadInputError
from calib.io import inside, settle, sha256_file
from calib.types import FloatArray, Progress, silent
from calib.vehicle import Vehicle, wheel_loads_N

SETTINGS: Final = "campaign.toml"
#: counts that a total and the log of the same run may differ by, since they are not read at the same instant
_SAME_COUNTS: Final = 50.0
_COUNTS: Final = ("counts_left", "counts_right")


def read_campaign(folder: Path, *, logs: bool = True, lenient: bool = False, progress: Progress = silent) -> Campaign:
    """Read a campaign.

    `folder`: holds ``campaign.toml``, ``runs.csv`` (or ``.xlsx``, ``.parquet``) and the logs that the table names, or
    ``logs/<run_id>.csv`` where it names none; `logs`: read the logs too; `lenient`: keep faults of single runs (a run
    id twice, a log missing or damaged) as notes of level ``wrong`` instead of raising the first, for a check that names
    them all. In SI units. Wheel loads that the table lacks are computed from the payload (Eqs 1 and 2), counts and
    distance that it lacks are taken from the logs; every such step is in ``notes``. Raises BadFileError where something
    cannot be used; the message names file, row and column.
    """
    folder = Path(folder)
    if not folder.is_dir():
        remedy = "give the folder that holds campaign.toml"
        raise BadFileError(folder, "a file" if folder.exists() else "no such folder", "a campaign folder", remedy)
    settle(folder)
    border = Border(lenient=lenient)
    hashes: dict[str, str] = {}
    path = inside(folder, SETTINGS, named_in=folder)
    settings = read_settings(path, SETTINGS)
    hashes[SETTINGS] = sha256_file(path)
    border.notes.extend(settings.notes)

    shown, path = _runs_path(folder)
    raw = read_table(path, shown)
    hashes[shown] = sha256_file(path)
    border.notes.extend(raw.notes)
    _say_look_alikes(folder, shown, border)
    runs = run_table(raw, shown, border)
    found_logs = Logs.empty(len(runs))
    if logs:
        files = log_files(folder, runs, shown, border)
        found_logs, of_logs = read_logs(files, len(runs), settings.encoder, border, progress=progress)
        hashes |= of_logs
        if found_logs.columns.keys() & set(SPEEDS):
            found_logs = with_counts(found_logs, settings.encoder, settings.vehicle, border)
    campaign = replace(settings, root=folder, runs=runs, logs=found_logs, hashes=hashes)
    campaign = _completed(campaign, shown, border)
    campaign = with_references(campaign, shown, border)
    return replace(campaign, notes=tuple(border.notes))


def loads_from_payload(vehicle: Vehicle, runs: RunTable) -> tuple[FloatArray, FloatArray]:
    """Return left and right wheel load of each run from its payload, shape (n_runs,) each, in N.

    NaN where the payload, or the place of a payload, is not given. A payload of 0 needs no place; a missing
    ``payload_y_m`` column means the centre line.
    """
    mass, x, y = (runs.number(name) for name in ("payload_kg", "payload_x_m", "payload_y_m"))
    if "payload_y_m" not in runs.numbers:
        y = np.zeros(len(runs))
    none = mass == 0
    _, left, right = wheel_loads_N(vehicle, mass, np.where(none, 0.0, x), np.where(none, 0.0, y))
    return left, right


def _runs_path(folder: Path) -> tuple[str, Path]:
    for suffix in READERS:
        name = f"runs{suffix}"
        if (folder / name).exists() or (folder / name).is_symlink():
            return name, inside(folder, name, named_in=folder)
    remedy = "add it, or make the campaign out of lab files with 'calib ingest'"
    raise BadFileError(folder, "no run table", "runs.csv, one row a run", remedy)


def _say_look_alikes(folder: Path, shown: str, border: Border) -> None:
    """Name what could be meant for the files that are read, and is not read: another case, another format."""
    tables = {f"runs{suffix}" for suffix in READERS}
    for name in sorted(entry.name for entry in folder.iterdir()):
        meant = shown if name.casefold() in tables else SETTINGS if name.casefold() == SETTINGS else ""
        if meant and name not in (shown, SETTINGS):
            text = f"found beside {meant}, which is read; this is not; remove one of them"
            border.say(name, text, "look_alike", level="suspicious")


def _completed(campaign: Campaign, shown: str, border: Border) -> Campaign:
    """Return the campaign with what its run table lacks: from the logs' last samples, and loads from the payload."""
    runs, logs = campaign.runs, campaign.logs
    numbers = dict(runs.numbers)

    def fill(name: str, values: FloatArray, how: str, code: str) -> None:
        column = numbers.get(name, np.full(len(runs), np.nan))
        empty = np.isnan(column) & ~np.isnan(values)
        if empty.any():
            numbers[name] = np.where(empty, values, column)
            border.say(f"{shown}, column {name}", f"{int(empty.sum())} run(s) {how}", code)

    for name in _COUNTS:
        fill(name, log_totals(logs, name), f"filled from the log's {name}", "filled")
    fill("distance_m", _last(logs, "range_m"), "filled from the log's range_m", "filled")
    campaign = replace(campaign, runs=replace(runs, numbers=numbers))
    for name in _COUNTS:
        if name in numbers:
            numbers[name] = _unwrapped(campaign, name, shown, border)
    if "payload_kg" in numbers:
        how = "computed from the payload by the static wheel loads"
        for name, load in zip(("load_left_N", "load_right_N"), loads_from_payload(campaign.vehicle, runs), strict=True):
            fill(name, load, how, "computed_load")
    return replace(campaign, runs=replace(runs, numbers=numbers))


def _unwrapped(campaign: Campaign, name: str, shown: str, border: Border) -> FloatArray:
    """Undo overflows of the table's totals: against the log, or against the distance where the width is given."""
    runs, encoder = campaign.runs, campaign.encoder
    total, logged = runs.number(name), log_totals(campaign.logs, name)
    per_rev = encoder.counts_per_rev_left if name == _COUNTS[0] else encoder.counts_per_rev_right
    driven = runs.number("distance_m") / (2 * np.pi * campaign.vehicle.wheel_radius_m) * per_rev
    for bits in (encoder.wrap_bits,) if encoder.wrap_bits else (16, 32):
        full = 2.0**bits
        turns = rewrap_total(total, logged, bits, np.full(len(runs), _SAME_COUNTS))
        if encoder.wrap_bits:
            by_distance = rewrap_total(total, driven, bits, np.minimum(0.05 * np.abs(driven), full / 4))
            turns = np.where(np.isnan(logged), by_distance, turns)
        turns = np.where(np.abs(total) < full, turns, 0.0)
        if turns.any():
            whole = total + turns * full
            for run in np.flatnonzero(turns):
                text = (
                    f"{total[run]:.0f} is the remainder of {abs(turns[run]):.0f} overflow(s) of a {bits}-bit counter; "
                    f"{whole[run]:.0f} is used"
                )
                where = f"{shown}, row {runs.line[run]}, column {name}"
                border.say(where, text, "wrapped_total", run_id=str(runs.run_id[run]))
            return np.asarray(whole)
    return total


def log_totals(logs: Logs, name: str) -> FloatArray:
    """Return last minus first of a log column for each run, shape (n_runs,); NaN where there is none."""
    first = np.full(len(logs.lengths), np.nan)
    if name in logs.columns and logs.present.any():
        first[logs.present] = logs.columns[name][logs.offsets[:-1][logs.present]]
    return np.asarray(_last(logs, name) - first)


def _last(logs: Logs, name: str) -> FloatArray:
    """Return the last value of a log column for each run, shape (n_runs,); NaN where there is none."""
    last = np.full(len(logs.lengths), np.nan)
    if name in logs.columns and logs.present.any():
        last[logs.present] = logs.columns[name][logs.offsets[1:][logs.present] - 1]
    return last


def read_or_ingest(
    path: Path, *, mapping: Path | None = None, lenient: bool = False, progress: Progress = silent
) -> Campaign:
    """Read a campaign folder, or make a campaign out of a recording or table as `ingest` would, and read that.

    `path`: a campaign folder; or a file, or the folder of a rosbag2 recording; `mapping`: the mapping of a file; a
    campaign folder takes none; `lenient`: as for `read_campaign`. Without a folder of its own (``root`` is None) where
    it was made on the way. Raises BadInputError where a campaign folder is given with a mapping, or the file cannot be
    used.
    """
    path = Path(path)
    is_campaign = path.is_dir() and not is_bag_folder(path) and ((path / SETTINGS).exists() or mapping is None)
    if is_campaign and mapping is not None:
        raise BadInputError(
            f"{path}: found a campaign and a mapping; expected a mapping only with a recording; leave it out"
        )
    if is_campaign or not path.exists():
        return read_campaign(path, lenient=lenient, progress=progress)
    from calib.campaign.ingest.build import ingest

    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / (path.stem or "campaign")
        ingested = ingest([path], folder, mapping=mapping, progress=progress)
        campaign = read_campaign(folder, lenient=lenient, progress=progress)
    known = {(note.code, note.text) for note in campaign.notes}
    notes = (*(note for note in ingested.notes if (note.code, note.text) not in known), *campaign.notes)
    return replace(campaign, root=None, notes=notes)
