"""The coefficient file of a fitted law or a geometry."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np
from numpy.typing import ArrayLike

from calib import __version__
from calib.campaign.model import Campaign
from calib.campaign.settings import Encoder
from calib.campaign.wheels import SOURCE_NAMES, without_rear_wheels
from calib.coefficients import file as kept
from calib.coefficients import formats, sections
from calib.coefficients.file import CoefficientFile, GeometrySection, Outside, load_coefficients
from calib.coefficients.formats import RADII_ONLY, WITH_NOISE, Artifact, ExportOptions, assumed_note
from calib.coefficients.sections import VehicleSection, WheelSection, WheelsSection
from calib.errors import BadFileError, BadInputError, CalibError, ImplausibleError, RefusedError, refuse_other_than_date
from calib.radius.law import JOINT, RadiusLaw, WheelLaw
from calib.radius.regression import SAME_LOAD
from calib.radius.result import Fit, is_result, read_result
from calib.types import GRAVITY_MPS2
from calib.vehicle import Vehicle

if TYPE_CHECKING:
    from calib.kinematics.result import Geometry

# a corridor does not measure these; the file states each
TRACK_STD_M: Final = 1e-3
ALONG_M_PER_SQRT_M: Final = 5e-4
HEADING_RAD_PER_SQRT_M: Final = 5e-4
COUNT_STD: Final = 1.0 / math.sqrt(12.0)  # a reading is uniform within one count
# valid range beyond measured loads, by their span, and least: weighing scatters by newtons
LOAD_MARGIN: Final = 0.01
MIN_LOAD_MARGIN_N: Final = 1.0
MAX_STEP_M: Final = 0.5
MAX_GAP_S: Final = 1.0
LOAD_TABLE_LINES: Final = 64
#: a load weighed a hundred times scatters over five standard deviations
LOAD_SCATTER: Final = 4.0
#: standard deviation of the relative slope where no loads were driven: 1 % per kN
SLOPE_STD_PER_N: Final = 1e-5
#: relative standard deviation of a length that was not measured
NOMINAL_STD: Final = 0.01
#: source of the odometry -> radius of both rear wheels; none by a front wheel
WHEEL_RADIUS: Final = {"wheels": "wheel_radius_m", "front": "", "shaft": "rear_radius_m"}


def from_fit(
    fit: Fit, *, outside: Outside = "refuse", created: str | None = None, inputs: Mapping[str, str] | None = None
) -> CoefficientFile:
    """Return the coefficient file of a fit: its laws, vehicle, encoder and load points.

    `outside`, `created`: see `Header`; `inputs`: path of an input -> its SHA-256; None: by the fit's provenance. Raises
    BadInputError where the fit lacks vehicle or encoder, or is damaged; ImplausibleError where it is not accepted.
    """
    if fit.implausible and not fit.accepted:
        raise ImplausibleError(fit.name, fit.implausible)
    hashes = fit.provenance.get("inputs", {}) if inputs is None else inputs
    if fit.setup is None or not isinstance(hashes, Mapping):
        fault = f"fit of {fit.name!r}: found no vehicle, encoder and input hashes; expected those of its campaign"
        raise BadInputError(f"{fault}; make it anew with 'calib fit CAMPAIGN --into FOLDER'")
    try:
        header = Header(fit.name, fit.simulated, outside, created, hashes)
        loads = load_points(fit.radii.load_left_N, fit.radii.load_right_N)
        law, vehicle = fit.law, fit.setup.vehicle
        file = from_law(law, vehicle, fit.setup.encoder, header, load_table=loads)
        values = (value for one in (law.left, law.right) for value in (one.radius_ref_m, one.slope_m_per_N))
        parts = dict(zip(JOINT[:4], values, strict=True))
        law_m2 = law.covariance()[:4, :4]
        together = GeometrySection.of_together(vehicle.drive, "rear", parts, [*parts], law_m2, law.run_covariance_m2)
        unweighed = [f"wheels.{one}.reference_load" for one in fit.wheels if f"load_{one}_N" in fit.setup.assumed]
        file = file.changed(joint_geometry=together, assumed=[*file.assumed, *unweighed])
    except (TypeError, OverflowError) as error:
        fault = f"fit of {fit.name!r}: found a value that is no number ({error}); expected those of a fit"
        raise BadInputError(f"{fault}; make it anew with 'calib fit CAMPAIGN --into FOLDER'") from error
    if failed := [f"{name} wheel, {check.name}: {check.sentence}" for name, check in fit.failed_checks]:
        file = file.changed(failed_checks=failed)
    return file.accepted(fit.accepted, fit.implausible)


def load_points(load_left_N: ArrayLike, load_right_N: ArrayLike) -> dict[str, tuple[float, float]]:
    """Return the load points of runs: name -> mean wheel loads left and right in N.

    A wheel's loads within `SAME_LOAD` of the lowest are one, weighed several times; beyond `LOAD_SCATTER` times that,
    those equal to a newton. Empty beyond `LOAD_TABLE_LINES`: none is meant.
    """
    pairs = np.column_stack([load_left_N, load_right_N])
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    if not len(pairs):
        return {}
    near_N, groups = max(1.0, SAME_LOAD * pairs.min()), np.round(pairs)
    for load, group in zip(pairs.T, groups.T, strict=True):
        stretches = np.split(np.sort(load), np.flatnonzero(np.diff(np.sort(load)) > near_N) + 1)
        if max(map(np.ptp, stretches)) <= LOAD_SCATTER * near_N:
            group[:] = np.searchsorted([stretch[0] for stretch in stretches], load, side="right")
    keys, point = np.unique(groups, axis=0, return_inverse=True)
    if len(keys) > LOAD_TABLE_LINES:
        return {}
    means = [pairs[point.ravel() == at].mean(axis=0).tolist() for at in range(len(keys))]
    return {f"L{left:.0f} R{right:.0f}": (left, right) for left, right in means}


@dataclass(frozen=True, slots=True)
class Header:
    """Name, origin and date of a coefficient file, and its rule outside the valid range."""

    name: str
    #: whether a program made the measurements
    simulated: bool
    #: for a load that was not measured: ``refuse`` or ``clamp``
    outside: Outside = "refuse"
    created: str | None = None  #: YYYY-MM-DD
    #: path of an input -> its SHA-256
    inputs: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Standard uncertainty of the track, and random walk of distance and heading per square root of metre."""

    track_std_m: float = TRACK_STD_M
    along_m_per_sqrt_m: float = ALONG_M_PER_SQRT_M
    heading_rad_per_sqrt_m: float = HEADING_RAD_PER_SQRT_M
    #: fields of the file that these runs do not tell
    assumed: Sequence[str] = ("noise.along", "noise.heading")


