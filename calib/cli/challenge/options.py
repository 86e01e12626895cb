"""What the commands of the blind check share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="A set made by 'calib challenge make'.")]
Cases = Annotated[int | None, typer.Option("--cases", metavar="N", min=1, help="Only so many cases.")]
Workers = Annotated[int, typer.Option("--workers", metavar="N", min=1, help="Processes.")]
Truth = Annotated[
    Path | None, typer.Option("--truth", metavar="FILE", help="The sealed truth; DIR.truth.json where not given.")
]
