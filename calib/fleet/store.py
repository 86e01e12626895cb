"""What was read of a fleet, kept line by line: an interrupted run goes on, and new journeys alone are read."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Final

from calib.errors import BadInputError
from calib.fleet.part_sums import PartSums

__all__ = ["SUMS", "Store"]

SUMS: Final = "sums.jsonl"


class Store:
    """The file of sums in a fleet's result folder: one line a part, appended as they come.

    Parameters
    ----------
    folder : Path
        Result folder; made where it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self.path = Path(folder) / SUMS
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInputError(
                f"{folder}: found {error.strerror}; expected a folder that can be written; choose another"
            ) from error

    def read(self) -> dict[str, PartSums]:
        """Return what is kept, by part; a line cut short by an interruption is dropped."""
        kept: dict[str, PartSums] = {}
        if not self.path.is_file():
            return kept
        with self.path.open(encoding="utf-8") as stream:
            for line in stream:
                try:
                    part = PartSums.from_dict(json.loads(line))
                except (ValueError, KeyError, TypeError):
                    continue
                kept[part.part] = part
        return kept

    def append(self, part: PartSums) -> None:
        """Add a line, whole."""
        line = (json.dumps(part.to_dict(), ensure_ascii=False) + "\n").encode()
        with self.path.open("ab") as stream:
            # after an interruption the last line may lack its end
            if stream.tell() and not _ends_whole(self.path):
                stream.write(b"\n")
            stream.write(line)

    def rewrite(self, parts: list[PartSums]) -> None:
        """Put all lines in order of their parts, each once; the same bytes whatever order they came in."""
        temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}.tmp")
        with temporary.open("w", encoding="utf-8") as stream:
            for part in sorted(parts, key=lambda one: one.part):
                stream.write(json.dumps(part.to_dict(), ensure_ascii=False) + "\n")
        temporary.replace(self.path)


def _ends_whole(path: Path) -> bool:
    with path.open("rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) == b"\n"