def from_law(
    law: RadiusLaw,
    vehicle: Vehicle,
    encoder: Encoder,
    header: Header,
    *,
    load_table: Mapping[str, tuple[float, float]] | None = None,
    effects: Iterable[sections.EffectSection] = (),
    load_margin_N: float | None = None,
    noise: PoseNoise = PoseNoise(),
) -> CoefficientFile:
    """Return the coefficient file of a law, a vehicle and an encoder; see `from_fit`.

    `load_table`: see `load_points`, without lines outside the valid range; `load_margin_N`: its reach beyond measured
    loads; None: by `LOAD_MARGIN`.
    """
    wheels = WheelsSection(left=_wheel(law.left, load_margin_N), right=_wheel(law.right, load_margin_N))
    return kept.sealed(
        format=kept.FORMAT,
        calib_version=__version__,
        name=header.name,
        created=header.created,
        simulated=bool(header.simulated),
        outside=header.outside,
        wheels=wheels,
        vehicle=VehicleSection.of(vehicle, track_std=noise.track_std_m, gravity=GRAVITY_MPS2),
        encoder=kept.EncoderSection.of(encoder),
        noise=sections.NoiseSection.of(noise, count_std=COUNT_STD),
        limits=sections.LimitsSection.of(max_step=_max_step_m(law, encoder), max_gap=MAX_GAP_S),
        load_table=[
            sections.LoadPoint.of(name=name, load_left=left, load_right=right)
            for name, (left, right) in (load_table or {}).items()
            if left in wheels.left.valid_load and right in wheels.right.valid_load
        ],
        effects=list(effects),
        assumed=[*(["vehicle.track_std"] if noise == PoseNoise() else []), *noise.assumed],
        inputs=[{"path": path, "sha256": digest} for path, digest in sorted(header.inputs.items())],
    )


