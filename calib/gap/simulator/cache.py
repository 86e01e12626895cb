"""Results of a simulator's runs, kept by the content of all that they depend on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign.log_reading import cache_folder
from calib.errors import BadFileError, CalibError
from calib.gap.simulator.settings import SimulatorSettings
from calib.io import sha256_file, write_bytes
from calib.types import FloatArray

#: what a file is; another number makes what was kept worthless
FORMAT: Final = "calib-simulator-run/1"


@dataclass(frozen=True, slots=True)
class RunCache:
    """A folder of results, one file a run; each is written whole or not at all, a damaged one is as good as none."""

    folder: Path | None  #: None where nothing is kept
    depends: str  #: digest of the command, the simulator's files and the campaign's

    def _path(self, parameters: Mapping[str, float], repeat: int) -> Path | None:
        asked = json.dumps([FORMAT, self.depends, sorted(parameters.items()), repeat])
        name = hashlib.sha256(asked.encode()).hexdigest()
        return None if self.folder is None else self.folder / name[:2] / f"{name}.json"

    def get(self, parameters: Mapping[str, float], repeat: int, run_ids: Sequence[str]) -> FloatArray | None:
        """Return what a run simulated, shape (n_runs, 4); None where nothing whole is kept."""
        path = self._path(parameters, repeat)
        try:
            document = json.loads(b"" if path is None else path.read_bytes())
            values = np.array(document["values"], dtype=np.float64)
            if document["format"] != FORMAT or document["runs"] != list(run_ids) or values.shape != (len(run_ids), 4):
                return None
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return values

    def put(self, parameters: Mapping[str, float], repeat: int, run_ids: Sequence[str], values: FloatArray) -> None:
        """Keep what a run simulated; where that cannot be done it runs again the next time."""
        path = self._path(parameters, repeat)
        if path is None:
            return
        document = {"format": FORMAT, "runs": list(run_ids), "values": values.tolist()}
        with suppress(CalibError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_bytes(path, json.dumps(document).encode(), force=True)


def run_cache(settings: SimulatorSettings, campaign_hashes: Mapping[str, str]) -> RunCache:
    """Return the cache of a simulator on a campaign.

    Results depend on the command, on the files that it names or that ``inputs`` lists, and on the campaign's files.
    """
    folder = settings.path.resolve().parent
    files = {part: folder / part for part in settings.command if "{" not in part}
    for name in settings.inputs:
        if not (folder / name).is_file():
            raise BadFileError(
                settings.path, repr(name)[:60], "a file beside it", "correct the path, or remove it", column="inputs"
            )
        files[name] = folder / name
    hashes = {name: sha256_file(path) for name, path in files.items() if path.is_file()}
    what = json.dumps([list(settings.command), hashes, dict(campaign_hashes)], sort_keys=True)
    return RunCache(cache_folder("simulator"), hashlib.sha256(what.encode()).hexdigest())
