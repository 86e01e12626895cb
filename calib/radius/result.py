"""The result folder of a fit: ``fit.json``, ``runs.csv``; report and export read it and compute nothing again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from calib.campaign.model import Campaign
from calib.errors import BadFileError, CalibError
from calib.files import csv_text, sha256_file, to_json
from calib.folders import settle, write_files
from calib.radius.fitted import Fit
from calib.seal import CHECKSUM_KEY, checksum

FIT_FILE: Final = "fit.json"
RUNS_FILE: Final = "runs.csv"
#: what ``calib fit --json`` adds for other programs; nothing here reads it
_ADDED: Final = ("model_comparison",)
REMEDY: Final = "make it with 'calib fit CAMPAIGN --into FOLDER'"


def provenance(campaign: Campaign, *, version: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return where a fit comes from: version, arguments, the SHA-256 of every file read, and the ``[report]`` section.

    `campaign`: its ``hashes`` are taken; where it has none, those of ``campaign.toml`` and ``runs.csv`` are computed;
    `arguments`: arguments of the command, plain values.
    """
    hashes = dict(campaign.hashes)
    if not hashes and campaign.root is not None:
        for name in ("campaign.toml", "runs.csv"):
            if (campaign.root / name).is_file():
                hashes[name] = sha256_file(campaign.root / name)
    record = {"version": version, "arguments": dict(arguments), "inputs": dict(sorted(hashes.items()))}
    if "report" in campaign.extra:
        # dates of TOML become texts
        record["report"] = json.loads(json.dumps(campaign.extra["report"], default=str))
    return record


def write_result(fit: Fit, folder: Path, *, force: bool = False) -> Path:
    """Write a fit into a result folder: ``fit.json`` whole, and ``runs.csv`` for other programs.

    `fit`: the fit with its provenance; `folder`: made where missing. ``fit.json``. Raises BadInputError where the
    folder holds a result and `force` is False, or cannot be written.
    """
    folder = Path(folder)
    document = fit.to_dict()
    rows = document["runs"]
    text = csv_text(list(rows[0]), (row.values() for row in rows))
    files = {RUNS_FILE: text.encode("utf-8", "backslashreplace"), FIT_FILE: to_json(document).encode("utf-8")}
    write_files(folder, files, force=force)
    return folder / FIT_FILE


def _check_seal(file: Path, value: dict[str, Any]) -> None:
    """Refuse a fit that is not as it was written: report and export compute nothing again, and would pass it on."""
    stated = value.get(CHECKSUM_KEY)
    try:
        computed = checksum({key: part for key, part in value.items() if key not in _ADDED})
    except (ValueError, OverflowError, RecursionError) as error:
        raise BadFileError(file, found=f"a number that is none ({error})", expected="a fit", remedy=REMEDY) from error
    if stated != computed:
        expected = f"{computed}, which its content has; the file was changed, or made by an older version"
        raise BadFileError(
            file, "no checksum" if stated is None else f"{str(stated)[:80]!r}", expected, REMEDY, column=CHECKSUM_KEY
        )


def is_result(path: Path) -> bool:
    """Return whether `path` is a result folder or a ``fit.json`` (rather than a campaign)."""
    path = Path(path)
    return (path / FIT_FILE).is_file() if path.is_dir() else path.suffix == ".json" and path.is_file()


def read_result(path: Path) -> Fit:
    """Read a fit from a result folder or from its ``fit.json``.

    Raises BadFileError where the file is missing, is not JSON, is not a fit, or has been changed since it was written.
    """
    path = Path(path)
    if path.is_dir():
        settle(path)
    file = path / FIT_FILE if path.is_dir() else path
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadFileError(file, found=str(error.strerror), expected="a fit", remedy=REMEDY) from error
    except (ValueError, RecursionError) as error:
        raise BadFileError(file, found=f"no JSON ({error})", expected="a fit", remedy=REMEDY) from error
    if not isinstance(value, dict):
        raise BadFileError(file, found=f"a JSON {type(value).__name__}", expected="a fit", remedy=REMEDY)
    _check_seal(file, value)
    try:
        return Fit.from_dict(value)
    except CalibError as error:
        raise BadFileError(file, found=str(error), expected="a fit", remedy=REMEDY) from error
