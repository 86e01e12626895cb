"""Where faults of single rows and logs go: raised at once, or gathered so that a check can name them all."""

from __future__ import annotations

from calib.campaign.model import Note
from calib.errors import BadFileError


class Border:
    """Notes made while reading; a fault is raised, or in a lenient reading kept as a note of level ``wrong``."""

    def __init__(self, *, lenient: bool) -> None:
        self.lenient = lenient
        self.notes: list[Note] = []

    def say(self, where: str, text: str, code: str, *, level: str = "info", run_id: str = "") -> None:
        """Keep a note.

        Parameters
        ----------
        where : str
            File, row and column.
        text : str
            What was found, what was expected, what to do.
        code : str
            Name of the fault.
        level : str
            ``wrong``, ``suspicious`` or ``info``.
        run_id : str
            The run concerned; empty where it is none.
        """
        self.notes.append(Note(level, where, text, code, run_id))

    def fault(self, error: BadFileError, code: str, run_id: str = "") -> None:
        """Raise `error`, or keep it where the reading is lenient."""
        if not self.lenient:
            raise error
        where = error.path
        if error.row is not None:
            where += f", row {error.row}"
        if error.column is not None:
            where += f", column {error.column}"
        self.say(
            where, f"found {error.found}; expected {error.expected}; {error.remedy}", code, level="wrong", run_id=run_id
        )
