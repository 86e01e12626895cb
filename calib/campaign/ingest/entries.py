"""Lines of a proposed mapping as TOML."""

from __future__ import annotations

import json
import re
from typing import Final

from calib.campaign.ingest.contents import ColumnContents
from calib.campaign.ingest.guesses import stem_and_unit
from calib.campaign.ingest.mapping import units_for
from calib.campaign.write import to_toml

#: texts of TOML
QUOTED: Final = json.JSONEncoder(ensure_ascii=False)
#: characters of a remark that lists units
_LISTED_UNITS: Final = 40


def entry(name: str, column: ColumnContents, unit: str | None, further: dict[str, object] | None = None) -> str:
    """Return one line of a mapping; a plain text where the column's name says all."""
    parts: dict[str, object] = {"column": column.name}
    bracketed = re.search(r"[\[(]", column.name) and stem_and_unit(column.name)[1] == unit
    if unit is not None and not bracketed:
        parts["unit"] = unit
    parts |= further or {}
    if len(parts) == 1:
        return f"{name} = {QUOTED.encode(column.name)}"
    return to_toml({name: [parts]}).strip().replace("[{", "{").replace("}]", "}")


def unit_remark(name: str) -> str:
    """Return the remark on a column that names no unit: those that it may be in."""
    return f"   # names no unit: {', '.join(units_for(name))[:_LISTED_UNITS]}"
