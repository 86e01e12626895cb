"""Write a campaign folder: the same campaign gives the same bytes."""

from __future__ import annotations

import datetime
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from calib.campaign.model import LABEL_COLUMNS, LOG_COLUMNS, NUMERIC_COLUMNS, Campaign, RunTable
from calib.campaign.settings import Encoder
from calib.campaign.settings_file import FORMAT
from calib.errors import BadInputError
from calib.io import write_folder
from calib.types import FloatArray

_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")


def to_toml(document: Mapping[str, Any]) -> str:
    """Return `document` as TOML: plain keys first, then one section a nested mapping.

    Raises BadInputError where a value cannot be written (a number that is not finite, None, an unknown type).
    """
    lines: list[str] = []
    _section(document, (), lines)
    return "\n".join(lines).strip("\n") + "\n"


def _section(table: Mapping[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    plain = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    if path and (plain or not table):
        lines += ["", f"[{'.'.join(_key(part) for part in path)}]"]
    lines += [f"{_key(key)} = {toml_value(value, key)}" for key, value in plain.items()]
    for key, value in table.items():
        if isinstance(value, Mapping):
            _section(value, (*path, key), lines)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    # JSON's escapes are TOML's, but for DEL
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_value(value: Any, key: str = "value") -> str:
    """Return a value as TOML on one line; see `to_toml`."""
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(str(k))} = {toml_value(v, str(k))}" for k, v in value.items()) + "}"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml_value(item, key) for item in value) + "]"
    if isinstance(value, int | float) and math.isfinite(value):
        return json.dumps(value)
    raise BadInputError(
        f"{key}: found {value!r}; expected a text, number or list that TOML can hold; correct the value"
    )


#: what a campaign folder is made of; ``ingest`` adds its record and the recordings it cut
_OURS: Final = ("campaign.toml", "runs.csv", "logs", "ingest.json")
_RECORDINGS: Final = "recordings"
_INTEGER: Final = 2.0**53
#: keys that are written only where they differ from their default, so that a plain campaign stays plain
_WHERE_GIVEN: Final = frozenset({"drive", "kind", "sensor_x_m", "sensor_y_m", "sensor_yaw_rad"})


def write_campaign(
    campaign: Campaign,
    folder: Path,
    *,
    force: bool = False,
    log_decimals: Mapping[str, int] | None = None,
    beside: Mapping[str, bytes] | None = None,
) -> Path:
    """Write ``campaign.toml``, ``runs.csv`` and ``logs/<run_id>.csv``, all of them or none, of one generation.

    Raises BadInputError where a campaign stands there and `force` is False, or the folder cannot be written.

    Parameters
    ----------
    campaign, folder, force
        What is written and where (other files there are left alone); whether it replaces a campaign that stands there.
    log_decimals
        Decimals of log columns, for example ``{"range_m": 4}``. Without it every number is written so that it reads
        back exactly, and times to the nanosecond.
    beside
        Further files of the same generation by their name in the folder: ``ingest.json``, ``recordings/...``.
    """

    def fill(scratch: Path) -> None:
        logs = _log_names(campaign)
        parts = ((name, _log_bytes(campaign.logs.of(run), log_decimals or {})) for run, name in logs.items())
        for name, data in chain(parts, (beside or {}).items()):
            (scratch / name).parent.mkdir(parents=True, exist_ok=True)
            (scratch / name).write_bytes(data)
        (scratch / "runs.csv").write_bytes(_runs_bytes(campaign.runs, logs))
        (scratch / "campaign.toml").write_text(to_toml(_settings(campaign)), encoding="utf-8", newline="\n")

    folder = Path(folder)
    ingested = (folder / _OURS[-1]).is_file() or any(name.startswith(_RECORDINGS) for name in beside or ())
    # a folder of that name which no ingestion made is the user's own
    return write_folder(folder, (*_OURS, _RECORDINGS) if ingested else _OURS, fill, force=force)


