"""Fleets with known truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.plant.make import FleetSize, FleetTruth, make_fleet

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")


@pytest.fixture(scope="session")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FleetTruth]:
    """Forty vehicles of two months, four odd ones."""
    folder = tmp_path_factory.mktemp("fleets") / "small"
    rng = np.random.default_rng(11)
    return folder, make_fleet(folder, rng, FleetSize(40, n_runs=24, n_months=2, n_outliers=4, n_drifting=0, n_common=0))
