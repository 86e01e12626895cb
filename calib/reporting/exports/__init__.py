"""Export formats that need the fit or the runs beside the coefficients, one file each; see `FORMATS`."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Final

from calib.coefficients.formats import Artifact

#: name of the format -> module of this package; each has ``render(source, options)``, which returns its files.
#: A new format is one file and one line here
FORMATS: Final[dict[str, str]] = {
    "dcc": "dcc",
}


def export_from(path: Path | str, to: str, *, accept: str = "") -> tuple[Artifact, ...]:
    """Return the files of a campaign, or of a result folder, in a format of `FORMATS`.

    `path`: the campaign's folder or the result folder; `to`: the format; `accept`: why a law whose checks failed is
    passed on all the same; empty: it is refused. Raises BadInputError where the path cannot be used; RefusedError where
    the format needs what the source does not have.
    """
    module = importlib.import_module(f"{__name__}.{FORMATS[to]}")
    artifacts: tuple[Artifact, ...] = module.render(Path(path), accept)
    return artifacts