def _settings(campaign: Campaign) -> dict[str, object]:
    document: dict[str, object] = {
        "format": FORMAT,
        "name": campaign.name,
        "simulated": bool(campaign.simulated),
        **({"assumed": list(campaign.assumed)} if campaign.assumed else {}),
        **{key: _plain(getattr(campaign, key)) for key in ("vehicle", "encoder", "model", "rangefinder", "reference")},
        "encoder": _encoder_keys(campaign.encoder),
    }
    if campaign.odometry.source is not None:
        document["odometry"] = {"from": campaign.odometry.source}
    for key, value in campaign.extra.items():
        own = document.get(key)
        if isinstance(value, Mapping) and isinstance(own, dict):
            document[key] = {**value, **own}
        elif key not in document:
            document[key] = value
    return document


def _plain(section: Any) -> dict[str, float | str]:
    """Return the keys of a section that have a value; those that were added with a default only where they differ."""
    values = {field.name: (getattr(section, field.name), field.default) for field in fields(section)}
    return {
        name: value if isinstance(value, str) else float(value)
        for name, (value, default) in values.items()
        if isinstance(value, (str, int, float)) and (name not in _WHERE_GIVEN or value != default)
    }


def _encoder_keys(encoder: Encoder) -> dict[str, float | str]:
    """Return the keys of an encoder, whole numbers as such, one key for both wheels where they count alike."""
    given = _plain(encoder)
    values = {key: int(x) if isinstance(x, float) and x.is_integer() else x for key, x in given.items()}
    if values["counts_per_rev_left"] == values["counts_per_rev_right"]:
        values = {"counts_per_rev": values.pop("counts_per_rev_left")} | values
        del values["counts_per_rev_right"]
    return values


def _log_names(campaign: Campaign) -> dict[int, str]:
    names: dict[int, str] = {}
    taken: set[str] = set()
    for index in np.flatnonzero(campaign.logs.lengths > 0):
        stem = re.sub(r"[^A-Za-z0-9._-]", "_", str(campaign.runs.run_id[index])).lstrip(".") or "run"
        # compared without case, since some file systems do so
        name, number = stem[:100], 1
        while name.lower() in taken:
            number += 1
            name = f"{stem[:100]}_{number}"
        taken.add(name.lower())
        names[int(index)] = f"logs/{name}.csv"
    return names


def _runs_bytes(runs: RunTable, logs: Mapping[int, str]) -> bytes:
    first = [name for name in LABEL_COLUMNS if name in runs.labels and name not in {"log", "exclusion_reason"}]
    columns = {name: runs.labels[name].tolist() for name in first}
    for name in (*NUMERIC_COLUMNS, *runs.covariates):
        if name in runs.numbers:
            columns[name] = [_cell(value) for value in runs.numbers[name]]
    if logs:
        columns["log"] = [logs.get(index, "") for index in range(len(runs))]
    if runs.excluded.any():
        columns["excluded"] = ["true" if flag else "" for flag in runs.excluded]
    if "exclusion_reason" in runs.labels:
        columns["exclusion_reason"] = runs.labels["exclusion_reason"].tolist()
    unknown = set(runs.labels) - set(LABEL_COLUMNS)
    if unknown:
        raise BadInputError(f"run table: found the text columns {sorted(unknown)}; expected {', '.join(LABEL_COLUMNS)}")
    return csv_bytes(columns)


def csv_bytes(columns: Mapping[str, Any]) -> bytes:
    """Return columns, shape (n_rows,) each, as a table in the form that calib writes: CSV with line feeds, UTF-8."""
    import pandas as pd

    text: str = pd.DataFrame(columns).to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")


def _cell(value: float) -> str:
    if np.isnan(value):
        return ""
    return str(int(value)) if float(value).is_integer() and abs(value) < _INTEGER else repr(float(value))


def _log_bytes(columns: Mapping[str, FloatArray], decimals: Mapping[str, int]) -> bytes:
    frame: dict[str, object] = {}
    for name in LOG_COLUMNS:
        if name not in columns:
            continue
        values = columns[name]
        if name in decimals:
            values = np.round(values, decimals[name])
        elif name == "t_s":
            values = np.round(values, 9)
        # minus zero has no integer form, and would read back as plus zero
        whole = np.isfinite(values).all() and (values == np.rint(values)).all() and (np.abs(values) < _INTEGER).all()
        frame[name] = values.astype(np.int64) if whole else values + 0.0
    return csv_bytes(frame)
