"""Open what a command is given: a campaign folder, or a file that becomes a campaign on the way."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from calib.campaign.model import Campaign
from calib.campaign.read import SETTINGS, read_campaign
from calib.campaign.readers import is_bag_folder
from calib.errors import BadInputError
from calib.types import Progress, silent


def read_or_ingest(
    path: Path,
    *,
    mapping: Path | None = None,
    lenient: bool = False,
    progress: Progress = silent,
) -> Campaign:
    """Read a campaign folder, or make a campaign out of a recording or table as `ingest` would, and read that.

    `path`: a campaign folder; or a file, or the folder of a rosbag2 recording; `mapping`: the mapping of a file; a
    campaign folder takes none; `lenient`: as for `read_campaign`. Without a folder of its own (``root`` is None) where
    it was made on the way. Raises BadInputError where a campaign folder is given with a mapping, or the file cannot be
    used.
    """
    path = Path(path)
    if path.is_dir() and not is_bag_folder(path) and ((path / SETTINGS).exists() or mapping is None):
        if mapping is not None:
            raise BadInputError(
                f"{path}: found a campaign and a mapping; expected a mapping only with a recording; leave it out"
            )
        return read_campaign(path, lenient=lenient, progress=progress)
    if not path.exists():
        return read_campaign(path, lenient=lenient, progress=progress)
    from calib.campaign.ingest.build import ingest

    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / (path.stem or "campaign")
        ingested = ingest([path], folder, mapping=mapping, progress=progress)
        campaign = read_campaign(folder, lenient=lenient, progress=progress)
    known = {(note.code, note.text) for note in campaign.notes}
    notes = (*(note for note in ingested.notes if (note.code, note.text) not in known), *campaign.notes)
    return replace(campaign, root=None, notes=notes)
