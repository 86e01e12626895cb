"""From files to a campaign: `read`, `describe`, `ingest`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calib.arguments import checked
from calib.campaign.ingest.describe import Description
from calib.campaign.model import Campaign
from calib.errors import BadInputError

#: a campaign, or the folder or recording that it is read from
CampaignLike = Campaign | Path | str


def opened(campaign: CampaignLike) -> Campaign:
    """Return a campaign, read where a place is given."""
    return campaign if isinstance(campaign, Campaign) else read(campaign)


def refuse_negative(seed: int) -> None:
    """Raise BadInputError for a seed below zero."""
    if seed < 0:
        raise BadInputError(f"seed: found {seed}; expected a whole number from 0 on; give one")


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
    from calib.campaign.read import read_or_ingest

    return read_or_ingest(Path(source), mapping=None if mapping is None else Path(mapping))


@checked
def describe(sources: Sequence[Path | str]) -> Description:
    """Say what is in files of any laboratory, and propose a mapping of their columns.

    Parameters
    ----------
    sources : sequence of Path or str
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
    from calib.campaign.ingest import describe as described

    return described([Path(source) for source in sources])


@checked
def ingest(
    sources: Sequence[Path | str], into: Path | str, *, mapping: Path | str | None = None, force: bool = False
) -> Campaign:
    """Make a campaign folder out of files of any laboratory, and read it.

    Parameters
    ----------
    sources : sequence of Path or str
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
    from calib.campaign.ingest import ingest as ingested
    from calib.campaign.read import read_campaign

    made = ingested(
        [Path(source) for source in sources],
        Path(into),
        mapping=None if mapping is None else Path(mapping),
        force=force,
    )
    return replace(read_campaign(made.folder), notes=made.notes)
