"""From a campaign, a folder or a file to results: `read`, `fit`, `geometry`, `diagnose`, `plan`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from calib import __version__
from calib.api.arguments import checked
from calib.campaign.ingest import describe as descriptions
from calib.campaign.ingest.describe import Description
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign, read_or_ingest
from calib.errors import BadInputError, CalibError
from calib.gap.decision.diagnosis import Diagnosis, Plan
from calib.gap.effects.library import check_excluded
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan.planned_runs import PlannedRun
from calib.kinematics.result import Geometry
from calib.radius.result import Fit, provenance
from calib.types import FloatArray, Progress, silent

if TYPE_CHECKING:
    from calib.kinematics.assemble import Promise

#: a campaign, or the folder or recording that it is read from
CampaignLike = Campaign | Path | str


def opened(campaign: CampaignLike) -> Campaign:
    """Return a campaign, read where a place is given."""
    return campaign if isinstance(campaign, Campaign) else read(campaign)


def refuse_below(least: int, **given: int) -> None:
    """Raise BadInputError for an argument below `least`."""
    for name, value in given.items():
        if value < least:
            raise BadInputError(f"{name}: found {value}; expected a whole number from {least} on; give one")


@checked
def read(source: Path | str, *, mapping: Path | str | None = None) -> Campaign:
    """Read a campaign folder, or a recording or table on the way.

    Parameters
    ----------
    source : Path or str
        A folder with ``campaign.toml``, ``runs.csv`` and the logs; or a bag, MCAP file or table, as `ingest` takes it.
    mapping : Path or str, optional
        TOML file that names the columns of a recording or table.

    Returns
    -------
    Campaign
        Its runs as a pandas table: ``campaign.frame()``; a run's log: ``campaign.log("r001")``.

    Raises
    ------
    BadFileError
        Where a file cannot be used; says where, what was found and what to do.
    """
    return read_or_ingest(Path(source), mapping=None if mapping is None else Path(mapping))


@checked
def describe(sources: Sequence[Path | str] | Path | str) -> Description:
    """Say what is in files of any laboratory, and propose a mapping of their columns.

    Parameters
    ----------
    sources : Path or str, or a sequence of them
        Tables, logs and recordings, or folders of them.

    Returns
    -------
    Description
        ``to_toml()`` is the proposed mapping, which `ingest` takes once it is edited and written.

    Raises
    ------
    BadInputError
        Where a source cannot be read.
    """
    return descriptions.describe(_paths(sources))


@checked
def ingest(
    sources: Sequence[Path | str] | Path | str,
    into: Path | str,
    *,
    mapping: Path | str | None = None,
    force: bool = False,
) -> Campaign:
    """Make a campaign folder out of files of any laboratory, and read it.

    Parameters
    ----------
    sources : Path or str, or a sequence of them
        The run table first, where there is one; then logs or recordings, or folders of them. They are only read.
    into : Path or str
        The campaign folder to make.
    mapping : Path or str, optional
        TOML file that names the columns; `describe` proposes one.
    force : bool
        Replace an existing campaign.

    Returns
    -------
    Campaign
        With what was done to the data in ``notes``.

    Raises
    ------
    BadInputError
        Where a source cannot be used, the mapping names a column that is not there, or the target exists.
    """
    from calib.campaign.ingest.build import ingest as ingested

    named = None if mapping is None else Path(mapping)
    made = ingested(_paths(sources), Path(into), mapping=named, force=force)
    return replace(read_campaign(made.folder), notes=made.notes)


def _paths(sources: Sequence[Path | str] | Path | str) -> list[Path]:
    return [Path(source) for source in ([sources] if isinstance(sources, Path | str) else sources)]


@checked
def fit(campaign: CampaignLike, *, reference_load_N: float | None = None) -> Fit:
    """Fit the effective radius of each wheel against its load.

    Parameters
    ----------
    campaign : Campaign, Path or str
        From `read`, or what it reads.
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
    from calib.radius.fit import fit_campaign

    arguments = {} if reference_load_N is None else {"reference_load_N": reference_load_N}
    campaign = opened(campaign)
    fitted = fit_campaign(campaign, reference_load_N=reference_load_N)
    return replace(fitted, provenance=provenance(campaign, version=__version__, arguments=arguments))


