from __future__ import annotations

import re
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.coefficients.build import export
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats.for_vehicle import FixedPoint, fixed_point
from calib.coefficients.sections import EffectSection, WheelSection
from calib.errors import RefusedError

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow"]
PROBE = r"""
#include <stdio.h>
#include "calib_coefficients.h"
int main(void)
{
    double load;
    while (scanf("%lf", &load) == 1) {
        double l = -1.0, r = -1.0;
        int32_t nl = -1, nr = -1;
        int32_t milli = (int32_t)(load * 1000.0 + 0.5);
        int a = (int)calib_radius_left(load, &l), b = (int)calib_radius_right(load, &r);
        int c = (int)calib_radius_left_nm(milli, &nl), d = (int)calib_radius_right_nm(milli, &nr);
        printf("%d %d %d %d %.17g %.17g %ld %ld %ld\n", a, b, c, d, l, r, (long)milli, (long)nl, (long)nr);
    }
    return 0;
}
"""

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")


def build(file: CoefficientFile, folder: Path, *extra: str) -> Path:
    (folder / "calib_coefficients.h").write_bytes(export(file, "c")[0].data)
    (folder / "probe.c").write_text(PROBE)
    command = ["cc", *STRICT, *extra, "-O2", "-o", str(folder / "probe"), str(folder / "probe.c"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "probe"


def ask(program: Path, loads: np.ndarray) -> np.ndarray:
    text = "\n".join(repr(float(load)) for load in loads)
    done = subprocess.run([str(program)], input=text, capture_output=True, text=True, check=True)
    return np.array([[float(cell) for cell in line.split()] for line in done.stdout.splitlines()])


def exact_nm(wheel: WheelSection, milli: int) -> Fraction:
    """The law in real numbers, in nm, at a load in mN."""
    offset = Fraction(milli, 1000) - Fraction(wheel.reference_load.value)
    return (Fraction(wheel.radius_ref.value) + Fraction(wheel.slope.value) * offset) * 10**9


def test_the_header_compiles_strictly_and_agrees_with_python(file: CoefficientFile, tmp_path: Path) -> None:
    loads = np.round(np.linspace(213.0, 1050.0, 5001), 3)
    found = ask(build(file, tmp_path), loads)
    assert (found[:, :4] == 0).all()
    left, right = file.radius_m(loads, loads)
    # rtol of the demand; the two differ by a fused multiply-add at most
    np.testing.assert_allclose(found[:, 4], left, rtol=1e-12, atol=0)
    np.testing.assert_allclose(found[:, 5], right, rtol=1e-12, atol=0)


def radius_nm(form: FixedPoint, load_mN: int) -> int:
    """Return the radius in nm at a load in mN within the valid range, as the C form computes it."""
    return (form.base + form.slope * (load_mN - form.load_min_mN) + (1 << (form.shift - 1))) >> form.shift


def test_the_integer_form_stays_within_its_stated_error(file: CoefficientFile, tmp_path: Path) -> None:
    """Against the law in rational numbers, at 5000 loads and both ends; the header's own number is the bound."""
    loads = np.round(np.linspace(212.551, 1050.0, 5000), 3)
    found = ask(build(file, tmp_path), loads)
    header = export(file, "c")[0].data.decode()
    for column, side, wheel in ((7, "LEFT", file.wheels.left), (8, "RIGHT", file.wheels.right)):
        match = re.search(rf"CALIB_{side}_MAX_ERROR_NM (\S+)", header)
        assert match
        bound = float(match[1])
        worst = max(abs(exact_nm(wheel, int(m)) - int(n)) for m, n in zip(found[:, 6], found[:, column], strict=True))
        assert worst <= bound < 0.51
        mine = fixed_point(wheel, side)
        assert [radius_nm(mine, int(m)) for m in found[:, 6]] == found[:, column].astype(int).tolist()


@settings(deadline=None, max_examples=200)
@given(
    radius=st.floats(0.01, 1.5),
    slope=st.floats(-5e-6, 5e-6),
    low=st.floats(0.0, 500.0),
    span=st.floats(0.0, 1000.0),
    part=st.floats(0.0, 1.0),
)
def test_the_bound_of_the_integer_form_holds_for_any_law(
    radius: float, slope: float, low: float, span: float, part: float
) -> None:
    """Also its intermediates fit 64 bits and its result 32."""
    q = lambda value, unit: {"value": value, "unit": unit}  # noqa: E731
    wheel = WheelSection.model_validate(
        {
            "radius_ref": q(radius, "m"),
            "slope": q(slope, "m/N"),
            "reference_load": q(300.0, "N"),
            "variance_radius_ref": q(0.0, "m^2"),
            "covariance_radius_ref_slope": q(0.0, "m^2/N"),
            "variance_slope": q(0.0, "m^2/N^2"),
            "dof": q(3.0, "1"),
            "residual_std": q(0.0, "m"),
            "n_runs": q(5.0, "1"),
            "valid_load": {"min": q(np.floor(low), "N"), "max": q(np.floor(low) + np.ceil(span), "N")},
        }
    )
    form = fixed_point(wheel, "left")
    load = form.load_min_mN + round(part * (form.load_max_mN - form.load_min_mN))
    assert abs(exact_nm(wheel, load) - radius_nm(form, load)) <= form.max_error_nm <= Fraction(51, 100)
    for at in (form.load_min_mN, form.load_max_mN):
        assert abs(form.base + form.slope * (at - form.load_min_mN)) + 2**form.shift < 2**63
        assert 0 < radius_nm(form, at) < 2**31


def test_outside_the_range_the_header_follows_the_rule_of_the_file(file: CoefficientFile, tmp_path: Path) -> None:
    loads = np.array([0.1, 199.9, 1100.5, 5000.0])
    refused = ask(build(file, tmp_path), loads)
    assert (refused[:, :4] == 2).all()
    assert (refused[:, [4, 5, 7, 8]] == -1).all()
    clamped = ask(build(file.changed(outside="clamp"), tmp_path), loads)
    left, right = file.changed(outside="clamp").radius_m(loads, loads)
    assert (clamped[:, :4] == 0).all()
    np.testing.assert_allclose(clamped[:, 4], left, rtol=1e-12, atol=0)
    np.testing.assert_allclose(clamped[:, 5], right, rtol=1e-12, atol=0)
    np.testing.assert_allclose(clamped[:, 7], left * 1e9, rtol=0, atol=0.51)
    # a load cell that is dead, saturated or exchanged
    assert (ask(build(file.changed(outside="clamp"), tmp_path), np.array([-50.0, 0.0, 5000.1]))[:, :4] == 2).all()


@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
def test_the_header_refuses_options_that_take_nan_for_impossible(
    file: CoefficientFile, tmp_path: Path, option: str
) -> None:
    with pytest.raises(AssertionError, match="compile without -ffast-math and -ffinite-math-only"):
        build(file, tmp_path, option)
    build(file, tmp_path, "-fno-math-errno")


def test_the_header_is_cplusplus_too(file: CoefficientFile, tmp_path: Path) -> None:
    if shutil.which("c++") is None:
        pytest.skip("no C++ compiler here")
    (tmp_path / "calib_coefficients.h").write_bytes(export(file, "c")[0].data)
    (tmp_path / "m.cpp").write_text(
        '#include "calib_coefficients.h"\n'
        "int main() { calib_odometer o; calib_init(&o); return calib_feed(&o, 0, 0); }\n"
    )
    command = ["c++", "-std=c++11", "-Wall", "-Wextra", "-Werror", "-c", "-o", str(tmp_path / "m.o"), "m.cpp"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_names_from_data_cannot_break_out_of_a_comment(file: CoefficientFile, tmp_path: Path) -> None:
    effect = EffectSection(effect="*/ #error x \\", parameters={})
    hostile = file.changed(name="*/ int x; /* ü\n#error ??/", effects=[effect], load_table=[])
    build(hostile, tmp_path)


def test_a_law_that_32_bits_cannot_hold_is_refused(file: CoefficientFile) -> None:
    wheel = file.wheels.left.model_copy(
        update={"radius_ref": file.wheels.left.radius_ref.model_copy(update={"value": 3.0})}
    )
    with pytest.raises(RefusedError, match="32 bits"):
        fixed_point(wheel, "left")


def test_the_comment_of_a_wheel_and_its_values_agree(file: CoefficientFile, tmp_path: Path) -> None:
    """Reference load, radius and slope: in the comment, as defined, and by the compiled law."""
    header = export(file, "c")[0].data.decode()
    found = ask(build(file, tmp_path), np.array([300.0, 301.0]))
    for column, side in ((4, "left"), (5, "right")):
        said = re.search(
            rf"/\* {side} wheel: (\S+) m at the reference load of (\S+) N, plus (\S+) m for each N above it", header
        )
        assert said
        radius, load, slope = (float(part.strip("()")) for part in said.groups())
        for name, value in (("RADIUS_REF_M", radius), ("REFERENCE_LOAD_N", load), ("SLOPE_M_PER_N", slope)):
            defined = re.search(rf"#define CALIB_{side.upper()}_{name} (\S+)", header)
            assert defined and float(defined[1].strip("()")) == value
        assert load == 300.0
        # rtol: a fused multiply-add; atol: the difference of two radii has lost their leading digits
        assert found[0, column] == pytest.approx(radius, rel=1e-15)
        assert found[1, column] - found[0, column] == pytest.approx(slope, rel=0, abs=1e-16)


def test_a_law_that_no_load_changes_compiles_and_is_one_radius(loadless: CoefficientFile, tmp_path: Path) -> None:
    """From zero to the largest load of the vehicle, in both forms."""
    found = ask(build(loadless, tmp_path), np.array([0.0, 300.0, 5000.0]))
    assert (found[:, :4] == 0).all()
    assert (found[:, 4] == 0.0990).all() and (found[:, 5] == 0.0991).all()
    assert (found[:, 7] == 99_000_000).all() and (found[:, 8] == 99_100_000).all()
