"""Read ``SIM.toml``: the user's simulator's command and parameters."""

import csv
import hashlib
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, PrivateAttr, ValidationError

from calib.campaign.settings_file import load_toml
from calib.coefficients.sections import first_fault
from calib.errors import BadFileError, CalibError
from calib.gap.effects import Family, Parameter
from calib.gap.effects.library import REGISTRY
from calib.gap.effects.simulator import SIMULATOR_PREFIX
from calib.io import sha256_file, write_bytes
from calib.types import FloatArray

#: paths that the command has to name
PLACES: Final = ("{campaign}", "{parameters}", "{out}")
#: typical over largest plausible deviation, as of radii and track
TYPICAL_SHARE: Final = 0.1
#: each costs a run
MOST_PARAMETERS: Final = 200

Number = Annotated[FiniteFloat, Field(strict=True)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_.:/\-]{0,79}$")]


class Declared(BaseModel):
    """A ``[[parameter]]`` table."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    nominal: Number
    step: Number
    largest: Annotated[PositiveFloat, Field(strict=True)]
    unit: Annotated[str, Field(max_length=20)] = "1"
    sign: Literal[-1, 0, 1] = 0
    effect: str = ""

    @property
    def parameter(self) -> Parameter:
        """The deviation from nominal, for the inference."""
        return Parameter(self.name, self.unit, TYPICAL_SHARE * self.largest, self.largest, self.sign)

    @property
    def family(self) -> Family:
        """Of the effect that it replaces."""
        return REGISTRY[self.effect].family if self.effect else Family.SIMULATOR


class SimulatorSettings(BaseModel):
    """A simulator: its command and its parameters; the whole file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    #: arguments with `PLACES`; no shell
    command: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1)]
    timeout_s: PositiveFloat = 600.0
    inputs: tuple[str, ...] = ()  #: further files, beside this, that results depend on
    parameters: Annotated[tuple[Declared, ...], Field(min_length=1, max_length=MOST_PARAMETERS, alias="parameter")]
    _path: Path = PrivateAttr()

    @property
    def path(self) -> Path:
        """The file; the command runs in its folder."""
        return self._path

    @property
    def by_cause(self) -> dict[str, Declared]:
        """Parameters by the id of their cause."""
        return {SIMULATOR_PREFIX + each.name: each for each in self.parameters}

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal value of each parameter."""
        return {each.name: each.nominal for each in self.parameters}


def read_settings(path: Path) -> SimulatorSettings:
    """Read and check a ``SIM.toml``; BadFileError names the key and what to do."""
    try:
        settings = SimulatorSettings.model_validate(load_toml(path, str(path), remedy="give the path of SIM.toml"))
    except ValidationError as error:
        key, actual, expected = first_fault(error)
        of_key = {"command": 'a list: ["python", "sim.py"]', "parameter": "[[parameter]]: name, nominal, step, largest"}
        expected = of_key.get(key, expected)
        raise BadFileError(path, actual[:60], expected, "see the simulator page of the manual", column=key) from error
    settings._path = path
    for place in PLACES:
        if not any(place in part for part in settings.command):
            expected = f"an argument that holds {place}"
            raise BadFileError(path, f"no {place}", expected, "add it to the command", column="command")
    for number, each in enumerate(settings.parameters):
        if wrong := _wrong(each, {earlier.name for earlier in settings.parameters[:number]}):
            raise BadFileError(path, *wrong, column=f"parameter {each.name}")
    return settings


def _wrong(each: Declared, names: set[str]) -> tuple[str, str, str] | None:
    if each.name in names:
        return "the name twice", "one table for each parameter", "remove one of them"
    if each.step == 0.0 or not math.isfinite(1.0 / each.step) or abs(each.step) > each.largest:
        change = f"a change from nominal, not 0 and {each.largest:g} (largest) at most"
        return f"step = {each.step:g}", change, f"give step = {(each.sign or 1) * each.largest / 20:g}, for one"
    if each.sign * each.step < 0.0:
        return f"step = {each.step:g}", "a step of the sign that is physical", "give the step the sign"
    if each.effect and each.effect not in REGISTRY:
        return f"effect = {each.effect!r}"[:60], "an effect of the library", "see 'calib effects', or leave it out"
    return None


#: predictions in the order of the channels: distance, x, y, heading
COLUMNS: Final = ("sim_distance_m", "sim_x_m", "sim_y_m", "sim_theta_rad")
#: metres or radians of a run that has diverged
LARGEST: Final = 1e6
#: of a table of 100 000 runs
MOST_BYTES: Final = 32 << 20


class BadTableError(ValueError):
    """What is wrong with a simulator's table."""


