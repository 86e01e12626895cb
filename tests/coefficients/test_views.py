from __future__ import annotations

import csv
import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.special import stdtrit

from calib.campaign.settings import Encoder
from calib.coefficients.build import Header, export, from_law
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import FORMATS, ExportOptions, LoadPair, parse_loads
from calib.errors import BadInputError, RefusedError
from calib.radius.law import RadiusLaw
from calib.radius.regression import fit_wheel
from calib.vehicle import Vehicle


def under(*loads: LoadPair) -> ExportOptions:
    return ExportOptions(loads=loads)


def parameters(text: str | bytes) -> dict[str, dict[str, Any]]:
    """Read a ROS 2 parameter file with a YAML library: controller -> its parameters."""
    return {root: body["ros__parameters"] for root, body in yaml.safe_load(text).items()}


def test_ros2_parameters_give_back_the_radii_of_their_load(file: CoefficientFile) -> None:
    made = export(file, "ros2", under(LoadPair(300.0, 300.0), LoadPair(500.0, 700.0)))
    assert [one.name for one in made] == ["controllers_300N.yaml", "controllers_L500N_R700N.yaml"]
    for one, (left, right) in zip(made, ((300.0, 300.0), (500.0, 700.0)), strict=True):
        found = parameters(one.data)
        diff = found["diff_drive_controller"]
        radii = file.radius_m(left, right)
        # rtol: two roundings of a double
        np.testing.assert_allclose(diff["wheel_radius"] * diff["left_wheel_radius_multiplier"], radii[0], rtol=4e-16)
        np.testing.assert_allclose(diff["wheel_radius"] * diff["right_wheel_radius_multiplier"], radii[1], rtol=4e-16)
        assert diff["wheel_separation"] * diff["wheel_separation_multiplier"] == file.vehicle.track.value
        steering = found["tricycle_steering_controller"]
        assert steering["traction_wheels_radius"] == pytest.approx((radii[0] + radii[1]) / 2, rel=1e-15)
        assert found["tricycle_controller"]["wheelbase"] == 1.0
        assert f"left {left:.3f} N, right {right:.3f} N" in one.data.decode().splitlines()[0]


def test_without_loads_ros2_makes_a_file_for_each_line_of_the_load_table(file: CoefficientFile) -> None:
    assert len(export(file, "ros2")) == 2
    assert len(export(file.changed(load_table=[]), "ros2")) == 3


def test_a_load_that_was_not_measured_gets_no_parameters_unless_clamped(file: CoefficientFile) -> None:
    with pytest.raises(RefusedError):
        export(file, "ros2", under(LoadPair(2000.0, 2000.0)))
    clamped = export(file.changed(outside="clamp"), "ros2", under(LoadPair(2000.0, 2000.0)))[0].data.decode()
    assert "CLAMPED" in clamped


@pytest.mark.parametrize("to", ["ros2", "c", "csv"])
def test_every_view_names_checksum_and_simulated_data(file: CoefficientFile, to: str) -> None:
    for one in export(file, to):
        text = one.data.decode()
        assert file.checksum[:23] in text and "simulated" in text.lower()
        real = export(file.changed(simulated=False), to)[0].data.decode()
        assert "SIMULATED DATA" not in real and "true,sha256" not in real


def test_constants_of_the_program_are_marked_as_assumed(file: CoefficientFile) -> None:
    """The random walk and the track's uncertainty, which no corridor tells, in file, view and note."""
    assert file.assumed == ["vehicle.track_std", "noise.along", "noise.heading"]
    for to in ("json", "c", "ros2"):
        made = export(file, to)
        assert any("noise.along 0.0005 m/m^0.5" in note for note in made[0].notes)
        assert "noise.along" in made[0].data.decode()
    measured = file.changed(assumed=[])
    assert "assumed" not in measured.to_dict()
    assert not any("assumed, not" in export(measured, to)[0].data.decode() for to in ("json", "c", "ros2"))


#: half a unit of the last digit that is written, and rounding beside it
TEN_DIGITS, SIX_DIGITS = 5.1e-10, 5.1e-6


