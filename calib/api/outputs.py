"""What follows a result: runs to drive next, what a law does, where it goes; `plan`, `simulate` to `export`."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from numpy.random import Generator, default_rng

from calib.api.results import CampaignLike, checked, opened, refuse_below
from calib.campaign.model import Campaign
from calib.errors import BadInputError, CalibError
from calib.gap.decision.diagnosis import Plan
from calib.gap.plan.planned_runs import PlannedRun
from calib.io import write_bytes
from calib.kinematics.assemble import Promise
from calib.kinematics.result import Geometry
from calib.odometry import replay as replays
from calib.odometry import simulation
from calib.odometry.law_path import AxleLaw, law_source
from calib.odometry.replay import Replay
from calib.odometry.simulation import LawJourneys, Simulation
from calib.radius.result import Fit
from calib.types import FloatArray, Progress, silent
from calib.vehicle import Vehicle


@checked
def plan(campaign: CampaignLike, *, most: int = 5, seed: int = 0) -> Plan:
    """Say which runs to drive next, best first, and what each would tell apart.

    Parameters
    ----------
    campaign : Campaign
        What was driven so far.
    most : int
        How many runs to name at most; one driven several times counts once.
    seed : int
        Seed of the diagnosis behind it.

    Returns
    -------
    Plan
        The runs with the reason for each, and the intervals that `geometry` will give.
    """
    refuse_below(0, seed=seed)
    refuse_below(1, most=most)
    return proposed(opened(campaign), most=most, seed=seed)


def proposed(
    campaign: Campaign, *, among: Sequence[PlannedRun] | None = None, most: int, seed: int, progress: Progress = silent
) -> Plan:
    """Return the plan, see `plan`; `among`: runs to choose from, else the usual ones."""
    from calib.gap.decision.confounding import apart_on
    from calib.gap.decision.kind import open_questions
    from calib.gap.diagnose import diagnose_in_full
    from calib.gap.plan.next_runs import next_runs, with_next

    full = diagnose_in_full(campaign, seed=seed, plan=False, progress=progress)
    apart, known = (
        partial(apart_on, full.arrays),
        (campaign, [*full.arrays.effects.values()], full.noise, open_questions(full)),
    )
    runs = next_runs(*known, apart_on=apart, candidates=among, most=most)
    with suppress(CalibError):
        from calib.kinematics.estimate import estimate_geometry

        geometry = estimate_geometry(campaign, progress=progress)
        now, driven = Promise.of(geometry), _as_estimated(campaign, geometry)
        then = promised(with_next(driven, runs), now.scales) if runs else None
        if then and (design := promised(driven, now.scales)):
            then = then.after(now, design)
        return Plan(campaign, full, tuple(runs), now, then)
    return Plan(campaign, full, tuple(runs))


def _as_estimated(campaign: Campaign, geometry: Geometry) -> Campaign:
    names = {field.name for field in fields(campaign.model)}
    known: dict[str, Any] = {one.name: one.value for one in geometry.estimates if one.name in names}
    return replace(campaign, model=replace(campaign.model, **known))


def promised(campaign: Campaign, scales: FloatArray | None = None) -> Promise | None:
    """Return the intervals that the end poses of planned runs promise; None where they determine nothing."""
    from calib.kinematics import assemble

    with suppress(CalibError):
        return assemble.promised(campaign, scales)
    return None


@checked
def simulate(
    study: str = "corrected",
    *,
    law: Fit | Path | str | None = None,
    routes: Sequence[str] = (),
    loads_N: Sequence[tuple[float, float]] = (),
    seed: int = 0,
) -> Simulation:
    """Simulate a vehicle that follows a route on its own odometry, with wrong and with corrected radii.

    Parameters
    ----------
    study : {"symmetric", "asymmetric", "corrected", "custom"}
        The paper's studies, or ``custom`` for the law alone.
    law : Fit, Path or str, optional
        Law for the same journeys, of a fit or a coefficient file, its 95 % band carried to the end pose.
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
    under, track_m = None, Vehicle().track_m
    if law is not None:
        vehicle = law.setup.vehicle if isinstance(law, Fit) and law.setup is not None else Vehicle()
        axle = AxleLaw(law.law, vehicle.track_m) if isinstance(law, Fit) else law_source(Path(law))
        under, track_m = LawJourneys(axle, loads_N), axle.track_m
    return simulation.simulate(study, routes=routes, track_m=track_m, under=under, rng=_generator(seed))


