"""What a geometry says: its parameters, what stayed open, the residuals by route."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calib.geometry import words
from calib.report.blocks import Block, Column, Items, Table, Text
from calib.report.numbers import left

if TYPE_CHECKING:
    from calib.geometry.result import Geometry

__all__ = ["geometry_content"]


def geometry_content(geometry: Geometry) -> tuple[Block, ...]:
    """Return the result as blocks.

    Parameters
    ----------
    geometry : Geometry
        From `calib.geometry`.
    """
    blocks: list[Block] = [Text(geometry.heading())]
    parameters = [words.cells(estimate) for estimate in geometry.estimates]
    blocks.append(_table("Parameters, with 95 % intervals.", words.HEADER, parameters))
    sentences = geometry.sentences()
    if sentences:
        blocks.append(Items(tuple(sentences)))
    routes = [words.route_cells(route) for route in geometry.routes]
    blocks.append(_table("Residuals by route: root mean square of position and heading.", words.ROUTE_HEADER, routes))
    if geometry.transfer:
        rows = [words.transfer_cells(row) for row in geometry.transfer]
        blocks.append(_table("End position error of what was left out in turn, in mm.", words.TRANSFER_HEADER, rows))
    return tuple(blocks)


def _table(caption: str, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> Table:
    columns = (left(header[0]), *(Column(title) for title in header[1:]))
    return Table(caption, columns, tuple(rows), dense=True)