def _max_step_m(law: RadiusLaw, encoder: Encoder) -> float:
    if encoder.wrap_bits is None:
        return MAX_STEP_M
    left, right = law.left.radius_ref_m, law.right.radius_ref_m
    per_count_m = min(left / encoder.counts_per_rev_left, right / encoder.counts_per_rev_right)
    return min(MAX_STEP_M, 0.25 * 2.0**encoder.wrap_bits * 2.0 * math.pi * per_count_m)


def _wheel(law: WheelLaw, load_margin_N: float | None) -> WheelSection:
    span = law.load_max_N - law.load_min_N
    margin = max(LOAD_MARGIN * span, MIN_LOAD_MARGIN_N) if load_margin_N is None else load_margin_N
    return WheelSection.of(
        law,
        **sections.variances(law.covariance),
        strata=None if law.strata is None else sections.StrataSection.of_estimate(law.strata),
        # outwards to whole millinewtons: a last bit must not refuse a load
        valid_load=sections.LoadRange.of(
            min=max(math.floor((law.load_min_N - margin) * 1e3) / 1e3, 0.0),
            max=math.ceil((law.load_max_N + margin) * 1e3) / 1e3,
        ),
    )


#: what closed paths leave at its nominal size
HELD: Final = ("wheels.left.radius_ref", "wheels.right.radius_ref", "vehicle.track")


def from_geometry(
    geometry: "Geometry",
    campaign: Campaign,
    *,
    outside: Outside = "refuse",
    created: str | None = None,
    accept: str = "",
) -> CoefficientFile:
    """Return the coefficient file of a campaign's geometry; `outside`, `created`: see `Header`.

    Without loads the slope is 0, uncertain by `SLOPE_STD_PER_N`. Lengths not determined keep their nominal value.
    Raises ImplausibleError where it is doubtful or wrong, without a reason to `accept` it.
    """
    if not geometry.passed and not accept:
        raise ImplausibleError(f"{geometry.name}, geometry {geometry.verdict}", geometry.why)
    vehicle = campaign.vehicle
    left, right = (_law(geometry, campaign, side) for side in ("left", "right"))
    shared = left.radius_ref_m * right.radius_ref_m * float(np.diff(np.square(_scatter(geometry)))[0])
    law = RadiusLaw(left, right, run_covariance_m2=shared)
    track, track_std, assumed = _track(geometry, campaign)
    runs, walks = campaign.included().runs, geometry.noise_expected
    file = from_law(
        law,
        vehicle,
        campaign.encoder,
        Header(geometry.name, geometry.simulated, outside, created, geometry.inputs),
        load_table=load_points(runs.number("load_left_N"), runs.number("load_right_N")),
        noise=PoseNoise(track_std, walks["along_walk"], walks["heading_walk"], assumed),
    )
    names = [estimate.name for estimate in geometry.estimates]
    scatter_m2 = law.run_covariance_m2 if law.scatters else None
    stated = geometry.values, names, geometry.covariance
    together = GeometrySection.of_together(geometry.drive, geometry.source, *stated, scatter_m2)
    wheelbase = geometry.values.get("wheelbase_m", vehicle.wheelbase_m)
    # of ratios alone: these rest on the nominal mean radius
    held = HELD * ("mean_radius_m" in geometry.undetermined)
    file = file.calibrated(track=track, wheelbase=wheelbase)
    file = file.changed(joint_geometry=together, assumed=[*file.assumed, *held])
    return file if geometry.passed else file.accepted(accept, geometry.why)


