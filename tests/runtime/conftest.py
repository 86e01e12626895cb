"""Coefficient files and the compiled header to drive."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.settings import Encoder
from calib.coefficients.build import Header, export, from_law
from calib.coefficients.file import CoefficientFile
from calib.radius.law import RadiusLaw, WheelLaw
from calib.vehicle import Vehicle

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"]


def wheel(radius_m: float, slope: float) -> WheelLaw:
    return WheelLaw(
        reference_load_N=300.0,
        radius_ref_m=radius_m,
        slope_m_per_N=slope,
        covariance=np.array([[9e-10, -1e-12], [-1e-12, 4e-15]]),
        dof=58.0,
        residual_std_m=2e-5,
        load_min_N=200.0,
        load_max_N=1100.0,
        n_runs=60,
    )


@pytest.fixture(scope="session")
def file() -> CoefficientFile:
    """Two different wheels, 16-bit counters of different resolution, a centre of mass off the middle."""
    return from_law(
        RadiusLaw(wheel(0.0990, 1.3e-6), wheel(0.0991, -1.47e-6)),
        Vehicle(cog_y_m=0.01),
        Encoder(counts_per_rev_left=4096.0, counts_per_rev_right=4000.0, wrap_bits=16),
        Header("corridor", simulated=True),
        load_margin_N=0.0,
        load_table={"empty": (300.0, 301.5), "full": (900.0, 1000.25)},
    )


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., np.ndarray]:
    """Run a script through the header of a coefficient file; one row of numbers for each line shown."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    programs: dict[tuple[str, ...], Path] = {}

    def run(file: CoefficientFile, script: Sequence[str], *defines: str) -> np.ndarray:
        key = (file.checksum, *defines)
        if key not in programs:
            folder = tmp_path_factory.mktemp("driver")
            (folder / "calib_coefficients.h").write_bytes(export(file, "c")[0].data)
            source = Path(__file__).with_name("driver.c")
            command = ["cc", *STRICT, "-O2", f"-I{folder}", *(f"-D{one}" for one in defines)]
            command += ["-o", str(folder / "driver"), str(source), "-lm"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            programs[key] = folder / "driver"
        done = subprocess.run([str(programs[key])], input="\n".join(script), capture_output=True, text=True, check=True)
        return np.array([[float(cell) for cell in line.split()] for line in done.stdout.splitlines()])

    return run
