"""Export formats that need the fit or the runs, one file each; see `FORMATS`."""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Final

from calib.coefficients.formats import Artifact
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.types import Progress

#: format -> module of this package, whose ``render(path, accept, progress)`` returns the files
FORMATS: Final[dict[str, str]] = {"dcc": "dcc", "mcap": "mcap_paths", "nav2": "nav2"}
BINARY: Final = frozenset({"mcap"})


def export_from(
    path: Path | str, to: str, *, accept: str = "", progress: "Progress | None" = None
) -> tuple[Artifact, ...]:
    """Return the files of a campaign, or of a result folder, in a format of `FORMATS`.

    `accept`: why a law whose checks failed is passed on; empty: refused. Raises BadInputError where the path cannot be
    used; RefusedError where the source lacks what the format needs.
    """
    from calib.types import silent

    module = importlib.import_module(f"{__name__}.{FORMATS[to]}")
    artifacts: tuple[Artifact, ...] = module.render(Path(path), accept, progress or silent)
    return artifacts


def diagnosed(path: Path, progress: "Progress") -> "tuple[Campaign, Diagnosis]":
    """Return a campaign and its diagnosis without a plan; BadInputError for a result folder."""
    from calib.campaign.read import read_campaign
    from calib.gap.diagnose import diagnose_in_full
    from calib.radius.result import is_result

    if is_result(path):
        raise BadInputError(f"{path}: found a result; expected a campaign folder, which has runs; give it")
    campaign = read_campaign(path, progress=progress)
    return campaign, diagnose_in_full(campaign, plan=False, progress=progress)
