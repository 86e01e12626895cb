"""From a campaign, a folder or a file to results: `read`, `fit`, `geometry`, `diagnose`.

Arguments are held against their annotations: what cannot be used is a `BadInputError`.
"""

import inspect
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import wraps
from os import PathLike, fspath
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from calib.campaign.ingest import describe as descriptions
from calib.campaign.ingest.describe import Description
from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign, read_or_ingest
from calib.errors import BadInputError, refused_place
from calib.gap.decision.diagnosis import Diagnosis
from calib.gap.effects.library import check_excluded
from calib.gap.observations.from_campaign import observations_of
from calib.kinematics.result import Geometry
from calib.radius.result import Fit, provenance

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")

#: characters of a value that a message shows
SHOWN: Final = 40
#: what an argument shall be, in words
WORDS: Final[Mapping[Any, str]] = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "True or False",
    Path: "a path",
    NoneType: "None",
}


def checked(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Return the function with its arguments held against their annotations.

    Whole numbers and those of numpy are taken; texts and path-like objects are paths. Raises BadInputError, which names
    the argument, what was found and what is expected.
    """

    @wraps(function)
    def called(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Returned:
        bound = bind(function, args, kwargs)
        try:
            return function(*bound.args, **bound.kwargs)
        except OSError as error:
            if not isinstance(error.filename, str):
                raise
            raise BadInputError(refused_place(error.filename, error)) from error

    return called


def bind(function: Callable[..., Any], args: Sequence[Any], kwargs: Mapping[str, Any]) -> inspect.BoundArguments:
    """Return a call's arguments as the annotations have them; raises BadInputError."""
    try:
        bound = inspect.signature(function).bind(*args, **kwargs)
    except TypeError as error:
        raise TypeError(f"{function.__name__}: {error}; see help(calib.{function.__name__})") from None
    hints = get_type_hints(function)
    for name, value in bound.arguments.items():
        try:
            bound.arguments[name] = _accepted(value, hints[name])
        except (TypeError, ValueError):
            text = repr(value)
            text = text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."
            raise BadInputError(
                f"{function.__name__}: {name}: found {text} ({type(value).__name__}); expected "
                f"{_words(hints[name])}; see help(calib.{function.__name__})"
            ) from None
    return bound


def _accepted(value: Any, hint: Any) -> Any:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is None:
        return _plain(value, hint)
    if origin in (Union, UnionType):
        # a text stays a text where either is taken
        for part in sorted(inner, key=lambda one: one is Path):
            with suppress(TypeError, ValueError):
                return _accepted(value, part)
    elif origin is Literal and isinstance(value, str) and value in inner:
        return value
    elif origin is tuple and isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return tuple(_accepted(one, part) for one, part in zip(value, inner, strict=True))
    elif origin is Sequence and isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping):
        return tuple(_accepted(one, inner[0]) for one in value)
    raise TypeError


def _plain(value: Any, hint: Any) -> Any:
    if isinstance(value, str | PathLike) and "\0" in str(value):
        raise ValueError
    if hint is Path and isinstance(value, str | PathLike) and isinstance(text := fspath(value), str):
        return Path(text)
    if hint is int and not isinstance(value, bool):
        return operator.index(value)
    if hint is float and not isinstance(value, bool | str | bytes):
        return float(value)
    if isinstance(value, hint):
        return value
    raise TypeError


def _words(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(sorted(map(_words, inner), key=lambda words: words.startswith("a list")))
    if origin is Literal:
        return f"one of {', '.join(inner)}"
    if origin is tuple:
        return f"{len(inner)} values: {', '.join(_words(part) for part in inner)}"
    if origin is Sequence:
        return f"a list, each {_words(inner[0])}"
    return WORDS.get(hint, f"a {hint.__name__}")


#: a campaign, or the folder or recording that it is read from
CampaignLike = Campaign | Path | str


def opened(campaign: CampaignLike) -> Campaign:
    """Return a campaign, read where a place is given."""
    return campaign if isinstance(campaign, Campaign) else read(campaign)


def refuse_below(least: int, **numbers: int) -> None:
    """Raise BadInputError for an argument below `least`."""
    for name, value in numbers.items():
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
        The run table, if any, first; then logs, recordings or their folders. They are only read.
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
        Where a source cannot be used, a column of the mapping is missing, or the target exists.
    """
    from calib.campaign.ingest.build import ingest as ingested

    named = None if mapping is None else Path(mapping)
    result = ingested(_paths(sources), Path(into), mapping=named, force=force)
    return replace(read_campaign(result.folder), notes=result.notes)


def _paths(sources: Sequence[Path | str] | Path | str) -> list[Path]:
    if not isinstance(sources, Path | str) and not sources:
        raise BadInputError("sources: found none; expected the run table first, then logs; name the files")
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
    return replace(fitted, provenance=provenance(campaign, arguments))


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
        A plan of runs to come, to compare the corrections of causes that cannot be told apart.
    simulator : Path or str, optional
        ``SIM.toml`` of the user's own simulator, which is run and judged in place of the model.
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
        from calib.gap.simulator import read_settings
        from calib.gap.simulator.diagnose import diagnose_simulator

        if (beside := model or journeys) is not None:
            raise BadInputError(
                f"found {beside} beside a simulator, which is judged instead of a model; give one of them"
            )
        settings = read_settings(Path(simulator))
        return diagnose_simulator(campaign, settings, seed=seed, exclude=tuple(exclude), workers=workers).diagnosis
    if exclude:
        check_excluded(exclude, observations_of(campaign), campaign.extra.get("effects", ()))
    return diagnosed(campaign, model, exclude, seed, journeys)[0]
