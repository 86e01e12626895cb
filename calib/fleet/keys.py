"""Keys of what was read: the content of a vehicle's files and settings, and calib's version."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from calib.documents import VERSION
from calib.errors import CalibError
from calib.io import sha256_file

if TYPE_CHECKING:
    from calib.fleet.members import Member, Part

SETTINGS: Final = "campaign.toml"
#: bytes of a digest in a key: chance makes two alike in no fleet
DIGEST_BYTES: Final = 16


class Keys:
    """Makes keys of files; settings that several files share are read once.

    A key is that of the bytes which a result follows from, never of a file's time: copied, restored and corrected files
    are told apart. A result of another version of calib is not kept.
    """

    def __init__(self) -> None:
        self._settings: dict[Path, str] = {}

    def of(self, part: Part) -> str:
        """Return the key of a file of journeys with its settings and logs.

        Raises OSError where it cannot be read, CalibError where it may not be.
        """
        if part.why:
            raise CalibError(part.why)
        digest = hashlib.blake2b(VERSION.encode(), digest_size=DIGEST_BYTES)
        if part.path.parent == part.settings:
            for line in _lines(part.settings):
                digest.update(line.encode("utf-8", "surrogateescape"))
        else:
            if part.settings not in self._settings:
                self._settings[part.settings] = sha256_file(part.settings / SETTINGS)
            digest.update(f"{self._settings[part.settings]} {sha256_file(part.path)}".encode())
        return digest.hexdigest()

    def of_member(self, member: Member) -> str:
        """Return the key of all files of a vehicle."""
        return "|".join(f"{part.name}:{self.of(part)}" for part in member.parts)


def _lines(folder: Path) -> Iterator[str]:
    """Yield a line for each file of a campaign folder: its name and its content, or what stands in its place."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_symlink():
            # what it leads to within the folder has a line of its own
            yield f"{name} -> {path.readlink()}\n"
        elif path.is_file():
            yield f"{name} {sha256_file(path)}\n"
        elif not path.is_dir():
            yield f"{name} is no file\n"
