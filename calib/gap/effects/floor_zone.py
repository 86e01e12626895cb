"""A stretch of floor that shortens the way or turns the vehicle."""

from __future__ import annotations

from typing import Final
from weakref import WeakKeyDictionary

import numpy as np

from calib.arrays import FloatArray, IntArray
from calib.gap.effects.effect import Effect, Family, Form, Observations, Parameter, Path, Push
from calib.gap.effects.floor import common_frame, far_end_m, floor_place, lanes, map_heading_rad
from calib.gap.predict.path import predict

CELL_M: Final = 2.0
#: strips at most, and half as many cells
MOST_FORMS: Final = 40
_FEWEST_UNITS: Final = 3
#: cells are numbered (lane, column, row) in one integer; a floor is smaller than this many cells either way
_WIDE: Final = 2**16
#: lane number of a strip across all lanes
_STRIP: Final = -1


class FloorZone(Effect):
    """Within a cell of the floor: a relative change of the way, a turn per metre, the same or by the heading driven."""

    id = "floor_zone"
    title = "a zone of the floor that shortens the way or turns the vehicle"
    implausible = "a step or joint that the vehicle should not be driven over"
    family = Family.FLOOR
    needs = "logs, the poses in one frame"
    separates = "runs that cross the place beside runs that do not"
    stays = "what lies at a place of the floor is mended there; a vehicle's correction goes with it everywhere"

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for each strip and cell of about 2 m that some runs cross and others not, or cross otherwise.

        A strip lies across the whole floor, as a joint does. Only runs with a log have a place; what fewer than three
        runs cross is left out, and what tells runs apart best is kept.
        """
        if not common_frame(observations) or np.count_nonzero(observations.from_log) < _FEWEST_UNITS:
            return []
        lane, far_end = lanes(observations), far_end_m(observations)
        places: WeakKeyDictionary[Path, tuple[FloatArray, FloatArray, FloatArray]] = WeakKeyDictionary()

        def place(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
            """Return x (nowhere without a log), y and the cosine of the heading on the floor, as every cell asks."""
            if path not in places:
                x, y = floor_place(path, path.s.here(far_end))
                x[~path.s.from_log[path.s.unit]] = np.inf
                places[path] = x, y, np.cos(map_heading_rad(path))
            return places[path]

        nominal = predict(observations)
        cosine = np.cos(map_heading_rad(nominal))
        cells = _cells(observations, lane[observations.unit], *floor_place(nominal, far_end), cosine)
        along = Parameter("along", "1", typical=1e-3, largest=2e-2)
        turn = Parameter("turn", "rad/m", typical=1e-3, largest=2e-2)
        turn_by_heading = Parameter("turn_by_heading", "rad/m", typical=1e-3, largest=2e-2)

        def form(number: int, x: float, y: float, both_ways: bool) -> Form:
            strip = number < 0

            def pushes(path: Path) -> list[Push]:
                at_x, at_y, cosine = place(path)
                observations = path.s
                inside = np.flatnonzero(np.abs(at_x - x) < 0.5 * CELL_M)
                if not strip:
                    inside = inside[np.abs(at_y[inside] - y) < 0.5 * CELL_M]
                    inside = inside[observations.here(lane)[observations.unit[inside]] == number]
                share, way, *by_heading = np.zeros((3 if both_ways else 2, len(at_x)))
                share[inside], way[inside] = 1.0, np.abs(observations.path_m[inside])
                for way_by_heading in by_heading:
                    way_by_heading[inside] = way[inside] * cosine[inside]
                return [Push(left=share, right=share), *(Push(heading_rad=part) for part in (way, *by_heading))]

            where = ", whole width" if strip else f", y {y:g} m" + (f", lane {number + 1}" if lane.max() > 0 else "")
            label = f"x {x:g} m{where}"
            parameters = (along, turn, turn_by_heading) if both_ways else (along, turn)
            settings = {"x_m": x, "y_m": y, "lane": float(number), "size_m": CELL_M}
            return Form(self.id, label, parameters, pushes, settings=settings, tries=len(cells), by_parts=True)

        return [form(*cell) for cell in cells]


def _cells(
    observations: Observations, lane: IntArray, x: FloatArray, y: FloatArray, cosine: FloatArray
) -> list[tuple[int, float, float, bool]]:
    """Return (lane, x, y, driven both ways) of the strips and cells worth asking about, by place."""
    flat, one_lane = np.zeros_like(y), np.full_like(lane, _STRIP)
    aside = bool((lane != lane[0]).any()) or bool((np.abs(y) > 0.5 * CELL_M).any())
    # where all runs keep to one line, its cells are strips
    grids = [(one_lane, flat), (lane, y)] if aside else [(one_lane, flat)]
    kept: list[tuple[int, float, float, bool]] = []
    for of_lane, across in grids:
        most = MOST_FORMS if across is flat else MOST_FORMS // 2
        zones = _grid(observations, of_lane, x, across, cosine, 0.5)
        if 2 * len(zones) <= most:
            # a zone that lies across the edge of two cells fills one of the second grid
            zones += _grid(observations, of_lane, x, across, cosine, 1.0)
        zones.sort(key=lambda zone: -zone[0])
        kept += sorted(cell for _, cell in zones[:most])
    return kept


def _grid(
    observations: Observations, lane: IntArray, x: FloatArray, y: FloatArray, cosine: FloatArray, shift: float
) -> list[tuple[float, tuple[int, float, float, bool]]]:
    """Return (how much the cell tells runs apart, cell) on the grid whose columns are shifted by `shift` cells."""
    way = np.where(observations.from_log[observations.unit], np.abs(observations.path_m), 0.0)
    column = np.floor(x / CELL_M + 0.5 - shift).astype(np.int64)
    row = np.floor(y / CELL_M + 0.5).astype(np.int64)
    code = ((lane + 1) * _WIDE + np.clip(column, -_WIDE // 4, _WIDE // 4) + _WIDE // 2) * _WIDE
    code += np.clip(row, -_WIDE // 4, _WIDE // 4) + _WIDE // 2
    codes, cell = np.unique(code, return_inverse=True)
    n_units, n_cells = len(observations), len(codes)
    flat = observations.unit * n_cells + cell
    in_cell = np.bincount(flat, way, n_units * n_cells).reshape(n_units, n_cells)
    heading = np.bincount(flat, way * cosine, n_units * n_cells).reshape(n_units, n_cells)
    logged = observations.from_log
    visits = in_cell > 0.25 * CELL_M
    lateral = bool(observations.usable[:, 2].any())
    zones = []
    for number in np.flatnonzero(visits.sum(axis=0) >= _FEWEST_UNITS):
        seen = visits[:, number]
        cosines = heading[seen, number] / in_cell[seen, number]
        both_ways = bool(np.ptp(cosines) > 1.0)
        spread = float(np.std(in_cell[logged, number]))
        alike = spread < 0.05 * float(np.mean(in_cell[logged, number]))
        if alike and not (both_ways and lateral):
            continue
        first = int(np.flatnonzero(cell == number)[0])
        centre = (float(column[first] + shift) * CELL_M, float(row[first]) * CELL_M)
        worth = spread + (float(np.mean(in_cell[logged, number])) if both_ways else 0.0)
        zones.append((worth, (int(lane[first]), *centre, both_ways)))
    return zones
