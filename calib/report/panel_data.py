"""What the panels of an interactive page show: the table behind them, and the unit and floor of each channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.arrays import FloatArray, StrArray

if TYPE_CHECKING:
    from bokeh.models import ColumnDataSource

#: Okabe and Ito's colours, told apart by colour-blind eyes too
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#999999")
#: points of a drawn path at most: more cannot be seen and weigh on the page
PATH_POINTS: Final = 60
#: gap along the way -> its column in `PanelData.along_m`
ALONG: Final = {"way, mm": 1, "heading, mrad": 2}


@dataclass(frozen=True, slots=True)
class CauseBar:
    """A cause as the page draws it: its share of the gap with a 95 % interval where there is one."""

    label: str
    probability: float
    share: float
    share_ci95: tuple[float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class PanelData:
    """What the panels show."""

    #: labels of each unit, shape (n_units,)
    run_id: StrArray
    session: StrArray
    kind: StrArray
    #: name and unit (``m`` or ``rad``) of each channel
    channels: tuple[tuple[str, str], ...]
    #: gap without and with the fix, NaN where a unit lacks the channel, shape (n_units, n_channels)
    before: FloatArray
    after: FloatArray
    floor: FloatArray
    #: what the gap may go with, shape (n_units,)
    covariates: Mapping[str, FloatArray]
    #: predicted paths; empty where there are none, shape (n_points, 2)
    paths_m: tuple[FloatArray, ...] = ()
    #: measured minus predicted end point, in the frame of the paths, shape (n_units, 2)
    offset_m: FloatArray | None = None
    #: distance on the way, and the gap in the way (m) and in heading (rad) there, NaN where not measured, for units
    #: with a reference or a range all along; an empty array for the others, shape (n_samples, 3)
    along_m: tuple[FloatArray, ...] = ()
    #: what the verdict names
    causes: tuple[CauseBar, ...] = ()


def _milli(values: FloatArray) -> FloatArray:
    return np.asarray(1e3 * values, dtype=np.float64)


def panel_source(data: PanelData) -> ColumnDataSource:
    """Return the one table of all panels, a row a unit: a selection in one panel is a selection in all."""
    from bokeh.models import ColumnDataSource

    _, number = np.unique(data.kind, return_inverse=True)
    columns: dict[str, Any] = {
        "run": data.run_id,
        "session": data.session,
        "kind": data.kind,
        "colour": [COLOURS[int(k) % len(COLOURS)] for k in number],
    }
    for name, values in data.covariates.items():
        columns[f"by {name}"] = values
    columns["by order driven"] = np.arange(len(data.run_id), dtype=np.float64)
    for channel, (name, _) in enumerate(data.channels):
        columns[f"before {name}"] = _milli(data.before[:, channel])
        columns[f"after {name}"] = _milli(data.after[:, channel])
    first = first_channel(data)
    columns["x"] = columns["by order driven"]
    columns["y"] = columns[f"before {first}"]
    columns["b"], columns["a"] = columns[f"before {first}"], columns[f"after {first}"]
    if data.paths_m and data.offset_m is not None:
        thin = [path[:: max(1, len(path) // PATH_POINTS)] for path in data.paths_m]
        columns["path_x"] = [path[:, 0].astype(np.float32) for path in thin]
        columns["path_y"] = [path[:, 1].astype(np.float32) for path in thin]
        ends = np.array([path[-1] for path in data.paths_m])
        columns["end_x"], columns["end_y"] = ends[:, 0], ends[:, 1]
        columns["off_x"], columns["off_y"] = data.offset_m[:, 0], data.offset_m[:, 1]
    if any(len(path) for path in data.along_m):
        columns["way"] = [np.round(path[:, 0], 4) if len(path) else np.zeros(0) for path in data.along_m]
        for name, column in ALONG.items():
            columns[f"way {name}"] = [_milli(path[:, column]) if len(path) else np.zeros(0) for path in data.along_m]
    return ColumnDataSource(columns, name="units")


def first_channel(data: PanelData) -> str:
    """Return the channel whose gap stands highest above its floor."""
    squares = (data.before / np.where(data.floor > 0, data.floor, np.nan)) ** 2
    known = np.isfinite(squares)
    ratio = np.where(known, squares, 0.0).sum(axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return data.channels[int(np.nanargmax(ratio))][0] if np.isfinite(ratio).any() else data.channels[0][0]


def channel_units(data: PanelData) -> dict[str, str]:
    """Return the unit that each channel measured is drawn in, by its name."""
    return {
        name: "mrad" if unit == "rad" else "mm"
        for (name, unit), gaps in zip(data.channels, data.before.T, strict=True)
        if np.isfinite(gaps).any()
    }


def channel_floors(data: PanelData) -> dict[str, float]:
    """Return two standard deviations of the floor of each channel in the unit that it is drawn in, by its name."""
    names = [name for name, _ in data.channels]
    squares = {name: data.floor[:, names.index(name)] ** 2 for name in channel_units(data)}
    return {
        name: 2e3 * float(np.sqrt(np.nanmean(square))) if np.isfinite(square).any() else 0.0
        for name, square in squares.items()
    }
