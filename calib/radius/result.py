"""The result folder of a fit: ``fit.json``, ``runs.csv``; report and export read it and compute nothing again."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from calib.campaign.model import Campaign
from calib.errors import BadFileError, CalibError, would_overwrite
from calib.files import sha256_file, write_json, write_text
from calib.radius.fitted import Fit

__all__ = ["FIT_FILE", "RUNS_FILE", "is_result", "provenance", "read_result", "write_result"]

FIT_FILE: Final = "fit.json"
RUNS_FILE: Final = "runs.csv"


def provenance(campaign: Campaign, *, version: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return where a fit comes from: version, arguments, the SHA-256 of every file read, and the ``[report]`` section.

    Parameters
    ----------
    campaign : Campaign
        Its ``hashes`` are taken; where it has none, those of ``campaign.toml`` and ``runs.csv`` are computed.
    version : str
        Version of calib.
    arguments : mapping
        Arguments of the command, plain values.
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

    Parameters
    ----------
    fit : Fit
        The fit with its provenance.
    folder : Path
        Made where missing.
    force : bool
        Replace files of an earlier result.

    Returns
    -------
    Path
        ``fit.json``.

    Raises
    ------
    BadInputError
        Where the folder holds a result and `force` is False, or cannot be written.
    """
    folder = Path(folder)
    for name in (FIT_FILE, RUNS_FILE):
        if (folder / name).exists() and not force:
            raise would_overwrite(folder / name)
    document = fit.to_dict()
    rows = document["runs"]
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(folder / RUNS_FILE, text.getvalue(), force=force)
    return write_json(folder / FIT_FILE, document, force=force)


def is_result(path: Path) -> bool:
    """Return whether `path` is a result folder or a ``fit.json`` (rather than a campaign)."""
    path = Path(path)
    return (path / FIT_FILE).is_file() if path.is_dir() else path.suffix == ".json" and path.is_file()


def read_result(path: Path) -> Fit:
    """Read a fit from a result folder or from its ``fit.json``.

    Raises
    ------
    BadFileError
        Where the file is missing, is not JSON, or is not a fit.
    """
    path = Path(path)
    file = path / FIT_FILE if path.is_dir() else path
    remedy = "make it with 'calib fit CAMPAIGN --into FOLDER'"
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadFileError(file, found=str(error.strerror), expected="a fit", remedy=remedy) from error
    except (ValueError, RecursionError) as error:
        raise BadFileError(file, found=f"no JSON ({error})", expected="a fit", remedy=remedy) from error
    if not isinstance(value, dict):
        raise BadFileError(file, found=f"a JSON {type(value).__name__}", expected="a fit", remedy=remedy)
    try:
        return Fit.from_dict(value)
    except CalibError as error:
        raise BadFileError(file, found=str(error), expected="a fit", remedy=remedy) from error
