"""The wheel at the highest compression: a build backend packs it at the usual one."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Packed(BuildHookInterface[Any]):
    """Pack a wheel again after it was built; other artifacts stay as they are."""

    def finalize(self, _: str, __: dict[str, Any], artifact_path: str) -> None:
        """Replace a wheel by one with the same entries."""
        whole = Path(artifact_path)
        if whole.suffix != ".whl":
            return
        packed = whole.with_suffix(".packed")
        with ZipFile(whole) as old, ZipFile(packed, "w") as new:
            for entry in old.infolist():
                new.writestr(entry, old.read(entry), ZIP_DEFLATED, 9)
        shutil.move(packed, whole)