def geometry_document(geometry: "Geometry", campaign: Campaign, accept: str = "") -> dict[str, object]:
    """Return what ``calib geometry --json`` writes: `from_geometry` is its section, null where it is refused."""
    try:
        section = from_geometry(geometry, campaign, accept=accept).to_dict()
    except CalibError:
        section = None
    return {"format": kept.GEOMETRY_FORMAT, **geometry.to_dict(), "coefficients": section}


def _law(geometry: "Geometry", campaign: Campaign, side: str) -> WheelLaw:
    loads = campaign.included().runs.number(f"load_{side}_N")
    loads = loads[np.isfinite(loads)]
    radius_name, slope_name = WHEEL_RADIUS.get(geometry.source, f"radius_{side}_m"), f"slope_{side}_m_per_N"
    names = [estimate.name for estimate in geometry.estimates]
    radius = geometry.values.get(radius_name, campaign.vehicle.wheel_radius_m)
    covariance = np.diag([(NOMINAL_STD * radius) ** 2, (SLOPE_STD_PER_N * radius) ** 2])
    places = [(row, names.index(name)) for row, name in enumerate((radius_name, slope_name)) if name in names]
    for row, first in places:
        for column, second in places:
            covariance[row, column] = geometry.covariance[first, second]
    driven = slope_name in names
    reference = campaign.model.reference_load_N if driven or not len(loads) else float(loads.mean())
    return WheelLaw(
        reference_load_N=reference,
        radius_ref_m=radius,
        slope_m_per_N=geometry.values.get(slope_name, 0.0),
        covariance=covariance,
        dof=geometry[radius_name].dof if radius_name in names else 0.0,
        residual_std_m=radius * float(np.hypot(*_scatter(geometry))),
        load_min_N=float(loads.min()) if driven else 0.0,
        load_max_N=float(loads.max()) if driven else max(campaign.vehicle.max_wheel_load_N, reference),
        n_runs=geometry.n_runs,
    )


def _scatter(geometry: "Geometry") -> tuple[float, float]:
    # relative: against the mean, and of the mean
    by_name = geometry.noise_expected
    return 0.5 * by_name.get("yaw_scatter", 0.0), by_name.get("radius_scatter", 0.0)


def _track(geometry: "Geometry", campaign: Campaign) -> tuple[float, float, Sequence[str]]:
    name, factor = ("half_length_plus_half_width_m", 2.0) if geometry.source == "wheels" else ("track_m", 1.0)
    track = factor * geometry.values.get(name, campaign.vehicle.track_m)
    if any(estimate.name == name for estimate in geometry.estimates):
        return track, factor * geometry[name].std, ()
    return track, NOMINAL_STD * track, ("vehicle.track_std",)


@dataclass(frozen=True, slots=True)
class Source:
    """Coefficients, with notes on their origin for the user."""

    file: CoefficientFile
    notes: tuple[str, ...] = ()


