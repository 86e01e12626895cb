"""Runs out of recordings: cut, matched with the rows of a table where there is one, turned into their start frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.ingest.cut import Cut, Piece, cut_pieces
from calib.campaign.ingest.mapping import MappingFile
from calib.campaign.ingest.poses import from_start
from calib.campaign.ingest.streams import MappedLog
from calib.campaign.ingest.table import mapped_runs
from calib.campaign.model import RunTable
from calib.campaign.readers import RawTable
from calib.campaign.readers.table import objects
from calib.campaign.settings_file import Settings
from calib.campaign.wraps import detect_wrap_bits, unwrap
from calib.errors import BadFileError


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The log of one run."""

    #: its source, for messages
    shown: str
    #: under calib's names, shape (n_samples,)
    columns: Mapping[str, FloatArray]
    #: whether range and poses count from the run's start
    from_start: bool
    #: width of the counters, where overflows were undone before
    wrap_bits: int | None = None

    @staticmethod
    def of(log: MappedLog, shown: str, mapping: MappingFile, settings: Settings) -> Part:
        """Return a whole log as one run; its range and poses are turned only where the mapping says so."""
        line = next((line for line in mapping.log if line.name == "range_m"), None)
        distance = line is not None and line.from_start is True
        poses = settings.reference.frame != "map" and _stated_pose(mapping)
        columns = from_start(log.columns, poses=poses, distance=distance)
        return Part(shown, columns, distance or poses, log.wrap_bits)


def _stated_pose(mapping: MappingFile) -> bool:
    return any(line.name.startswith("ref_") and line.from_start is True for line in mapping.log)


def cut_recordings(
    runs: RunTable | None,
    table: RawTable | None,
    recordings: Mapping[Path, MappedLog],
    mapping: MappingFile,
    settings: Settings,
    border: Border,
) -> tuple[RunTable, dict[int, Part], dict[str, MappedLog], list[dict[str, Any]]]:
    """Cut recordings into runs.

    Parameters
    ----------
    runs : RunTable or None
        Rows that name the runs in the order driven; without it they are numbered.
    table : RawTable or None
        The same table as read, for columns of times.
    recordings : mapping of Path to MappedLog
        In the order driven.
    mapping : MappingFile
        Its section on cutting.
    settings : Settings
        Vehicle and encoder, for lengths.
    border : Border
        Takes notes.

    Returns
    -------
    runs : RunTable
        The rows.
    parts : dict of int to Part
        The log of each.
    whole : dict of str to MappedLog
        The recordings as they were, unwrapped, by name.
    cuts : list of dict
        Source, start and end of each run.

    Raises
    ------
    BadFileError
        Where there are not as many pieces as rows.
    """
    cut = mapping.cut or Cut()
    if cut.by == "times" and cut.start and table is not None:
        cut = replace(cut, times=_table_times(table, cut, mapping.shown))
    per_count = 2.0 * np.pi * settings.vehicle.wheel_radius_m / settings.encoder.counts_per_rev_left
    poses = settings.reference.frame != "map"
    range_line = next((line for line in mapping.log if line.name == "range_m"), None)
    distance = range_line is None or range_line.from_start is not False
    parts: dict[int, Part] = {}
    whole: dict[str, MappedLog] = {}
    cuts: list[dict[str, Any]] = []
    sources: list[str] = []
    for path, log in recordings.items():
        log, bits = _unwrapped(log, settings.encoder.wrap_bits)
        name = path.stem if path.stem not in whole else f"{path.stem}_{len(whole) + 1}"
        whole[name] = log
        for piece in cut_pieces(cut, log.columns, m_per_count=per_count, start_ns=log.start_ns, shown=str(path)):
            columns = _piece(log.columns, piece)
            parts[len(parts)] = Part(str(path), from_start(columns, poses=poses, distance=distance), True, bits)
            sources.append(name)
            cuts.append(_cut_record(path, log, piece))
    if not parts:
        expected = f"drives of at least {cut.min_length_m:g} m"
        remedy = "see what moves with 'calib ingest --describe', or cut by times"
        raise BadFileError(", ".join(map(str, recordings)), f"no run, cut by {cut.by}", expected, remedy)
    if runs is None:
        runs = _numbered(cut, sources, mapping, border)
    elif len(runs) != len(parts):
        spans = ", ".join(f"{cut_out['start_s']:.4g}-{cut_out['end_s']:.4g}" for cut_out in cuts[:12])
        raise BadFileError(
            ", ".join(map(str, recordings)),
            found=f"{len(parts)} runs, cut by {cut.by} ({spans} s), and {len(runs)} rows of the table",
            expected="as many",
            remedy="correct min_stop_s or min_length_m of [cut], or cut by times",
        )
    for number, record in enumerate(cuts):
        record["run_id"] = str(runs.run_id[number])
    return runs, parts, whole, cuts


def _unwrapped(log: MappedLog, bits: int | None) -> tuple[MappedLog, int | None]:
    """Undo overflows over the whole recording, before a cut hides them."""
    columns = dict(log.columns)
    found = log.wrap_bits if bits is None else bits
    for name in [name for name in columns if name.startswith("counts_")]:
        offsets = np.asarray([0, len(columns[name])])
        width = bits or detect_wrap_bits(columns[name], offsets)
        if width is not None:
            columns[name], _ = unwrap(columns[name], offsets, width)
            found = width
    return replace(log, columns=columns), found


def _piece(columns: Mapping[str, FloatArray], piece: Piece) -> dict[str, FloatArray]:
    cut = {name: values[piece.first : piece.last + 1] for name, values in columns.items() if name != "cut"}
    cut["t_s"] = np.round(cut["t_s"] - cut["t_s"][0], 9)
    # counts too start where the run does, whatever was driven before
    return {name: values - values[0] if name.startswith("counts_") else values for name, values in cut.items()}


def _cut_record(path: Path, log: MappedLog, piece: Piece) -> dict[str, Any]:
    start, end = (float(log.columns["t_s"][index]) for index in (piece.first, piece.last))
    return {
        "run_id": "",
        "source": str(path),
        "start_s": start,
        "end_s": end,
        "start_ns": log.start_ns + round(start * 1e9),
        "end_ns": log.start_ns + round(end * 1e9),
    }


def _numbered(cut: Cut, sources: list[str], mapping: MappingFile, border: Border) -> RunTable:
    """Return a table of numbered runs, a session a recording unless the mapping says otherwise."""
    names = [
        cut.run_id.replace("{n:03}", f"{number:03}").replace("{n:02}", f"{number:02}").replace("{n}", str(number))
        for number in range(1, len(sources) + 1)
    ]
    columns: dict[str, Any] = {"run_id": objects(names)}
    if not any(line.name == "session" for line in mapping.table):
        columns["session"] = objects(sources)
    raw = RawTable(columns, np.arange(2, len(sources) + 2, dtype=np.int64))
    return mapped_runs(raw, mapping, "the runs cut", border)


def _table_times(table: RawTable, cut: Cut, shown: str) -> tuple[tuple[Any, Any], ...]:
    for name in (cut.start, cut.end):
        if name not in table.columns:
            expected = f"a column {name!r}"
            remedy = "correct the mapping"
            raise BadFileError(
                shown, f"the table's columns {', '.join(table.columns)[:200]}", expected, remedy, column="cut.start"
            )
    return tuple(zip(table.columns[cut.start].tolist(), table.columns[cut.end].tolist(), strict=True))
