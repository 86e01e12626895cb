"""Fixtures for the whole suite."""

from __future__ import annotations

import gc
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

# small matrices gain nothing from threads, and tests that run side by side lose by them; before numpy is imported
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# byte code of the package is kept, as that of an installed one is: else each process that a test starts compiles it
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# the search for garbage is a sixth of the suite's time at Python's own thresholds: arrays and results have no cycles
gc.set_threshold(20_000, 20, 50)

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from xdist.scheduler import WorkStealingScheduling

    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry
    from tests.campaign.ingest.lab import Lab

# the same examples every time, so that one commit has one outcome; HYPOTHESIS_PROFILE=explore looks further.
# No deadline: a busy machine is no fault of the code.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

ROOT = Path(__file__).resolve().parents[1]
#: a picture of nothing
BLANK = b'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="5"/>'


def pytest_collection_finish() -> None:
    """Leave modules and tests out of every later search for garbage: they are many and stay to the end."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> WorkStealingScheduling:
    """Give each process a part of the suite, so that what a module's tests share is made once, and even out the end."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)  # type: ignore[arg-type]


@pytest.fixture(scope="session", autouse=True)
def packages_looked_up_once() -> Iterator[None]:
    """Look up the effects that installed packages offer once: none is installed while the suite runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.gap.effects.quantities.entry_points", cache(entry_points))
        yield


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The folder that holds ``pyproject.toml``."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Recordings by others, beside the project; a test that needs them is skipped where they are absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"real recordings are not here: {folder.relative_to(ROOT.parent)} does not exist")
    return folder


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set a blank picture for each figure of a page: what it shows is the tests' of figures and pages."""
    monkeypatch.setattr("calib.reporting.Picture.svg", BLANK)


@pytest.fixture(scope="session")
def diagnosing() -> Callable[..., Diagnosis]:
    """`diagnose_in_full` that makes each diagnosis once; nobody changes one."""
    from calib.campaign.model import Campaign
    from calib.gap.diagnose import diagnose_in_full

    made: dict[str, Diagnosis] = {}

    def diagnosed(campaign: Campaign, *, plan: bool = True, progress: object = None, **options: Any) -> Diagnosis:
        given = {name: value for name, value in {**options, "of": campaign}.items() if value}
        asked = repr({name: _digest(value) if isinstance(value, Campaign) else value for name, value in given.items()})
        # with its plan it has all that it has without
        key = f"{asked} planned"
        if key not in made:
            key = key if plan else asked
        if key not in made:
            made[key] = diagnose_in_full(campaign, plan=plan, **options)
        return made[key]

    return diagnosed


@pytest.fixture(scope="session")
def diagnosed_sample(
    project_root: Path, diagnosing: Callable[..., Diagnosis]
) -> Callable[[str], tuple[Campaign, Diagnosis]]:
    """A sample campaign by name and its diagnosis, made once; nobody changes either."""
    from calib.campaign.read import read_campaign

    @cache
    def diagnosed(name: str) -> tuple[Campaign, Diagnosis]:
        campaign = read_campaign(project_root / "sample_runs" / name)
        return campaign, diagnosing(campaign)

    return diagnosed


@pytest.fixture
def diagnosed_once(monkeypatch: pytest.MonkeyPatch, diagnosing: Callable[..., Diagnosis]) -> None:
    """Let commands and functions that ask for the same diagnosis share it: how it is made is the tests' of `gap`."""
    monkeypatch.setattr("calib.gap.diagnose.diagnose_in_full", diagnosing)


@pytest.fixture(scope="session")
def estimating() -> Callable[..., Geometry]:
    """`estimate_geometry` that makes each estimate once, or refuses it; nobody changes one."""
    from calib.errors import CalibError
    from calib.kinematics.estimate import estimate_geometry

    made: dict[str, Geometry | CalibError] = {}

    def estimated(campaign: Campaign, *, progress: object = None, **options: Any) -> Geometry:
        key = repr((_digest(campaign), {name: value for name, value in options.items() if value not in (None, ())}))
        if key not in made:
            try:
                made[key] = estimate_geometry(campaign, **options)
            except CalibError as error:
                made[key] = error
        if isinstance(found := made[key], CalibError):
            raise found.with_traceback(None)
        return found

    return estimated


@pytest.fixture
def estimated_once(monkeypatch: pytest.MonkeyPatch, estimating: Callable[..., Geometry]) -> None:
    """Let commands that ask for the same geometry share it: how it is estimated is the tests' of `kinematics`."""
    monkeypatch.setattr("calib.kinematics.estimate.estimate_geometry", estimating)


@pytest.fixture(scope="session")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Lab, str]]:
    """A laboratory's export, ``german`` or ``plain``, and the mapping that its description proposes, made once."""
    from calib.campaign.ingest.describe import describe
    from tests.campaign.ingest import lab

    @cache
    def written(variant: str) -> tuple[Lab, str]:
        files = {"german": lab.german, "plain": lab.plain}[variant](tmp_path_factory.mktemp(variant))
        return files, describe([files.table, files.logs]).to_toml()

    return written


def _digest(campaign: Campaign) -> str:
    """Return a hash of everything that a campaign holds."""
    runs, logs = campaign.runs, campaign.logs
    settings = (campaign.name, campaign.vehicle, campaign.encoder, campaign.model, campaign.rangefinder)
    digest = hashlib.sha256(repr((*settings, campaign.reference, campaign.odometry, campaign.extra)).encode())
    for columns in (runs.labels, runs.numbers, logs.columns):
        for name, column in columns.items():
            digest.update(name.encode() + column.tobytes())
    digest.update(runs.excluded.tobytes() + logs.offsets.tobytes() + repr((campaign.notes, campaign.hashes)).encode())
    return digest.hexdigest()