def read_table(path: Path, run_ids: Sequence[str]) -> FloatArray:
    """Return runs' simulated (distance, x, y, heading), (n_runs, 4), NaN where not written; raises BadTableError."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise BadTableError(f"found a table of {path.stat().st_size} bytes; expected {MOST_BYTES} at most")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise BadTableError("found no output file; expected it to write the CSV at {out}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadTableError(f"found an output file that cannot be read ({error}); expected CSV in UTF-8") from error
    try:
        lines = [(number, row) for number, row in enumerate(csv.reader(io.StringIO(text)), start=1) if row]
    except csv.Error as error:
        raise BadTableError(f"found {error} in its CSV; expected a header and a row a run") from error
    header = [name.strip() for name in lines[0][1]] if lines else []
    columns = [name for name in COLUMNS if name in header]
    if "run_id" not in header or not columns or len(set(header)) < len(header):
        raise BadTableError(
            f"found the columns {', '.join(header)[:120] or 'none'}; expected run_id and some of {', '.join(COLUMNS)}"
        )
    by_run: dict[str, dict[str, str]] = {}
    for number, row in lines[1:]:
        if len(row) != len(header):
            raise BadTableError(f"found {len(row)} cells in row {number} of its CSV; expected {len(header)}")
        cells = dict(zip(header, row, strict=True))
        run_id = cells["run_id"].strip()
        if run_id in by_run:
            raise BadTableError(f"found run {run_id[:60]} twice in its CSV; expected a row a run")
        by_run[run_id] = cells
    if missing := [run_id for run_id in run_ids if run_id not in by_run]:
        of = f"{len(missing)} of {len(run_ids)} runs ({missing[0]} first)"
        raise BadTableError(f"found no row for {of}; expected all")
    return np.array([[_number(by_run[run].get(name, ""), name, run) for run in run_ids] for name in COLUMNS]).T.copy()


def _number(text: str, name: str, run_id: str) -> float:
    if not text.strip():
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        raise BadTableError(
            f"found {name} = {text[:30]!r} in run {run_id}; expected a number between -{LARGEST:g} and {LARGEST:g}"
        )
    return value


#: what is written wrongly -> (x, y, heading), each from which and times what, and the cure
_MILLI, _DEGREE = 1e-3, math.pi / 180.0
_BLUNDERS: Final = {
    "millimetres; write metres": ((0, 1, 2), (_MILLI, _MILLI, 1.0)),
    "headings in degrees; write radians": ((0, 1, 2), (1.0, 1.0, _DEGREE)),
    "millimetres and degrees; write metres and radians": ((0, 1, 2), (_MILLI, _MILLI, _DEGREE)),
    "y to the right; write y to the left, or exchange left and right counts": ((0, 1, 2), (1.0, -1.0, 1.0)),
    "headings clockwise; write them counter-clockwise": ((0, 1, 2), (1.0, 1.0, -1.0)),
    "motion to the other side; write y to the left, headings counter-clockwise, or exchange left and right counts": (
        (0, 1, 2),
        (1.0, -1.0, -1.0),
    ),
    "x to the right and y ahead; write x ahead, y to the left": ((1, 0, 2), (1.0, -1.0, 1.0)),
    "x and y exchanged; write x ahead, y to the left": ((1, 0, 2), (1.0, 1.0, 1.0)),
}


def written_wrong(table: FloatArray, own: FloatArray, most: float) -> str:
    """Return in words what a simulator writes wrongly; else empty.

    `table`, `own`: ends (n_runs, 4) at nominal parameters, and by the campaign's model and counts; `most`: share of way
    and turn by which these may differ on average.
    """
    length = np.maximum(np.hypot(own[:, 1], own[:, 2]), np.maximum(np.nan_to_num(own[:, 0]), 0.5))

    def off(ends: FloatArray) -> float:
        apart = ends - own[:, 1:]
        turned = np.abs((apart[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
        return float(np.mean(np.minimum(np.fmax(np.hypot(apart[:, 0], apart[:, 1]) / length, turned), 1.0)))

    ends = table[:, 1:]
    if not np.isfinite(ends).all() or not np.isfinite(own[:, 1:]).all() or off(ends) < most:
        return ""
    left = {words: off(ends[:, list(of)] * times) for words, (of, times) in _BLUNDERS.items()}
    best = min(left, key=lambda words: left[words])
    return best if left[best] < most else ""


FORMAT: Final = "calib-simulator-run/1"
#: environment variable: a folder for the cache, or ``off``
CACHE: Final = "CALIB_CACHE"


@dataclass(frozen=True, slots=True)
class RunCache:
    """A folder of results, a file per run."""

    folder: Path | None  #: None where nothing is kept
    depends: str  #: digest of the command, the simulator's files and the campaign's

    def _path(self, parameters: Mapping[str, float], repeat: int) -> Path | None:
        asked = json.dumps([FORMAT, self.depends, sorted(parameters.items()), repeat])
        name = hashlib.sha256(asked.encode()).hexdigest()
        return None if self.folder is None else self.folder / name[:2] / f"{name}.json"

    def get(self, parameters: Mapping[str, float], repeat: int, run_ids: Sequence[str]) -> FloatArray | None:
        """Return what a run simulated, (n_runs, 4); None where it is not kept whole."""
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
        """Keep what a run simulated; if that fails it runs again."""
        path = self._path(parameters, repeat)
        if path is None:
            return
        document = {"format": FORMAT, "runs": list(run_ids), "values": values.tolist()}
        with suppress(CalibError, OSError):
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            write_bytes(path, json.dumps(document).encode(), force=True)


def cache_folder() -> Path | None:
    """Return the cache folder, by `CACHE` or the user's; None where that says ``off``."""
    if chosen := os.environ.get(CACHE, ""):
        return None if chosen == "off" else Path(chosen)
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # a user may have no home
    with suppress(RuntimeError):
        return (base if base.is_absolute() else Path.home() / ".cache") / "calib" / "simulator"
    return None


def run_cache(settings: SimulatorSettings, campaign_hashes: Mapping[str, str]) -> RunCache:
    """Return a simulator's cache on a campaign, by the command, its files and the campaign's."""
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
    return RunCache(cache_folder(), hashlib.sha256(what.encode()).hexdigest())
