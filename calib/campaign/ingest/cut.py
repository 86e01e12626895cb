"""Cut a continuous recording into runs: at stops, by length, by a column, by a list of times."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from calib.arrays import BoolArray, FloatArray
from calib.campaign.readers.times import NS_PER_S, moment_ns
from calib.errors import BadFileError

METHODS: Final = ("stops", "length", "column", "times")
#: counts that a standing wheel may toggle by
_TOGGLE: Final = 3.0
#: window in which a driving wheel moves by more
_WINDOW_S: Final = 0.5
#: most of a stop that goes with the run beside it, so that both ends rest
_REST_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Cut:
    """How to cut."""

    #: one of `METHODS`
    by: str = "stops"
    #: shortest stand that ends a run, by stops
    min_stop_s: float = 1.0
    #: shorter pieces are no runs
    min_length_m: float = 0.5
    #: length of a piece, by length; one of the two
    length_m: float = 0.0
    length_s: float = 0.0
    #: source column whose value tells the runs, by column; an empty cell or 0 stands for between runs
    column: str = ""
    #: by times: pairs of start and end, as seconds from the recording's start or as times of the clock
    times: tuple[tuple[Any, Any], ...] = ()
    #: by times: columns of the run table that hold them
    start: str = ""
    end: str = ""
    #: name of a run where no table names it; ``{n}`` is its number
    run_id: str = "r{n:03}"


@dataclass(frozen=True, slots=True)
class Piece:
    """A run cut out of a recording: samples ``first`` to ``last`` inclusive."""

    first: int
    last: int


def parse_cut(section: Mapping[str, Any], shown: str) -> Cut:
    """Return the section ``[cut]`` of a mapping, checked."""

    def bad(key: str, found: Any, expected: str) -> BadFileError:
        return BadFileError(shown, repr(found)[:80], expected, "correct the mapping", column=f"cut.{key}")

    known = {field.name for field in fields(Cut)}
    for key, value in section.items():
        if key not in known:
            raise bad(key, key, f"one of {', '.join(sorted(known))}")
        kind = type(getattr(Cut(), key))
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if kind is float and not (number and value >= 0):
            raise bad(key, value, "a number, not below 0")
        if kind is str and not isinstance(value, str):
            raise bad(key, value, "a text")
        if kind is tuple and not (
            isinstance(value, list) and all(isinstance(pair, list) and len(pair) == 2 for pair in value)
        ):
            raise bad(key, value, "pairs of start and end, as [[0, 41.5], [60, 101]]")
    values: dict[str, Any] = dict(section)
    if "times" in values:
        values["times"] = tuple(map(tuple, values["times"]))
    cut = Cut(**values)
    if cut.by not in METHODS:
        raise bad("by", cut.by, f"one of {', '.join(METHODS)}")
    if cut.by == "length" and (cut.length_m > 0) == (cut.length_s > 0):
        raise bad("length_m", section.get("length_m"), "a length, either length_m or length_s")
    if cut.by == "column" and not cut.column:
        raise bad("column", "", "the column whose value tells the runs")
    if cut.by == "times" and not cut.times and not (cut.start and cut.end):
        raise bad("times", list(cut.times), "pairs of start and end, or the table's columns start and end")
    return cut


def cut_pieces(
    cut: Cut, log: Mapping[str, FloatArray], *, m_per_count: float, start_ns: int, shown: str
) -> list[Piece]:
    """Return the runs of a recording.

    Parameters
    ----------
    cut : Cut
        How.
    log : mapping of str to array of float, shape (n_samples,)
        ``t_s`` from the recording's start, the wheels' counts, and ``cut`` where a column tells the runs.
    m_per_count : float
        Nominal path of a wheel a count.
    start_ns : int
        The recording's first time.
    shown : str
        The recording, for messages.

    Returns
    -------
    list of Piece
        In order of time.
    """
    time = log["t_s"]
    if cut.by == "times":
        pieces = _by_times(cut.times, time, start_ns, shown)
        return pieces
    wheels = [column for name, column in log.items() if name.startswith("counts_")]
    path = _path(wheels, len(time)) * m_per_count
    if cut.by == "stops":
        pieces = _by_stops(time, wheels, cut.min_stop_s)
    elif cut.by == "length":
        along = path / cut.length_m if cut.length_m > 0 else (time - time[0]) / cut.length_s
        pieces = _by_change(np.floor(along + 1e-9), np.ones(len(time), dtype=np.bool_))
    else:
        values = log["cut"]
        pieces = _by_change(values, ~np.isnan(values) & (values != 0))
    return [run for run in pieces if run.last > run.first and path[run.last] - path[run.first] >= cut.min_length_m]


def moving(time: FloatArray, wheels: Sequence[FloatArray]) -> BoolArray:
    """Return where any wheel turns by more than it toggles within half a second, shape (n_samples,)."""
    out: BoolArray = np.zeros(len(time), dtype=np.bool_)
    later = np.minimum(np.searchsorted(time, time + _WINDOW_S), len(time) - 1)
    for counts in wheels:
        out |= np.abs(counts[later] - counts) > _TOGGLE
    return out


def _by_stops(time: FloatArray, wheels: Sequence[FloatArray], min_stop_s: float) -> list[Piece]:
    driving = moving(time, wheels)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], driving.astype(np.int8), [0]))))
    starts, ends = edges[::2], edges[1::2] - 1
    # the window looks ahead: a drive ends half a second after its last flag at most
    ends = np.minimum(np.searchsorted(time, time[ends] + _WINDOW_S), len(time) - 1)
    joined: list[list[int]] = []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        if joined and time[start] - time[joined[-1][1]] < min_stop_s:
            joined[-1][1] = end
        else:
            joined.append([start, end])
    rest = min(_REST_S, 0.5 * min_stop_s)
    pieces = []
    for start, end in joined:
        first = int(np.searchsorted(time, time[start] - rest))
        last = min(int(np.searchsorted(time, time[end] + rest, side="right")) - 1, len(time) - 1)
        pieces.append(Piece(first, last))
    return pieces


def _by_change(values: FloatArray, within: BoolArray) -> list[Piece]:
    change = np.flatnonzero((values[1:] != values[:-1]) | (within[1:] != within[:-1])) + 1
    bounds = [0, *change.tolist(), len(values)]
    return [Piece(first, last - 1) for first, last in itertools.pairwise(bounds) if within[first]]


def _by_times(times: Sequence[tuple[Any, Any]], time: FloatArray, start_ns: int, shown: str) -> list[Piece]:
    pieces = []
    for pair in times:
        low, high = (_seconds(end, start_ns, shown) for end in pair)
        first = int(np.searchsorted(time, low - 1e-9))
        last = int(np.searchsorted(time, high + 1e-9, side="right")) - 1
        if not first < last:
            raise BadFileError(
                shown,
                found=f"no samples from {pair[0]} to {pair[1]}; it spans {time[0]:.6g} to {time[-1]:.6g} s",
                expected="times within the recording",
                remedy="correct cut.times, in seconds from its start or as times of the clock with their zone",
            )
        pieces.append(Piece(first, last))
    return pieces


def _seconds(value: Any, start_ns: int, shown: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    try:
        text = value.isoformat() if hasattr(value, "isoformat") else str(value)
        return (moment_ns(text) - start_ns) / NS_PER_S
    except ValueError as error:
        expected = "seconds from the recording's start, or a time of the clock"
        remedy = "write it as 41.5 or as 2026-05-04T10:15:30+02:00"
        raise BadFileError(shown, f"{value!r:.40}", expected, remedy) from error


def _path(wheels: Sequence[FloatArray], n_samples: int) -> FloatArray:
    """Return the mean path of the wheels, in counts, whichever way they turn."""
    if not wheels:
        return np.arange(n_samples, dtype=np.float64)
    steps = np.mean([np.abs(np.nan_to_num(np.diff(counts, prepend=counts[:1]))) for counts in wheels], axis=0)
    total: FloatArray = np.cumsum(steps)
    return total
