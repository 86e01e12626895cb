"""The one family of errors that users see.

A message says where (file, row, column), what was found, what was expected and what to do, in one line.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


class CalibError(Exception):
    """Any failure that is the input's, not the program's; its text is one helpful line."""


class BadInputError(CalibError):
    """An argument or value that cannot be used."""


class BadFileError(BadInputError):
    """A file that cannot be used.

    `found`, `expected`, `remedy`: what stands there, what should stand there, what to do about it; `row`: line of the
    file, counted from 1, header included; `column`: name of the column or key.
    """

    def __init__(
        self,
        path: Path | str,
        found: str,
        expected: str,
        remedy: str,
        *,
        row: int | None = None,
        column: str | None = None,
    ) -> None:
        where = str(path)
        if row is not None:
            where += f", row {row}"
        if column is not None:
            where += f", column {column}"
        super().__init__(f"{where}: found {found}; expected {expected}; {remedy}")
        self.path, self.row, self.column = str(path), row, column
        self.found, self.expected, self.remedy = found, expected, remedy


class RefusedError(CalibError):
    """The question cannot be answered from these data; the text says why and what would answer it."""


class ImplausibleError(CalibError):
    """Numbers that cannot be: a check has failed, and what rests on them is refused.

    `findings`: what is beyond its bounds, each with the likely unit or setting.
    """

    def __init__(self, name: str, findings: Sequence[str]) -> None:
        more = f" (and {len(findings) - 1} more)" if len(findings) > 1 else ""
        super().__init__(f"{name}: FAILED: {findings[0]}{more}; put it right, or accept it with a reason")
        self.findings = tuple(findings)


class MissingExtraError(CalibError):
    """Something that an optional part of the installation does.

    `what`: what was asked for; `package`: the package that is missing; `extra`: the extra of calib that installs it.
    """

    def __init__(self, what: str, package: str, extra: str) -> None:
        super().__init__(f"{what}: found no package {package}; expected it installed; pip install 'calib[{extra}]'")
        self.extra = extra


def would_overwrite(path: Path | str) -> BadInputError:
    """Return the error for an output that already exists."""
    return BadInputError(f"{path}: found an existing file; expected a new one; give force=True to replace it")
