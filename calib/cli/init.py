"""``calib init``: an empty campaign with a remark beside every key."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli import terminal


def run(
    folder: Annotated[Path, typer.Argument(help="Campaign folder to make.")],
) -> None:
    """Make an empty campaign to fill in by hand: campaign.toml with remarks, runs.csv with its header, logs.

    What a laboratory has already, in spreadsheets, loggers or recordings, goes in with 'calib ingest' instead.

    Example: calib init hall3
    """
    from calib.campaign.ingest.describe import write_blank
    from calib.reporting.next_step import after_init

    written = write_blank(folder, force=terminal.forced())
    terminal.emit_json({"campaign": str(folder), "written": [str(path) for path in written]})
    if not terminal.wants_stdout():
        terminal.wrote(written)
        terminal.then(after_init(folder))
