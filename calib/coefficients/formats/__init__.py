"""Export formats, one file each; a new format is one file and one line here."""

from __future__ import annotations

from typing import Final

__all__ = ["FORMATS"]

#: name of the format -> module of this package; each has ``render(file, options)``, which makes its files, and states
#: ``AXLE_ONLY = True`` where it knows two wheels on one axle alone
FORMATS: Final[dict[str, str]] = {
    "json": "json_master",
    "ros2": "ros2",
    "c": "c_header",
    "csv": "csv_table",
}