@checked
def replay(campaign: CampaignLike, law: Fit | Geometry | Path | str, *, scheme: str = "exact", seed: int = 0) -> Replay:
    """Replay the logged runs of a campaign through odometry, with and without the load correction.

    Parameters
    ----------
    campaign : Campaign
        Runs with logs, wheel loads and reference end poses.
    law : Fit, Geometry, Path or str
        Law or geometry that corrects, or a coefficient file of either; best of another campaign.
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
        Where no run can be replayed, or the law is of another vehicle.
    """
    from calib.coefficients.build import coefficients_of, from_fit, from_geometry

    campaign = opened(campaign)
    if isinstance(law, Path | str):
        file = coefficients_of(law).file
    else:
        file = from_geometry(law, campaign) if isinstance(law, Geometry) else from_fit(law)
    return replays.replay(campaign, file, rng=_generator(seed), scheme=scheme)


@checked
def report(
    source: CampaignLike | Fit,
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
    source : Campaign, Path, str or Fit
        A campaign is fitted first; runs without a law, as loops, give a report of their geometry.
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
        Where the runs allow neither a law nor a geometry.
    """
    from calib.reporting.content import place_of, report_of
    from calib.reporting.pages import to_pdf
    from calib.reporting.source import issue_date

    subject = source if isinstance(source, Fit) else opened(source)
    seed = 0 if diagnosis else None
    reported = report_of(subject, issued=issue_date(date), accept=accept_implausible, seed=seed)
    return write_bytes(place_of(reported.name, Path(target), force=force), to_pdf(reported), force=force)


@checked
def export(
    source: CampaignLike | Fit | Geometry,
    to: str = "json",
    target: Path | str | None = None,
    *,
    loads: Sequence[float | str] = (),
    controllers: Sequence[str] = (),
    campaign: CampaignLike | None = None,
    outside: Literal["refuse", "clamp"] = "refuse",
    accept_implausible: str = "",
    force: bool = False,
) -> Mapping[str, str]:
    """Return the coefficients as the vehicle needs them; write them to a target, if any.

    Parameters
    ----------
    source : Campaign, Path, str, Fit or Geometry
        A campaign is fitted first; one without rear encoders has the coefficients of its geometry.
    to : {"json", "ros2", "c", "c_effects", "csv"}
        The form; ``json`` is the master that `calib.runtime` reads.
    target : Path or str, optional
        File, or folder where there are several files.
    loads : sequence of float or str
        Load points in N for ``ros2`` and ``csv``: 600 for both wheels or ``"500,700"``.
    controllers : sequence of str
        Names of ROS 2 controllers; none: those of the vehicle's drive.
    campaign : Campaign, Path or str, optional
        What a geometry was estimated from.
    outside : {"refuse", "clamp"}
        For a load that was not measured: ``clamp`` takes the nearest one that was.
    accept_implausible : str
        Why a law beyond the bounds of its vehicle is passed on all the same; written into the file.
    force : bool
        Replace existing files.

    Returns
    -------
    mapping of str to str
        Text of each file by its name.
    """
    from calib.coefficients import build
    from calib.coefficients.formats import ExportOptions, parse_loads, place

    options = ExportOptions(loads=parse_loads([str(load) for load in loads]), controllers=tuple(controllers))
    if isinstance(source, Geometry):
        if campaign is None:
            raise BadInputError("export: found a geometry alone; expected its campaign too; give campaign=...")
        master = build.from_geometry(source, opened(campaign), outside=outside, accept=accept_implausible)
    else:
        subject = source if isinstance(source, Fit) else opened(source)
        master = build.coefficients_from(subject, accept_implausible, outside=outside).file
    artifacts = build.export(master, to, options=options)
    if target is not None:
        place(artifacts, Path(target), force=force)
    return {artifact.name: artifact.data.decode("utf-8") for artifact in artifacts}


def _generator(seed: int) -> Generator:
    refuse_below(0, seed=seed)
    return default_rng(seed)
