"""What the site is given while it is built: the reference of all commands, from the commands themselves."""

from __future__ import annotations

import io
import os
import re
from contextlib import redirect_stdout
from unittest import mock

PAGE, PLACE = "commands.md", "<!-- reference -->"
COLUMNS = "90"


def on_page_markdown(markdown: str, page: object, **_: object) -> str:
    """Put the reference into the page of the commands."""
    return markdown.replace(PLACE, reference()) if page.file.src_uri == PAGE else markdown  # type: ignore[attr-defined]


def reference() -> str:
    """Return a section for each command: its summary, and its help as a terminal shows it."""
    from calib.cli import COMMANDS, SUMMARIES

    return "\n".join(f"## calib {name}\n\n{SUMMARIES[name]}\n\n```text\n{help_of(name)}\n```\n" for name in COMMANDS)


def help_of(name: str) -> str:
    """Return what ``calib NAME --help`` prints."""
    from calib.cli.main import run

    shown = io.StringIO()
    wide = {"COLUMNS": COLUMNS, "TERMINAL_WIDTH": COLUMNS}
    with mock.patch.dict(os.environ, wide), redirect_stdout(shown):
        run([*name.split(), "--help"])
    return re.sub(r"[ \t]+$", "", shown.getvalue(), flags=re.MULTILINE).strip("\n")
