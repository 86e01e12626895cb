"""The fit of a campaign, and its result folder."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from calib.campaign.checks import SIDES
from calib.campaign.model import Campaign
from calib.campaign.settings import Encoder, OdometryModel, Rangefinder, Reference
from calib.documents import CHECKSUM_KEY, VERSION, Result, checksum, csv_text, plain, to_json
from calib.errors import BadFileError, BadInputError, CalibError
from calib.io import settle, write_files
from calib.radius import groups_of
from calib.radius.effective import Component, EffectiveRadii, UnusedRun
from calib.radius.law import LARGEST_DOF, RadiusLaw, half_width
from calib.radius.regression import RUN_ARRAYS, Check, WheelFit, from_plain, paired_law
from calib.types import Row
from calib.vehicle import Vehicle

if TYPE_CHECKING:
    from pandas import DataFrame

FORMAT: Final = "calib-fit/1"
FIT_FILE: Final = "fit.json"
RUNS_FILE: Final = "runs.csv"
PLAUSIBLE: Final = "plausible"
#: keys that ``calib fit --json`` adds, outside the checksum
_ADDED: Final = ("model_comparison",)
STATED_SECTIONS: Final = ("report", "certificate")
_WRITTEN: Final = ("simulated", "static", "notes", "setup", "provenance", "passed", "verdict")
REMEDY: Final = "make it with 'calib fit CAMPAIGN --into FOLDER'"
_TEXTS: Final = ("run_id", "session", "direction", "path_source")
_RUN_COLUMNS: Final = tuple(
    column.name for column in fields(EffectiveRadii) if column.name not in {"budget", "left_out", "notes"}
)


@dataclass(frozen=True, slots=True)
class Setup:
    """Vehicle, instruments and conditions: a report needs no campaign."""

    #: of ``campaign.toml``
    vehicle: Vehicle
    encoder: Encoder
    model: OdometryModel
    rangefinder: Rangefinder
    reference: Reference
    #: column of the run table -> least and largest value
    conditions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: unstated keys of ``campaign.toml`` that matter for these runs, with values assumed
    assumed: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit(Result):
    """Both wheels' laws, with all that reports and exports need."""

    name: str
    simulated: bool  #: true where a program made the data
    left: WheelFit
    right: WheelFit
    radii: EffectiveRadii
    #: by wheel, where measured
    static: Mapping[str, WheelFit] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  #: what the user should know, in sentences
    #: ``version`` of calib, ``inputs`` (path -> sha256), ``arguments``; filled by the command line
    provenance: Mapping[str, Any] = field(default_factory=dict)
    #: vehicle, instruments and conditions; None where the radii came from elsewhere than a campaign
    setup: Setup | None = None
    accepted: str = ""  #: the user's reason to use a law that failed the check ``plausible``; empty: it is refused

    @property
    def law(self) -> RadiusLaw:
        """The law of both wheels."""
        return paired_law(self.left, self.right, groups_of(self.radii.session))

    @property
    def wheels(self) -> dict[str, WheelFit]:
        """The moving wheels by name."""
        return {"left": self.left, "right": self.right}

    @property
    def failed_checks(self) -> list[tuple[str, Check]]:
        """The checks that failed, each with its wheel."""
        return [(name, check) for name, wheel in self.wheels.items() for check in wheel.checks if not check.passed]

    @property
    def failed(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(f"{name} wheel, {check.name.replace('_', ' ')}" for name, check in self.failed_checks)

    @property
    def passed(self) -> bool:
        """Whether every check lets the law be used."""
        return not self.failed

    @property
    def verdict(self) -> str:
        """``fitted``; ``doubtful`` where a check fails; ``wrong`` beyond the bounds of a vehicle."""
        return "wrong" if self.implausible else "fitted" if self.passed else "doubtful"

    @property
    def implausible(self) -> tuple[str, ...]:
        """Findings beyond the bounds of a vehicle; the user has to accept such a law."""
        return tuple(dict.fromkeys(check.sentence for _, check in self.failed_checks if check.name == PLAUSIBLE))

    @property
    def table(self) -> "DataFrame":
        """The runs used: labels, loads, radii, standard uncertainties, residuals; SI units."""
        from pandas import DataFrame

        return DataFrame(_rows(self))

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as plain values, as ``calib fit --json``."""
        document: dict[str, object] = {"format": FORMAT, "campaign": self.name, "wheels": self.wheels}
        document |= {"runs": _rows(self), "budget": self.radii.budget, "left_out": self.radii.left_out}
        written = plain(document | {name: getattr(self, name) for name in _WRITTEN})
        return {**written, CHECKSUM_KEY: checksum(written)}

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> "Fit":
        """Return the fit that `to_dict` wrote.

        Raises BadInputError where a key is missing or of the wrong kind.
        """
        try:
            notes, name, simulated = tuple(value["notes"]), str(value["campaign"]), bool(value["simulated"])
            left, right = (WheelFit.from_dict(side, value["wheels"][side]) for side in SIDES)
            budget = from_plain(tuple[Component, ...], value["budget"])
            left_out = from_plain(tuple[UnusedRun, ...], value["left_out"])
            radii = EffectiveRadii(**_columns(value["runs"]), budget=budget, left_out=left_out, notes=notes)
            static = {side: WheelFit.from_dict(side, wheel) for side, wheel in value["static"].items()}
            setup = None if value.get("setup") is None else from_plain(Setup, value["setup"])
            fit = Fit(name, simulated, left, right, radii, static, notes, dict(value["provenance"]), setup)
            for side, wheel in fit.wheels.items():
                lengths = {len(getattr(wheel, column)) for column in RUN_ARRAYS}
                if lengths != {len(radii)}:
                    raise ValueError(f"{len(radii)} runs are listed, and the {side} wheel was fitted on {lengths}")
            return fit
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            text = f"the fit is damaged ({type(error).__name__}: {' '.join(str(error).split())})"
            raise BadInputError(f"{text}; expected what 'calib fit' wrote; make it anew") from error


def _rows(fit: Fit) -> list[Row]:
    columns = {name: getattr(fit.radii, name) for name in _RUN_COLUMNS}
    columns |= {f"residual_{name}_m": wheel.residual_m for name, wheel in fit.wheels.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*map(plain, columns.values()), strict=True)]


def _columns(rows: Any) -> dict[str, Any]:
    types = {name: np.str_ if name in _TEXTS else np.float64 for name in _RUN_COLUMNS}
    return {name: np.array([row[name] for row in rows], dtype=kind) for name, kind in types.items()}


def provenance(campaign: Campaign, arguments: Mapping[str, object]) -> Mapping[str, object]:
    """Return version, arguments, SHA-256 of every file read, and what the campaign states."""
    inputs = dict(sorted(campaign.hashes.items()))
    record: dict[str, object] = {"version": VERSION, "arguments": dict(arguments), "inputs": inputs}
    for section in STATED_SECTIONS:
        if section in campaign.extra:
            record[section] = json.loads(json.dumps(campaign.extra[section], default=str))
    if notes := ingest_notes(campaign):
        record["ingest"] = notes
    return record


def ingest_notes(campaign: Campaign) -> list[list[str]]:
    """Return what the import of a campaign noted, (where, text); empty for one not imported."""
    file = None if campaign.root is None else campaign.root / "ingest.json"
    if file is None or not file.is_file():
        return []
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        return [[str(note["where"]), str(note["text"])] for note in document.get("summary", document["notes"])]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadFileError(file, f"{type(error).__name__}", "what calib ingest wrote", "remove it") from error


def write_result(fit: Fit, folder: Path, *, force: bool = False) -> Path:
    """Write a result folder, made where missing: ``fit.json``, which is returned, and ``runs.csv`` for other programs.

    Raises BadInputError where it holds a result and `force` is False, or cannot be written.
    """
    document = fit.to_dict()
    text = csv_text(list(document["runs"][0]), (row.values() for row in document["runs"]))
    files = {RUNS_FILE: text.encode("utf-8", "backslashreplace"), FIT_FILE: to_json(document).encode("utf-8")}
    write_files(folder, files, force=force)
    return folder / FIT_FILE


def _check_seal(file: Path, value: Mapping[str, Any]) -> None:
    stated = value.get(CHECKSUM_KEY)
    try:
        computed = checksum({key: part for key, part in value.items() if key not in _ADDED})
    except (ValueError, OverflowError, RecursionError) as error:
        raise BadFileError(file, found=f"a number that is none ({error})", expected="a fit", remedy=REMEDY) from error
    if stated != computed:
        expected = f"{computed}, which its content has; the file was changed, or made by an older version"
        actual = "no checksum" if stated is None else f"{str(stated)[:80]!r}"
        raise BadFileError(file, actual, expected, REMEDY, column=CHECKSUM_KEY)


def is_result(path: Path) -> bool:
    """Return whether `path` is a result folder or ``fit.json``."""
    return (path / FIT_FILE).is_file() if path.is_dir() else path.suffix == ".json" and path.is_file()


def read_result(path: Path) -> Fit:
    """Read a fit from a result folder or from its ``fit.json``.

    Raises BadFileError where the file is missing, no JSON, no fit, or changed since it was written.
    """
    if path.is_dir():
        settle(path)
    file = path / FIT_FILE if path.is_dir() else path
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        actual = str(error.strerror) if isinstance(error, OSError) else f"no JSON ({error})"
        raise BadFileError(file, actual, "a fit", REMEDY) from error
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        actual = f"the format {value.get('format')!r}" if isinstance(value, dict) else f"a JSON {type(value).__name__}"
        raise BadFileError(file, found=actual, expected="a fit", remedy=REMEDY)
    _check_seal(file, value)
    try:
        return Fit.from_dict(value)
    except CalibError as error:
        raise BadFileError(file, found=str(error), expected="a fit", remedy=REMEDY) from error


@dataclass(frozen=True, slots=True)
class Difference:
    """A coefficient of one wheel, fitted minus that of a model."""

    wheel: str
    #: ``radius_ref`` in m, or ``slope`` in m/N
    quantity: str
    fitted: float
    model: float
    #: of its 95 % interval
    half_width: float

    @property
    def difference(self) -> float:
        """Fitted minus model."""
        return self.fitted - self.model

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of the difference."""
        return self.difference - self.half_width, self.difference + self.half_width

    @property
    def inside(self) -> bool:
        """Whether zero lies within the interval."""
        return abs(self.difference) <= self.half_width


@dataclass(frozen=True, slots=True)
class ModelComparison:
    """Both wheels' fitted laws against a model's."""

    reference_load_N: float
    differences: tuple[Difference, ...]
    #: the model has no covariance: its values count as exact
    exact: bool = False

    @property
    def inside(self) -> bool:
        """Whether the model lies within every interval."""
        return all(one.inside for one in self.differences)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values: the key ``model_comparison`` of ``calib fit --model --json``."""
        wheels: dict[str, dict[str, object]] = {side: {"radius_ref": None, "slope": None} for side in SIDES}
        for one in self.differences:
            unit = "m" if one.quantity == "radius_ref" else "m_per_N"
            names = {"fitted": "fitted", "model": "model", "difference": "difference", "difference_ci95": "ci95"}
            document = {f"{key}_{unit}": plain(getattr(one, name)) for key, name in names.items()}
            wheels[one.wheel][one.quantity] = document | {"model_inside": one.inside}
        verdict = {"model_inside": self.inside, "model_exact": self.exact}
        return {"reference_load_N": self.reference_load_N, **verdict, "wheels": wheels}


def compare_laws(left: WheelFit, right: WheelFit, model: RadiusLaw) -> ModelComparison:
    """Return fitted laws minus a model of other runs, at the fit's reference load.

    The intervals are those of the difference of two Student variates (Behrens and Fisher).
    """
    differences = []
    for wheel, law in ((left, model.left), (right, model.right)):
        laws, load = (wheel.law, law), wheel.reference_load_N
        quantities = {"radius_ref": [one.contrast(load) for one in laws]}
        if wheel.model == "line":
            quantities["slope"] = [np.array([0.0, 1.0])] * 2
        for quantity, contrasts in quantities.items():
            pairs = list(zip(laws, contrasts, strict=True))
            fitted, believed = (float(c @ [one.radius_ref_m, one.slope_m_per_N]) for one, c in pairs)
            dof = [float(one.dof_of(c)) or LARGEST_DOF for one, c in pairs]
            half = half_width(np.array([float(one.std_of(c)) for one, c in pairs]), dof)
            differences.append(Difference(wheel.wheel, quantity, fitted, believed, half))
    exact = not any(one.covariance.any() for one in (model.left, model.right))
    return ModelComparison(left.reference_load_N, tuple(differences), exact)
