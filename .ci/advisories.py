"""Hold the installed packages against advisories in a file: OSV's export of PyPI, needs no network.

The file is OSV's ``all.zip``, a JSON list of OSV records, or one record. Status 0: none known; 1: some; 3: the file
holds none for PyPI, so that nothing could be looked up.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from collections.abc import Iterator, Mapping
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from packaging.version import InvalidVersion, Version

Record = Mapping[str, Any]


def plain(name: str) -> str:
    """Return a package's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def records(path: Path) -> Iterator[Record]:
    """Yield the records of a file."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            for entry in archive.namelist():
                if entry.endswith(".json"):
                    yield json.loads(archive.read(entry))
        return
    document = json.loads(path.read_text(encoding="utf-8"))
    yield from document if isinstance(document, list) else [document]


def within(version: Version, events: list[Mapping[str, str]]) -> bool:
    """Return whether a version lies in a range of OSV: introduced, and not fixed or beyond the last affected one."""
    inside = False
    # in the order of versions, for any order in the file; at one version the end of a range comes first
    steps = sorted((Version(text), kind == "introduced", kind) for event in events for kind, text in event.items())
    for at, starts, kind in steps:
        if starts and version >= at:
            inside = True
        elif (kind == "fixed" and version >= at) or (kind == "last_affected" and version > at):
            inside = False
    return inside


def _within(version: str, events: list[Mapping[str, str]]) -> bool:
    try:
        return within(Version(version), events)
    except InvalidVersion:
        # a version that cannot be compared: better one warning too many
        return True


def affected(record: Record, installed: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    """Yield name, version and the versions that mend it, of installed packages that a record speaks of."""
    if record.get("withdrawn"):
        return
    for part in record.get("affected", ()):
        package = part.get("package", {})
        name = plain(str(package.get("name", "")))
        if package.get("ecosystem") != "PyPI" or name not in installed:
            continue
        ranges = [entry["events"] for entry in part.get("ranges", ()) if entry.get("type") == "ECOSYSTEM"]
        version = installed[name]
        if version in part.get("versions", ()) or any(_within(version, events) for events in ranges):
            fixed = [event["fixed"] for events in ranges for event in events if "fixed" in event]
            yield name, version, ", ".join(fixed) or "no version yet"


def main(path: Path) -> int:
    """Print what is known of the installed packages."""
    installed = {}
    for found in distributions():
        try:
            installed[plain(found.metadata["Name"])] = str(Version(found.version))
        except (InvalidVersion, TypeError):
            continue
    known, weak = 0, 0
    try:
        for record in records(path):
            parts = record.get("affected", ())
            known += any(part.get("package", {}).get("ecosystem") == "PyPI" for part in parts)
            for name, version, fixed in affected(record, installed):
                weak += 1
                sys.stdout.write(f"audit: {name} {version}: {record.get('id', '?')}, corrected in {fixed}\n")
    except (OSError, ValueError, AttributeError, KeyError) as error:
        sys.stdout.write(f"audit: NOT DONE: {path}: {error}\n")
        return 3
    if not known:
        sys.stdout.write(f"audit: NOT DONE: {path} holds no advisory of PyPI\n")
        return 3
    sys.stdout.write(f"audit: {len(installed)} packages held against {known} advisories, {weak} weaknesses known\n")
    return int(weak > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
