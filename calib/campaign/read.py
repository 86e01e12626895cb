"""Read a campaign folder: settings, run table, logs, and what follows; a file becomes a campaign on the way."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.counters import rewrap_total
from calib.campaign.log_reading import read_logs
from calib.campaign.logs_file import log_files
from calib.campaign.model import Border, Campaign, Logs, RunTable
from calib.campaign.readers import READERS, is_bag_folder, read_table
from calib.campaign.references import with_references
from calib.campaign.runs_file import run_table
from calib.campaign.settings_file import Settings, read_settings
from calib.campaign.wheels import SPEEDS, with_counts
from calib.errors import BadFileError, BadInputError
from calib.io import inside, settle, sha256_file
from calib.types import BoolArray, FloatArray, Progress, silent
from calib.vehicle import Vehicle, wheel_loads_N

SETTINGS: Final = "campaign.toml"
#: counts that a total and the log of the same run may differ by, since they are not read at the same instant
_SAME_COUNTS: Final = 50.0


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
    numbers = _filled_from_logs(runs, found_logs, shown, border)
    numbers = _totals_unwrapped(runs, numbers, found_logs, settings, shown, border)
    numbers = _filled_loads(settings.vehicle, runs, numbers, shown, border)
    campaign = settings.campaign(replace(runs, numbers=numbers), found_logs, root=folder, hashes=hashes)
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
            border.say(
                name,
                f"found beside {meant}, which is read; this is not; remove one of them",
                "look_alike",
                level="suspicious",
            )


def _filled_from_logs(runs: RunTable, logs: Logs, shown: str, border: Border) -> dict[str, FloatArray]:
    """Fill counts and distance that the table lacks from the logs' last samples."""
    numbers = dict(runs.numbers)
    present = logs.present
    if not present.any():
        return numbers
    first, last = logs.offsets[:-1][present], logs.offsets[1:][present] - 1
    for name, source in (
        ("counts_left", "counts_left"),
        ("counts_right", "counts_right"),
        ("distance_m", "range_m"),
    ):
        log = logs.columns.get(source)
        if log is None:
            continue
        total = np.full(len(runs), np.nan)
        total[present] = log[last] - log[first] if source != "range_m" else log[last]
        column = runs.number(name)
        fill = np.isnan(column) & ~np.isnan(total)
        if fill.any():
            numbers[name] = np.where(fill, total, column)
            border.say(f"{shown}, column {name}", f"{int(fill.sum())} run(s) filled from the log's {source}", "filled")
    return numbers


def _totals_unwrapped(
    runs: RunTable,
    numbers: Mapping[str, FloatArray],
    logs: Logs,
    settings: Settings,
    shown: str,
    border: Border,
) -> dict[str, FloatArray]:
    """Undo overflows of the table's totals: against the log, or against the distance where the width is given."""
    out = dict(numbers)
    for side, per_rev in (
        ("left", settings.encoder.counts_per_rev_left),
        ("right", settings.encoder.counts_per_rev_right),
    ):
        name = f"counts_{side}"
        if name not in numbers:
            continue
        total = numbers[name]
        logged = log_totals(logs, name)
        radius = settings.vehicle.wheel_radius_m
        driven = numbers.get("distance_m", np.full(len(runs), np.nan)) / (2 * np.pi * radius) * per_rev
        for bits in (settings.encoder.wrap_bits,) if settings.encoder.wrap_bits else (16, 32):
            full = 2.0**bits
            inside_span: BoolArray = np.abs(total) < full
            turns = rewrap_total(total, logged, bits, np.full(len(runs), _SAME_COUNTS))
            if settings.encoder.wrap_bits:
                by_distance = rewrap_total(total, driven, bits, np.minimum(0.05 * np.abs(driven), full / 4))
                turns = np.where(np.isnan(logged), by_distance, turns)
            turns = np.where(inside_span & np.isfinite(turns), turns, 0.0)
            if turns.any():
                out[name] = total + turns * full
                for index in np.flatnonzero(turns):
                    border.say(
                        f"{shown}, row {runs.line[index]}, column {name}",
                        f"{total[index]:.0f} is the rest of {abs(turns[index]):.0f} overflow(s) of a {bits}-bit "
                        f"counter; {out[name][index]:.0f} is used",
                        "wrapped_total",
                        run_id=str(runs.run_id[index]),
                    )
                break
    return out


def log_totals(logs: Logs, name: str) -> FloatArray:
    """Return last minus first of a log column for each run, shape (n_runs,); NaN where there is none."""
    total = np.full(len(logs.lengths), np.nan)
    column = logs.columns.get(name)
    present = logs.present
    if column is not None and present.any():
        total[present] = column[logs.offsets[1:][present] - 1] - column[logs.offsets[:-1][present]]
    return total


def _filled_loads(
    vehicle: Vehicle, runs: RunTable, numbers: Mapping[str, FloatArray], shown: str, border: Border
) -> dict[str, FloatArray]:
    out = dict(numbers)
    if "payload_kg" not in numbers:
        return out
    for name, computed in zip(("load_left_N", "load_right_N"), loads_from_payload(vehicle, runs), strict=True):
        column = numbers.get(name, np.full(len(runs), np.nan))
        fill = np.isnan(column) & ~np.isnan(computed)
        if fill.any():
            out[name] = np.where(fill, computed, column)
            border.say(
                f"{shown}, column {name}",
                f"{int(fill.sum())} run(s) computed from the payload by the static wheel loads",
                "computed_load",
            )
    return out


def read_or_ingest(
    path: Path,
    *,
    mapping: Path | None = None,
    lenient: bool = False,
    progress: Progress = silent,
) -> Campaign:
    """Read a campaign folder, or make a campaign out of a recording or table as `ingest` would, and read that.

    `path`: a campaign folder; or a file, or the folder of a rosbag2 recording; `mapping`: the mapping of a file; a
    campaign folder takes none; `lenient`: as for `read_campaign`. Without a folder of its own (``root`` is None) where
    it was made on the way. Raises BadInputError where a campaign folder is given with a mapping, or the file cannot be
    used.
    """
    path = Path(path)
    if path.is_dir() and not is_bag_folder(path) and ((path / SETTINGS).exists() or mapping is None):
        if mapping is not None:
            raise BadInputError(
                f"{path}: found a campaign and a mapping; expected a mapping only with a recording; leave it out"
            )
        return read_campaign(path, lenient=lenient, progress=progress)
    if not path.exists():
        return read_campaign(path, lenient=lenient, progress=progress)
    from calib.campaign.ingest.build import ingest

    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / (path.stem or "campaign")
        ingested = ingest([path], folder, mapping=mapping, progress=progress)
        campaign = read_campaign(folder, lenient=lenient, progress=progress)
    known = {(note.code, note.text) for note in campaign.notes}
    notes = (*(note for note in ingested.notes if (note.code, note.text) not in known), *campaign.notes)
    return replace(campaign, root=None, notes=notes)
