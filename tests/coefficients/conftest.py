"""A coefficient file to test with: two wheels of different law, measured from 200 to 1100 N."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.settings import Encoder
from calib.coefficients.build import Header, from_law
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import ExportOptions
from calib.radius.law import RadiusLaw, WheelLaw
from calib.vehicle import Vehicle


def wheel(radius_m: float, slope: float, *, low: float = 200.0, high: float = 1100.0) -> WheelLaw:
    return WheelLaw(
        reference_load_N=300.0,
        radius_ref_m=radius_m,
        slope_m_per_N=slope,
        covariance=np.array([[9e-12, -1e-14], [-1e-14, 4e-17]]),
        dof=58.0,
        residual_std_m=2e-5,
        load_min_N=low,
        load_max_N=high,
        n_runs=60,
    )


@pytest.fixture(scope="session")
def law() -> RadiusLaw:
    return RadiusLaw(wheel(0.0990, 1.3e-6), wheel(0.0991, -1.47e-6, low=212.5512345, high=1050.0))


@pytest.fixture(scope="session")
def file(law: RadiusLaw) -> CoefficientFile:
    return from_law(
        law,
        Vehicle(),
        Encoder(),
        Header("corridor", simulated=True, inputs={"runs.csv": "a" * 64}),
        load_margin_N=0.0,
        load_table={"empty": (300.0, 301.5), "full": (900.0, 1000.25)},
    )


MODELS = Path(__file__).parent / "models"
#: what a format that patches a model is given; none of it for the others
OF_FORMAT = {
    "mjcf": ExportOptions(model=MODELS / "wheels.xml", left="left", right="right"),
    "urdf": ExportOptions(model=MODELS / "differential.urdf", left="left_joint", right="right_joint"),
    "sdf": ExportOptions(model=MODELS / "tricycle.sdf", left="left", right="right"),
}


@pytest.fixture(scope="session")
def options_of() -> Callable[[str], ExportOptions]:
    return lambda to: OF_FORMAT.get(to, ExportOptions())


@pytest.fixture(scope="session")
def loadless(law: RadiusLaw) -> CoefficientFile:
    """As from a geometry without loads: slope 0 with a standard deviation, all loads valid, no degrees of freedom."""
    left, right = (
        replace(
            wheel, slope_m_per_N=0.0, covariance=np.diag([9e-12, 1e-12]), dof=0.0, load_min_N=0.0, load_max_N=5000.0
        )
        for wheel in (law.left, law.right)
    )
    return from_law(RadiusLaw(left, right), Vehicle(drive="differential"), Encoder(), Header("squares", True))