def test_the_table_holds_radius_and_its_bands(file: CoefficientFile) -> None:
    """Against the textbook formulas, k from another implementation of Student's t."""
    rows = list(csv.DictReader(io.StringIO(export(file, "csv")[0].data.decode())))
    assert len(rows) == 41
    k = stdtrit(58, 0.975)
    seen = 0
    for row in rows:
        load = float(row["load_left_N"])
        offset = load - 300.0
        variance = 9e-12 - 2e-14 * offset + 4e-17 * offset**2
        assert float(row["radius_left_m"]) == pytest.approx(0.0990 + 1.3e-6 * offset, rel=TEN_DIGITS)
        assert float(row["radius_left_std_m"]) == pytest.approx(variance**0.5, rel=SIX_DIGITS)
        assert float(row["radius_left_mean_u95_m"]) == pytest.approx(k * variance**0.5, rel=SIX_DIGITS)
        single = k * (variance + 4e-10) ** 0.5
        assert float(row["radius_left_prediction_u95_m"]) == pytest.approx(single, rel=SIX_DIGITS)
        # loads as people write them: no 434.79999999999995
        assert len(row["load_left_N"].partition(".")[2]) <= 3
        inside = 212.551 <= load <= 1050.0
        assert (row["radius_right_m"] != "") == inside
        seen += inside
    assert 0 < seen < 41
    clamped = list(csv.DictReader(io.StringIO(export(file.changed(outside="clamp"), "csv")[0].data.decode())))
    assert all(row["radius_right_m"] for row in clamped)
    # each radius is that of the law at the load stated for it, which is the row's own where that was measured
    for row in clamped:
        at = float(row["clamped_load_right_N"])
        assert at == min(max(float(row["load_right_N"]), 212.551), 1050.0)
        assert float(row["radius_right_m"]) == pytest.approx(float(file.law.right.radius_m(at)), rel=TEN_DIGITS)
    assert not any("clamped" in name for name in rows[0])


@pytest.mark.parametrize("session_um", [0.0, 10.0])
def test_exported_bands_cover_what_they_say(session_um: float) -> None:
    """Four sessions of a crossed campaign: Monte Carlo of the law, and of one further run, through file and table.

    Where sessions do not scatter the mean's band holds more: it is never narrower than that of independent runs.
    """
    campaigns, rng, at = 100, np.random.default_rng(5), np.array([300.0, 675.0, 1000.0])
    load, session = np.tile([300.0, 500.0, 800.0, 1100.0], 12), np.repeat(np.arange(4), 12)
    held = np.zeros((2, len(at)))
    for _ in range(campaigns):
        radius = 0.1 + 1e-6 * (rng.normal(0, session_um, 4)[session] + rng.normal(0, 19, 48))
        fit = fit_wheel("left", load, radius, session, reference_load_N=300.0)
        made = from_law(RadiusLaw(fit.law, fit.law), Vehicle(), Encoder(4096.0, 4096.0), Header("drawn", True))
        again = CoefficientFile.model_validate_json(made.to_bytes())
        table = export(again, "csv", under(*(LoadPair(value, value) for value in at)))[0].data.decode()
        rows = list(csv.DictReader(io.StringIO(table)))
        new = 0.1 + 1e-6 * (rng.normal(0, session_um) + rng.normal(0, 19))
        for number, (truth, name) in enumerate(((0.1, "mean"), (new, "prediction"))):
            ends = fit.band_m(at, single_run=name == "prediction")
            middle, half = (
                np.array([float(row[f"radius_left_{key}"]) for row in rows]) for key in ("m", f"{name}_u95_m")
            )
            # the digits of the table
            np.testing.assert_allclose(half, 0.5 * np.diff(ends, axis=0)[0], rtol=SIX_DIGITS)
            held[number] += np.abs(truth - middle) < half
    # standard error of 100 campaigns 2.2 %; three of them
    covered = held / campaigns
    np.testing.assert_allclose(covered[1], 0.95, atol=0.066)
    np.testing.assert_allclose(np.minimum(covered[0], 1.0 if session_um else 0.95), 0.95, atol=0.066)


def test_a_load_valid_for_no_wheel_gets_no_row(file: CoefficientFile) -> None:
    with pytest.raises(RefusedError):
        export(file, "csv", under(LoadPair(5.0, 5.0)))


def test_loads_are_given_for_both_wheels_or_for_each() -> None:
    assert parse_loads(["300", "500,700.5"]) == (LoadPair(300.0, 300.0), LoadPair(500.0, 700.5))
    for bad in ("x", "1,2,3", "-5", "nan", "inf", ""):
        with pytest.raises(BadInputError, match="load: found"):
            parse_loads([bad])


def test_every_registered_format_can_be_made(file: CoefficientFile, options_of: Callable[[str], ExportOptions]) -> None:
    for to in FORMATS:
        first, second = (export(file, to, options=options_of(to)) for _ in range(2))
        assert first and first == second
    with pytest.raises(BadInputError, match="expected one of"):
        export(file, "xml")
