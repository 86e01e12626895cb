"""Fixtures for the whole suite."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

# small matrices gain nothing from threads, and tests that run side by side lose by them; before numpy is imported
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# the search for garbage is a sixth of the suite's time at Python's own thresholds: arrays and results have no cycles
gc.set_threshold(20_000, 20, 50)

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from calib.campaign.model import Campaign
    from calib.gap.decision.diagnosis import Diagnosis

# the same examples every time, so that one commit has one outcome; HYPOTHESIS_PROFILE=explore looks further.
# No deadline: a busy machine is no fault of the code.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

ROOT = Path(__file__).resolve().parents[1]


def pytest_collection_finish() -> None:
    """Leave modules and tests out of every later search for garbage: they are many and stay to the end."""
    gc.collect()
    gc.freeze()


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
    blank = b'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="5"/>'
    monkeypatch.setattr("calib.reporting.pages.render", lambda _figure, _form: blank)


@pytest.fixture(scope="session")
def diagnosed_sample(project_root: Path) -> Callable[[str], tuple[Campaign, Diagnosis]]:
    """A sample campaign by name and its diagnosis, made once; nobody changes either."""
    from calib.campaign.read import read_campaign
    from calib.gap.diagnose import diagnose_in_full

    @cache
    def diagnosed(name: str) -> tuple[Campaign, Diagnosis]:
        campaign = read_campaign(project_root / "sample_runs" / name)
        return campaign, diagnose_in_full(campaign)

    return diagnosed