def coefficients_of(
    path: Path | str, *, outside: str | None = None, created: str | None = None, accept: str = ""
) -> Source:
    """Return the coefficients of a campaign (fitted now), a result of fit or geometry, or a coefficient file.

    Without rear wheels they are the geometry's. `outside`, `created`: see `Header`; None: the file's; `accept`: why an
    implausible law is passed on; empty: refused. Raises BadInputError where one cannot be used; RefusedError where the
    campaign allows no law.
    """
    path = Path(path)
    if outside not in (None, *get_args(Outside)):
        raise BadInputError(f"outside: found {outside!r}; expected refuse or clamp; choose one of them")
    if created is not None:
        refuse_other_than_date(created)
    changes = {key: value for key, value in (("outside", outside), ("created", created)) if value is not None}
    if not path.exists():
        expected = "a campaign folder, a result folder of calib fit, or a coefficient file"
        raise BadFileError(path, "nothing", expected, "give the path of one")
    if (path.is_file() and (path.suffix != ".json" or _is_coefficients(path))) or _is_geometry(path):
        file = load_coefficients(path)
        return Source(file.changed(**changes) if changes else file, _doubts(file))
    if is_result(path):
        return coefficients_from(read_result(path), accept, **changes)
    from calib.campaign.read import read_campaign

    return coefficients_from(read_campaign(path), accept, **changes)


def coefficients_from(subject: Fit | Campaign, accept: str = "", **changes: Any) -> Source:
    """Return the coefficients of a fit or of a campaign, which is fitted now; see `coefficients_of`."""
    from calib.radius.fit import fit_campaign

    if isinstance(subject, Fit):
        fit, inputs = subject, None
    elif without_rear_wheels(subject):
        from calib.kinematics.estimate import estimate_geometry

        geometry = estimate_geometry(subject)
        how = "no rear wheel was counted: radii and lengths are those of 'calib geometry'"
        return Source(from_geometry(geometry, subject, accept=accept, **changes), (*geometry.notes, how))
    else:
        fit, inputs = fit_campaign(subject), subject.hashes
    master = from_fit(replace(fit, accepted=accept), inputs=inputs, **changes)
    return Source(master, _doubts(master))


def _doubts(file: CoefficientFile) -> tuple[str, ...]:
    return tuple(f"a check of the law failed: {failed}" for failed in file.failed_checks)


def _is_coefficients(path: Path) -> bool:
    try:
        document = json.loads(path.read_bytes().decode("utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and document.get("format") in (kept.FORMAT, kept.GEOMETRY_FORMAT)


def _is_geometry(path: Path) -> bool:
    return (path / kept.GEOMETRY_FILE).is_file() and not (is_result(path) or (path / "campaign.toml").is_file())


def export(file: CoefficientFile, to: str, options: ExportOptions = formats.USUAL) -> tuple[Artifact, ...]:
    """Return the files of a coefficient file in another format, of `calib.coefficients.formats.FORMATS`.

    Raises BadInputError for another format or its option; RefusedError where the format cannot hold the file.
    """
    if to not in formats.FORMATS:
        raise BadInputError(f"to: found {to!r}; expected one of {', '.join(formats.FORMATS)}; choose one of them")
    if to != "ros2" and (options.controllers or options.open_loop or not options.position_feedback):
        fault = f"controllers, position feedback and open loop: found a choice of them for {to!r}"
        raise BadInputError(f"{fault}; expected 'ros2', which alone has them; leave them out")
    formats.refuse_loads(options.loads, to)
    if to == "json":
        return (Artifact("coefficients.json", file.to_bytes(), assumed_note(file)),)
    if (options.model is not None or options.left or options.right) and to not in formats.PATCHING:
        fault = f"--into, --left, --right: found them with {to!r}"
        raise BadInputError(f"{fault}; expected mjcf, urdf or sdf; leave them out")
    together = file.joint_geometry
    if to in formats.AXLE_ONLY and together is not None and together.source != "rear":
        wheels = SOURCE_NAMES[together.source]
        fault = f"--to {to}: found odometry from {wheels}; expected two wheels on one axle, which alone this format has"
        raise RefusedError(f"{fault}; export to ros2 or json")
    first, *further = resolve_name(f"{formats.__name__}.{formats.FORMATS[to]}")(file, options)
    notes = kept.effects_left_out(file, f"not in {to}") if to in RADII_ONLY else ()
    notes += assumed_note(file) if to in WITH_NOISE else ()
    return (replace(first, notes=(*first.notes, *notes)), *further)
