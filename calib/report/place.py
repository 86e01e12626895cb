"""Where a report goes, and writing it there whole."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from calib.errors import BadInputError
from calib.files import refuse_existing

DEFAULT_FOLDER: Final = Path("reports")
LONGEST: Final = 80


def file_name(name: str) -> str:
    """Return the PDF's name for a campaign's name: letters, digits, ``-``, ``_`` and ``.`` only."""
    kept = re.sub(r"[^\w.-]+", "-", name, flags=re.UNICODE).strip("-.")[:LONGEST].strip("-.")
    return f"{kept or 'report'}.pdf"


def place_of(name: str, into: Path | None, *, force: bool = False) -> Path:
    """Return the file that a report is written to.

    `into`: a file ending in ``.pdf``, or a folder; None: ``reports/`` of the working directory. Raises BadInputError
    where the file exists and `force` is False, or `into` is a file that is no PDF.
    """
    if into is None:
        path = DEFAULT_FOLDER / file_name(name)
    elif into.suffix.lower() == ".pdf" and not into.is_dir():
        path = into
    elif into.is_file():
        raise BadInputError(f"into: found the file {into}; expected a folder or a name ending in .pdf; choose another")
    else:
        path = into / file_name(name)
    if path.is_dir():
        raise BadInputError(f"into: found the folder {path}; expected a place for a file; choose another")
    refuse_existing([path], force=force)
    return path
