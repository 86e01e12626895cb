"""The Python API: one function a stage, each returning a result with `summary`, `to_dict` and `plot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from calib.campaign.model import Campaign
from calib.errors import BadInputError
from calib.gap.decision.diagnosis import Diagnosis, Plan
from calib.kinematics.result import Geometry
from calib.odometry.replay import Replay
from calib.odometry.simulation import Simulation
from calib.radius.result import Fit


def read(folder: Path | str) -> Campaign:
    """Read a campaign.

    Parameters
    ----------
    folder : Path or str
        Holds ``campaign.toml``, ``runs.csv`` and the logs.

    Returns
    -------
    Campaign
        Its runs as a pandas table: ``campaign.frame()``.

    Raises
    ------
    BadFileError
        Where a file cannot be used; says where, what was found and what to do.
    """
    from calib.campaign.read import read_campaign

    return read_campaign(Path(folder))


def fit(campaign: Campaign, *, reference_load_N: float | None = None) -> Fit:
    """Fit the effective radius of each wheel against its load.

    Parameters
    ----------
    campaign : Campaign
        From `read`.
    reference_load_N : float, optional
        Load on which the coefficients are centred; without it the one of the campaign's model.

    Returns
    -------
    Fit
        The laws with intervals, checks and budget; ``fit.table`` has the runs.

    Raises
    ------
    RefusedError
        Where fewer than three runs can be used.
    """
    from calib import __version__
    from calib.radius.fit import fit_campaign
    from calib.radius.result import provenance

    arguments = {} if reference_load_N is None else {"reference_load_N": reference_load_N}
    fitted = fit_campaign(campaign, reference_load_N=reference_load_N)
    return replace(fitted, provenance=provenance(campaign, version=__version__, arguments=arguments))


def geometry(
    campaign: Campaign,
    *,
    using: Literal["end_poses", "windows"] | None = None,
    kinds: Sequence[str] = (),
    leave_out: Literal["session", "kind", "run_id"] | None = None,
) -> Geometry:
    """Estimate radii and track together, with the reference's sensor, from end poses or along the way.

    Parameters
    ----------
    campaign : Campaign
        From `read`.
    using : {"end_poses", "windows"}, optional
        Whole runs, or windows of several lengths along the way; without it what the campaign has.
    kinds : sequence of str
        Kinds of routes to use; none: all.
    leave_out : {"session", "kind", "run_id"}, optional
        Leave each of these out in turn and say the end position errors.

    Returns
    -------
    Geometry
        Values with intervals and joint covariance, what stayed undetermined, residuals by route.

    Raises
    ------
    RefusedError
        Where no run has both wheels and a reference.
    """
    from calib.kinematics.estimate import estimate_geometry, paths_of

    estimated = estimate_geometry(campaign, using=using, kinds=kinds, leave_out=leave_out)
    return replace(estimated, paths=paths_of(campaign, estimated))


def diagnose(
    campaign: Campaign,
    *,
    model: Path | str | None = None,
    exclude: Sequence[str] = (),
    seed: int = 0,
    journeys: Path | str | None = None,
    simulator: Path | str | None = None,
    workers: int = 1,
) -> Diagnosis:
    """Find out where simulated and measured motion differ, and which unmodelled effect causes it.

    Parameters
    ----------
    campaign : Campaign
        From `read`.
    model : Path or str, optional
        Coefficient file that the simulator believes; the campaign's own model without.
    exclude : sequence of str
        Effects to leave out of the library.
    seed : int
        Seed of the bootstraps.
    journeys : Path or str, optional
        A plan of runs still to come, on which the corrections of causes that cannot be told apart are compared.
    simulator : Path or str, optional
        Settings of the user's own simulator, ``SIM.toml``: its command is run, and judged in place of the model.
    workers : int
        Runs of the simulator at once.

    Returns
    -------
    Diagnosis
        Verdict, causes, confounded effects, and the arrays behind them.

    Raises
    ------
    RefusedError
        Where no run has both counts and something measured.
    """
    from calib.gap.diagnose import diagnose_in_full
    from calib.gap.effects.applied import model_of
    from calib.gap.effects.library import check_excluded
    from calib.gap.observations.from_campaign import observations_of
    from calib.gap.plan.plan_file import read_plan

    if simulator is not None:
        return _diagnose_simulator(campaign, Path(simulator), model or journeys, exclude, seed, workers)
    if exclude:
        check_excluded(exclude, observations_of(campaign), campaign.extra.get("effects", ()))
    believed, effects = (None, ()) if model is None else model_of(Path(model), campaign)
    to_come = None if journeys is None else read_plan(Path(journeys))
    return diagnose_in_full(
        campaign, seed=seed, exclude=tuple(exclude), model=believed, applied=effects, journeys=to_come
    )


def _diagnose_simulator(
    campaign: Campaign,
    simulator: Path,
    beside: Path | str | None,
    exclude: Sequence[str],
    seed: int,
    workers: int,
) -> Diagnosis:
    """Diagnose the user's own simulator; options of calib's own model are refused beside it."""
    from calib.gap.simulator.diagnose import diagnose_simulator
    from calib.gap.simulator.settings import read_settings

    if beside is not None:
        raise BadInputError(f"found {beside} beside a simulator, which is judged instead of a model; give one of them")
    settings = read_settings(simulator)
    return diagnose_simulator(campaign, settings, seed=seed, exclude=tuple(exclude), workers=workers).diagnosis


def plan(campaign: Campaign, *, most: int = 5, seed: int = 0) -> Plan:
    """Say which runs to drive next, best first, and what each would tell apart.

    Parameters
    ----------
    campaign : Campaign
        What was driven so far.
    most : int
        How many runs to name.
    seed : int
        Seed of the diagnosis behind it.

    Returns
    -------
    Plan
        The runs with the reason for each.
    """
    from calib.gap.diagnose import diagnose_in_full
    from calib.gap.plan.next_runs import next_runs

    full = diagnose_in_full(campaign, seed=seed, plan=False)
    ties = [group.effects for group in full.groups]
    runs = next_runs(campaign, full.effects, full.noise, ties, full.fitted, most=most)
    return Plan(campaign=campaign, diagnosis=full, runs=tuple(runs))


def simulate(
    study: str = "corrected",
    *,
    law: Fit | None = None,
    routes: Sequence[str] = (),
    loads_N: Sequence[tuple[float, float]] = (),
    seed: int = 0,
) -> Simulation:
    """Simulate a vehicle that follows a route on its own odometry, with wrong and with corrected radii.

    Parameters
    ----------
    study : {"symmetric", "asymmetric", "corrected", "custom"}
        The paper's studies, or ``custom`` for the law alone.
    law : Fit, optional
        Drive the same journeys under this law, its 95 % band carried to the end pose.
    routes : sequence of str
        Names of routes or route files in place of the study's own.
    loads_N : sequence of (float, float)
        Wheel loads (left, right) of the journeys under the law, in N.
    seed : int
        Seed of the Monte Carlo.

    Returns
    -------
    Simulation
        ``simulation.table`` has the end of every drive.

    Raises
    ------
    BadInputError
        Where the study or a route is not known.
    """
    from numpy.random import default_rng

    from calib.odometry.law_path import AxleLaw
    from calib.odometry.simulation import LawJourneys
    from calib.odometry.simulation import simulate as run
    from calib.vehicle import Vehicle

    vehicle = Vehicle() if law is None or law.setup is None else law.setup.vehicle
    simulation = run(
        study,
        routes=routes,
        track_m=vehicle.track_m,
        under=None if law is None else LawJourneys(AxleLaw(law.law, vehicle.track_m), loads_N),
        rng=default_rng(seed),
    )
    return simulation


def replay(campaign: Campaign, law: Fit | Geometry, *, scheme: str = "exact", seed: int = 0) -> Replay:
    """Replay the logged runs of a campaign through odometry, with and without the load correction.

    Parameters
    ----------
    campaign : Campaign
        Runs with logs, wheel loads and reference end poses.
    law : Fit or Geometry
        The law that corrects, or the geometry; best of a campaign other than this one.
    scheme : {"exact", "mid_point", "euler", "end_point"}
        How a step is drawn.
    seed : int
        Seed of the bootstrap.

    Returns
    -------
    Replay
        End errors by run and odometry.

    Raises
    ------
    RefusedError
        Where no run can be replayed.
    """
    from numpy.random import default_rng

    from calib.coefficients.build import from_fit, from_geometry
    from calib.odometry.replay import replay as run

    file = from_geometry(law, campaign) if isinstance(law, Geometry) else from_fit(law)
    return run(campaign, file, rng=default_rng(seed), scheme=scheme)


def report(
    source: Campaign | Fit,
    target: Path | str,
    *,
    date: str | None = None,
    diagnosis: bool = False,
    accept_implausible: str = "",
    force: bool = False,
) -> Path:
    """Write the report on a campaign or on its fit as PDF.

    Parameters
    ----------
    source : Campaign or Fit
        A campaign is fitted first.
    target : Path or str
        The PDF, or a folder for it.
    date : str, optional
        Date of issue as YYYY-MM-DD, which fixes the bytes of the PDF; without it today.
    diagnosis : bool
        Add the diagnosis of the gap; needs the campaign.
    accept_implausible : str
        Why a law beyond the bounds of its vehicle is passed on all the same; written into the file.
    force : bool
        Replace an existing file.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    BadInputError
        Where the file exists and `force` is False.
    RefusedError
        Where the runs allow no law.
    """
    from calib.gap.diagnose import diagnose_in_full
    from calib.io import write_bytes
    from calib.reporting.content import compose, place_of
    from calib.reporting.pdf import to_pdf
    from calib.reporting.source import from_campaign, issue_date, source_of_fit

    issued = issue_date(date)
    if isinstance(source, Campaign):
        content = from_campaign(source, issued=issued, accept=accept_implausible)
        if diagnosis:
            content = content.with_diagnosis(diagnose_in_full(source))
    elif diagnosis:
        raise BadInputError("report: found a fit; expected a campaign, which a diagnosis needs; give the campaign")
    else:
        content = source_of_fit(replace(source, accepted=accept_implausible), issued=issued)
    path = place_of(content.fit.name, Path(target), force=force)
    return write_bytes(path, to_pdf(compose(content)), force=force)


def export(
    source: Campaign | Fit,
    to: str = "json",
    target: Path | str | None = None,
    *,
    loads: Sequence[str] = (),
    controllers: Sequence[str] = (),
    accept_implausible: str = "",
    force: bool = False,
) -> Mapping[str, str]:
    """Return the coefficients as the vehicle needs them, and write them where a target is given.

    Parameters
    ----------
    source : Campaign or Fit
        A campaign is fitted first; one without rear encoders has the coefficients of its geometry.
    to : {"json", "ros2", "c", "csv"}
        The form; ``json`` is the master that `calib.runtime` reads.
    target : Path or str, optional
        File, or folder where there are several files.
    loads : sequence of str
        Load points in N for ``ros2`` and ``csv``: ``"600"`` for both wheels or ``"500,700"``.
    controllers : sequence of str
        Names of ROS 2 controllers; none: those of the vehicle's drive.
    accept_implausible : str
        Why a law beyond the bounds of its vehicle is passed on all the same; written into the file.
    force : bool
        Replace existing files.

    Returns
    -------
    mapping of str to str
        Text of each file by its name.
    """
    from calib.campaign.wheels import without_rear_wheels
    from calib.coefficients.build import from_fit, from_geometry
    from calib.coefficients.export import export as rendered
    from calib.coefficients.export import parse_loads, place
    from calib.coefficients.formats import ExportOptions

    options = ExportOptions(loads=parse_loads(loads), controllers=tuple(controllers))
    if isinstance(source, Campaign) and without_rear_wheels(source):
        master = from_geometry(geometry(source), source)
    else:
        law = fit(source) if isinstance(source, Campaign) else source
        master = from_fit(replace(law, accepted=accept_implausible))
    artifacts = rendered(master, to, options=options)
    if target is not None:
        place(artifacts, Path(target), force=force)
    return {artifact.name: artifact.data.decode("utf-8") for artifact in artifacts}