@checked
def geometry(
    campaign: CampaignLike,
    *,
    using: Literal["end_poses", "windows"] | None = None,
    kinds: Sequence[str] = (),
    leave_out: Literal["session", "kind", "run_id"] | None = None,
) -> Geometry:
    """Estimate radii and track together, with the reference's sensor, from end poses or along the way.

    Parameters
    ----------
    campaign : Campaign, Path or str
        From `read`, or what it reads.
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
    from calib.campaign.check import assumed_notes
    from calib.kinematics.assemble import traces_of
    from calib.kinematics.estimate import estimate_geometry

    campaign = opened(campaign)
    estimated = estimate_geometry(campaign, using=using, kinds=kinds, leave_out=leave_out)
    notes = (*estimated.notes, *assumed_notes(campaign))
    return replace(estimated, notes=notes, paths=traces_of(campaign, estimated))


@checked
def diagnose(
    campaign: CampaignLike,
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
    campaign : Campaign, Path or str
        From `read`, or what it reads.
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
    from calib.gap.diagnose import diagnosed

    refuse_below(0, seed=seed)
    refuse_below(1, workers=workers)
    campaign = opened(campaign)
    if simulator is not None:
        from calib.gap.simulator.diagnose import diagnose_simulator
        from calib.gap.simulator.settings import read_settings

        if (beside := model or journeys) is not None:
            raise BadInputError(
                f"found {beside} beside a simulator, which is judged instead of a model; give one of them"
            )
        settings = read_settings(Path(simulator))
        return diagnose_simulator(campaign, settings, seed=seed, exclude=tuple(exclude), workers=workers).diagnosis
    if exclude:
        check_excluded(exclude, observations_of(campaign), campaign.extra.get("effects", ()))
    return diagnosed(campaign, model, exclude, seed, journeys)[0]


@checked
def plan(campaign: CampaignLike, *, most: int = 5, seed: int = 0) -> Plan:
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
        The runs with the reason for each, and the intervals that `geometry` will give.
    """
    refuse_below(0, seed=seed)
    refuse_below(1, most=most)
    return proposed(opened(campaign), most=most, seed=seed)


def proposed(
    campaign: Campaign, *, among: Sequence[PlannedRun] | None = None, most: int, seed: int, progress: Progress = silent
) -> Plan:
    """Return the plan, see `plan`; `among`: runs to choose from, else the usual ones."""
    from calib.gap.decision.kind import open_questions
    from calib.gap.diagnose import diagnose_in_full
    from calib.gap.plan.next_runs import next_runs, with_next

    full = diagnose_in_full(campaign, seed=seed, plan=False, progress=progress)
    ties = open_questions(full)
    runs = next_runs(campaign, full.effects, full.noise, ties, full.fitted, candidates=among, most=most)
    with suppress(CalibError):
        from calib.kinematics.assemble import Promise
        from calib.kinematics.estimate import estimate_geometry

        found = estimate_geometry(campaign, progress=progress)
        now = Promise.of(found)
        then = promised(with_next(_as_found(campaign, found), runs), now.scales) if runs else None
        return Plan(campaign, full, tuple(runs), now, then)
    return Plan(campaign, full, tuple(runs))


def _as_found(campaign: Campaign, found: Geometry) -> Campaign:
    names = {field.name for field in fields(campaign.model)}
    known: dict[str, Any] = {one.name: one.value for one in found.estimates if one.name in names}
    return replace(campaign, model=replace(campaign.model, **known))


def promised(campaign: Campaign, scales: FloatArray | None = None) -> Promise | None:
    """Return the intervals that the end poses of planned runs promise; None where they determine nothing."""
    from calib.kinematics import assemble

    with suppress(CalibError):
        return assemble.promised(campaign, scales)
    return None
