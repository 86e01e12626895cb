"""Campaign, run table and logs: the one contract that every later stage reads.

Arrays over all runs, and all logs end to end.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from html import escape
from itertools import chain
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Final
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.campaign.settings import WHEEL_LOADS, Encoder, Odometry, OdometryModel, Rangefinder, Recognised, Reference
from calib.errors import BadFileError, BadInputError
from calib.types import BoolArray, FloatArray, IntArray, StrArray
from calib.vehicle import Vehicle

if TYPE_CHECKING:
    from pandas import DataFrame

#: text columns of ``runs.csv``
LABEL_COLUMNS: Final = ("run_id", "session", "kind", "direction", "loop", "log", "exclusion_reason")

#: of tables and logs: a pose by the reference, and by an outside simulator
REFERENCE_POSE: Final = ("ref_x_m", "ref_y_m", "ref_theta_rad")
SIMULATED_POSE: Final = ("sim_x_m", "sim_y_m", "sim_theta_rad")

#: numeric columns of ``runs.csv`` with a meaning of their own; all others are covariates
NUMERIC_COLUMNS: Final = (
    *("payload_kg", "payload_x_m", "payload_y_m", *WHEEL_LOADS),
    *("speed_mps", "temperature_C", "minutes_under_load"),
    *("distance_m", "counts_left", "counts_right", "amplitude_m", "wavelength_m"),
    *(*REFERENCE_POSE, "gyro_theta_rad", "gyro_sigma_rad", *SIMULATED_POSE, "sim_distance_m"),
)

#: what a log needs: both rear wheels, four, or front wheel or rear axle and steering; of the rear as counts or speeds
WHEEL_SETS: Final = (
    ("counts_left", "counts_right"),
    ("steer_rad", "counts_front"),
    ("counts_front_left", "counts_front_right", "counts_rear_left", "counts_rear_right"),
    ("steer_rad", "counts_rear"),
    ("speed_left_mps", "speed_right_mps"),
    ("steer_rad", "speed_rear_mps"),
    ("v_mps", "omega_radps"),
)
_WHEEL_COLUMNS: Final = dict.fromkeys(chain.from_iterable(WHEEL_SETS))

#: columns of a log; ``t_s`` and one of `WHEEL_SETS` are required
LOG_COLUMNS: Final = ("t_s", *_WHEEL_COLUMNS, "gyro_z_radps", "range_m", *REFERENCE_POSE, *SIMULATED_POSE, *WHEEL_LOADS)


@dataclass(frozen=True, slots=True)
class Note:
    """Something recognised, converted or found while reading."""

    #: ``info`` (recognised or converted), ``suspicious`` or ``wrong``
    level: str
    #: file, row, column
    where: str
    #: what was found, what was expected, what to do: one sentence
    text: str
    #: name of the check: ``swapped_wheels``
    code: str = ""
    #: the run concerned, or empty
    run_id: str = ""

    @staticmethod
    def of(where: str, text: str, code: str, level: str = "suspicious", run_id: str = "") -> "Note":
        """Return a note, its text on one line; see `Note`."""
        return Note(level, where, re.sub(r"\n\s*", " ", text) if "\n" in text else text, code, run_id)

    @property
    def sentence(self) -> str:
        """Where and what, with its full stop."""
        return f"{self.where}: {self.text}{'' if self.text.endswith('?') else '.'}"


class Border:
    """Notes made while reading; a fault is raised or, leniently, kept as a note of level ``wrong``."""

    def __init__(self, *, lenient: bool) -> None:
        self.lenient = lenient
        self.notes: list[Note] = []

    def say(self, where: str, text: str, code: str, *, level: str = "info", run_id: str = "") -> None:
        """Keep a note; see `Note`."""
        self.notes.append(Note.of(where, text, code, level, run_id))

    def recognised(self, where: str, match: Recognised) -> None:
        """Note what is said of a column's name or unit."""
        if match.said:
            self.say(f"{where}, column {match.found}", match.said, "unit" if match.factor != 1.0 else "name")

    def fault(self, error: BadFileError, code: str, run_id: str = "") -> None:
        """Raise `error`, or keep it in a lenient reading."""
        if not self.lenient:
            raise error
        where, _, text = str(error).partition(": found ")
        self.say(where, f"found {text}", code, level="wrong", run_id=run_id)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RunTable:
    """The run table as arrays over runs, in the order driven."""

    #: text columns present (of `LABEL_COLUMNS`), always ``run_id``, shape (n_runs,)
    labels: Mapping[str, StrArray]
    #: numeric columns present, in SI units, NaN where empty, shape (n_runs,)
    numbers: Mapping[str, FloatArray]
    #: rows flagged out, which stay, shape (n_runs,)
    excluded: BoolArray
    #: of each row in the file, from 1, header included, shape (n_runs,)
    line: IntArray

    def __len__(self) -> int:
        return len(self.excluded)

    @property
    def run_id(self) -> StrArray:
        """Run ids, shape (n_runs,)."""
        return self.labels["run_id"]

    def label(self, name: str) -> StrArray:
        """Return a text column, shape (n_runs,); empty texts without it."""
        return self.labels[name] if name in self.labels else np.full(len(self), "", dtype=np.str_)

    def number(self, name: str) -> FloatArray:
        """Return a numeric column, shape (n_runs,); NaN without it."""
        return self.numbers[name] if name in self.numbers else np.full(len(self), np.nan)

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the further numeric columns, candidates of ``covariate:<column>``."""
        return tuple(name for name in self.numbers if name not in NUMERIC_COLUMNS)

    @staticmethod
    def empty() -> "RunTable":
        """Return a table without runs."""
        return RunTable({"run_id": np.zeros(0, np.str_)}, {}, np.zeros(0, np.bool_), np.zeros(0, np.int64))

    def frame(self) -> "DataFrame":
        """Return a pandas table, a row a run as driven; SI units, NaN where unknown."""
        from pandas import DataFrame

        return DataFrame({**self.labels, **self.numbers, "excluded": self.excluded})

    def __repr__(self) -> str:
        return f"{len(self)} runs; columns: {', '.join((*self.labels, *self.numbers))}"

    def _repr_html_(self) -> str:
        return str(self.frame().to_html(max_rows=12))

    def select(self, keep: ArrayLike) -> "RunTable":
        """Return the rows that `keep` (bool mask or indices) picks."""
        index = np.asarray(keep)
        labels = {name: column[index] for name, column in self.labels.items()}
        numbers = {name: column[index] for name, column in self.numbers.items()}
        return RunTable(labels=labels, numbers=numbers, excluded=self.excluded[index], line=self.line[index])


def stacked(tables: Sequence[RunTable]) -> RunTable:
    """Return the runs of several tables in order; missing columns are empty."""

    def whole(names: Iterable[str], column: Callable[[RunTable, str], NDArray[Any]]) -> dict[str, NDArray[Any]]:
        return {name: np.concatenate([column(runs, name) for runs in tables]) for name in dict.fromkeys(names)}

    return RunTable(
        labels=whole((name for runs in tables for name in runs.labels), RunTable.label),
        numbers=whole((name for runs in tables for name in runs.numbers), RunTable.number),
        excluded=np.concatenate([runs.excluded for runs in tables]),
        line=np.concatenate([runs.line for runs in tables]),
    )


#: larger columns are kept in a temporary file
HELD_BYTES: Final = 128 << 20


class LogColumns(Mapping[str, FloatArray]):
    """Columns of logs end to end, shape (n_samples,) each: in memory, large ones in a temporary file.

    The file is read anew each time, so that no more is held. `n_columns` may come.
    """

    def __init__(self, n_samples: int, n_columns: int) -> None:
        self._n_samples, self._file = n_samples, -1
        self._columns: dict[str, FloatArray | int] = {}
        if 8 * n_samples * n_columns > HELD_BYTES and hasattr(os, "preadv"):
            # held where nothing can be written
            with suppress(OSError), TemporaryFile() as file:
                self._file = os.dup(file.fileno())
                finalize(self, os.close, self._file)

    def add(self, name: str, column: FloatArray) -> None:
        """Add a column."""
        self._columns[name] = column
        if self._file >= 0:
            with suppress(OSError):
                place = os.fstat(self._file).st_size
                _all_bytes(column, lambda data, done: os.pwrite(self._file, data, place + done))
                self._columns[name] = place

    def part(self, name: str, samples: slice) -> FloatArray:
        """Return some samples of a column."""
        column = self._columns[name]
        if not isinstance(column, int):
            return column[samples]
        values, place = np.empty(samples.stop - samples.start), column + 8 * samples.start
        _all_bytes(values, lambda data, done: os.preadv(self._file, [data], place + done))
        return values

    def __getitem__(self, name: str) -> FloatArray:
        return self.part(name, slice(0, self._n_samples))

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __reduce__(self) -> tuple[type[dict[str, FloatArray]], tuple[dict[str, FloatArray]]]:
        return dict, (dict(self),)


def _all_bytes(column: FloatArray, move: Callable[[memoryview, int], int]) -> None:
    done, data = 0, column.data.cast("B")
    while done < len(data):
        done += move(data[done:], done)


@dataclass(frozen=True, slots=True, eq=False)
class Logs:
    """All runs' logs, end to end."""

    #: samples of run i are ``offsets[i]:offsets[i + 1]``, none without a log, shape (n_runs + 1,)
    offsets: IntArray
    #: columns of `LOG_COLUMNS`, NaN for logs without; counts unwrapped from the log's first, times from the run's
    #: start, shape (n_samples,)
    columns: Mapping[str, FloatArray]
    #: of speeds that counts were integrated from
    speeds: tuple[str, ...] = ()

    @property
    def lengths(self) -> IntArray:
        """Samples a run, shape (n_runs,)."""
        return np.diff(self.offsets)

    @property
    def present(self) -> BoolArray:
        """Whether a run has a log of two samples or more, shape (n_runs,)."""
        return self.lengths >= 2

    def of(self, run: int) -> dict[str, FloatArray]:
        """Return the columns of run number `run`, shape (n_samples_of_run,) each, without those it lacks."""
        part, columns = slice(int(self.offsets[run]), int(self.offsets[run + 1])), self.columns
        read = columns.part if isinstance(columns, LogColumns) else lambda name, part: columns[name][part]
        cut = {name: read(name, part) for name in columns}
        return {name: column for name, column in cut.items() if len(column) and not np.isnan(column).all()}

    def each(self, at_least: int = 2, *needed: str) -> Iterator[tuple[int, dict[str, FloatArray]]]:
        """Yield number and columns of each run whose log has `at_least` samples and the columns `needed`."""
        known = self.columns.keys() >= set(needed)
        logs = ((run, self.of(run)) for run in np.flatnonzero(known & (self.lengths >= at_least)).tolist())
        return ((run, log) for run, log in logs if log.keys() >= set(needed))

    def select(self, keep: ArrayLike) -> "Logs":
        """Return the logs of the runs that `keep` (bool mask or indices) picks."""
        index = np.asarray(keep)
        index = np.flatnonzero(index) if index.dtype == bool else index
        if np.array_equal(index, np.arange(len(self.lengths))):
            return self
        offsets = np.concatenate(([0], np.cumsum(self.lengths[index]))).astype(np.int64)
        parts = np.split(index, np.flatnonzero(np.diff(index) != 1) + 1)
        ends = [(runs[0], runs[-1] + 1) for runs in parts if len(runs)]
        stretches = [slice(int(self.offsets[first]), int(self.offsets[end])) for first, end in ends]
        columns = LogColumns(int(offsets[-1]), len(self.columns))
        for name, column in self.columns.items():
            columns.add(name, np.concatenate([column[:0], *(column[stretch] for stretch in stretches)]))
        return Logs(offsets=offsets, columns=columns, speeds=self.speeds)

    @staticmethod
    def empty(n_runs: int) -> "Logs":
        """Return `n_runs` runs without logs."""
        return Logs(offsets=np.zeros(n_runs + 1, dtype=np.int64), columns={})


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Campaign:
    """A campaign: vehicle, instruments, what the simulator believes, runs and logs.

    Parameters
    ----------
    root, name
        Its folder, None where it was made in memory, and its name.
    simulated
        True where a program made the data, which every report says.
    vehicle, encoder, model, rangefinder, reference, odometry
        Sections of ``campaign.toml``.
    runs, logs
        The run table, and logs of the same runs in the same order.
    notes
        What was recognised and converted while reading.
    hashes
        SHA-256 of each file, by its path in the folder.
    extra
        Further sections of ``campaign.toml``, as read (``effects``).
    assumed
        Keys of it that a program filled in (``rangefinder.sigma_m``).
    """

    root: Path | None
    name: str
    simulated: bool
    vehicle: Vehicle
    encoder: Encoder
    model: OdometryModel
    rangefinder: Rangefinder
    reference: Reference
    runs: RunTable
    logs: Logs
    notes: tuple[Note, ...] = ()
    hashes: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)
    odometry: Odometry = field(default_factory=Odometry)
    assumed: tuple[str, ...] = ()

    def select(self, keep: ArrayLike) -> "Campaign":
        """Return the campaign with the runs that `keep` (bool mask or indices) picks."""
        return replace(self, runs=self.runs.select(keep), logs=self.logs.select(keep))

    def included(self) -> "Campaign":
        """Return the campaign without the rows flagged as excluded."""
        return self if not self.runs.excluded.any() else self.select(~self.runs.excluded)

    def frame(self) -> "DataFrame":
        """Return the run table as a pandas table; see `RunTable.frame`."""
        return self.runs.frame()

    def log(self, run_id: str) -> "DataFrame":
        """Return a run's log as a pandas table, a row a sample: seconds from its start, unwrapped counts.

        Raises BadInputError without such a run or log.
        """
        from pandas import DataFrame

        if not isinstance(run_id, str) or not len(rows := np.flatnonzero(self.runs.run_id == run_id)):
            known = ", ".join(map(str, self.runs.run_id[:5]))
            raise BadInputError(f"run_id: found {run_id!r}; expected a run of {self.name}: {known} ...; name one")
        if not (columns := self.logs.of(int(rows[0]))):
            raise BadInputError(f"{run_id}: found no log; expected a run with one; see campaign.frame()")
        return DataFrame(columns)

    def summary(self) -> str:
        """Return what was driven, as lines of text."""
        runs, logs = self.runs, self.logs
        kinds, counts = np.unique(runs.label("kind"), return_counts=True)
        driven = ", ".join(f"{count} {kind or 'unspecified'}" for kind, count in zip(kinds, counts, strict=True))
        excluded = f", {int(runs.excluded.sum())} excluded" if runs.excluded.any() else ""
        lines = [
            f"Campaign {self.name}{' (simulated)' if self.simulated else ''}: {len(runs)} runs{excluded}",
            f"  kinds    {driven or 'none'}",
            f"  sessions {len(np.unique(runs.label('session')))}",
            f"  logs     {int(logs.present.sum())} runs, {int(logs.offsets[-1])} samples",
        ]
        for level in ("wrong", "suspicious"):
            n_notes = sum(note.level == level for note in self.notes)
            lines += [f"  notes    {n_notes} {level}; see 'calib check'"] if n_notes else []
        return "\n".join(lines)

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.summary())}</pre>"
