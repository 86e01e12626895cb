from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from calib.campaign.settings import Encoder
from calib.coefficients.build import Header, export, from_law, load_points
from calib.coefficients.file import CoefficientFile, load_coefficients
from calib.coefficients.formats import ExportOptions, LoadPair
from calib.coefficients.sections import EffectSection, first_fault
from calib.errors import BadFileError, BadInputError, CalibError, RefusedError
from calib.radius.law import LineEstimate, RadiusLaw
from calib.vehicle import Vehicle


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            yield from leaves(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from leaves(item, (*path, index))
    else:
        yield path, value


def put(document: Any, path: tuple[Any, ...], value: Any) -> Any:
    copy = json.loads(json.dumps(document))
    at = copy
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return copy


def test_a_file_reads_back_as_it_was_written(file: CoefficientFile, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(file.to_bytes())
    assert load_coefficients(path) == file
    assert load_coefficients(path).to_bytes() == file.to_bytes()


def test_the_same_input_gives_the_same_bytes_on_any_day(law: RadiusLaw) -> None:
    made = [from_law(law, Vehicle(), Encoder(), Header("n", False)).to_bytes() for _ in range(2)]
    assert made[0] == made[1]
    assert json.loads(made[0])["created"] is None


def test_every_number_has_its_unit(file: CoefficientFile) -> None:
    document = file.to_dict()
    numbers = 0
    for path, value in leaves(document):
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            numbers += 1
            section = document
            for key in path[:-1]:
                section = section[key]
            assert path[-1] == "value" and isinstance(section["unit"], str), path
    assert numbers > 40


def test_the_checksum_is_sha256_of_all_other_sorted_fields_with_all_numbers_as_doubles(file: CoefficientFile) -> None:
    """The definition of the format, written out a second time with parse_int."""
    document = json.loads(file.to_bytes(), parse_int=float)
    stated = document.pop("checksum")
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    assert stated == "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def test_reformatting_keeps_the_checksum(file: CoefficientFile, tmp_path: Path) -> None:
    """Another program may re-indent, re-order, and write 4096.0 as 4096."""
    text = json.dumps(json.loads(file.to_bytes()), sort_keys=True, indent=7).replace("4096.0", "4096")
    path = tmp_path / "c.json"
    path.write_text("\ufeff" + text, encoding="utf-8")
    assert load_coefficients(path) == file


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_altered_value_passes(file: CoefficientFile, tmp_path: Path, data: st.DataObject) -> None:
    """For any changed leaf and any value the file is refused in one line."""
    document = file.to_dict()
    path, old = data.draw(st.sampled_from(list(leaves(document))))
    other = st.one_of(
        st.floats(allow_nan=False, allow_infinity=False), st.text(max_size=5), st.none(), st.booleans(), st.just([])
    ).filter(lambda value: value != old or type(value) is not type(old))
    target = tmp_path / "c.json"
    target.write_text(json.dumps(put(document, path, data.draw(other))), encoding="utf-8")
    with pytest.raises(BadFileError) as caught:
        load_coefficients(target)
    assert "\n" not in str(caught.value) and "c.json" in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b"{}", b'{"format": "calib-coefficients/2"}', b"\xff\xfe", b"[" * 100_000, b'{"a":1,"a":2}'],
)
def test_other_content_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(BadFileError) as caught:
        load_coefficients(path)
    assert "\n" not in str(caught.value)


def test_a_folder_without_a_result_is_named_itself(tmp_path: Path) -> None:
    """Not a file in it that nobody gave."""
    with pytest.raises(BadFileError) as refused:
        load_coefficients(tmp_path)
    assert "geometry.json" not in str(refused.value)


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999", "1" + "0" * 400])
def test_numbers_that_are_not_finite_doubles_are_refused(file: CoefficientFile, tmp_path: Path, number: str) -> None:
    path = tmp_path / "c.json"
    path.write_text(file.to_bytes().decode().replace("1.3e-06", number, 1), encoding="utf-8")
    with pytest.raises(BadFileError):
        load_coefficients(path)


def test_radii_follow_the_line_of_each_wheel(file: CoefficientFile) -> None:
    loads = np.linspace(220.0, 1000.0, 50)
    left, right = file.radius_m(loads, loads[::-1])
    # atol: a few last bits of 0.1 m
    np.testing.assert_allclose(left, 0.0990 + 1.3e-6 * (loads - 300.0), rtol=0, atol=1e-16)
    np.testing.assert_allclose(right, 0.0991 - 1.47e-6 * (loads[::-1] - 300.0), rtol=0, atol=1e-16)


@pytest.mark.parametrize("loads", [(199.9, 300.0), (300.0, 1050.1), (300.0, 212.5)])
def test_a_load_outside_the_range_is_refused_or_clamped_as_the_file_states(
    file: CoefficientFile, loads: tuple[float, float]
) -> None:
    with pytest.raises(RefusedError, match="wheel load"):
        file.radius_m(*loads)
    clamped = file.changed(outside="clamp").radius_m(*loads)
    inside = file.radius_m(np.clip(loads[0], 200.0, 1100.0), np.clip(loads[1], 212.551, 1050.0))
    assert clamped == inside


@pytest.mark.parametrize("outside", ["refuse", "clamp"])
def test_a_load_that_is_no_number_is_refused_even_where_loads_are_clamped(file: CoefficientFile, outside: str) -> None:
    with pytest.raises(BadInputError):
        file.changed(outside=outside).radius_m([300.0, np.nan], 300.0)


def test_the_valid_range_reaches_outwards_to_whole_millinewtons(file: CoefficientFile) -> None:
    assert file.wheels.right.valid_load.min.value == 212.551
    assert file.law.right.load_max_N == 1050.0


def test_the_valid_range_has_a_margin_for_the_scatter_of_weighing(law: RadiusLaw) -> None:
    """1 % of the span measured, 1 N at least, never below zero."""
    made = from_law(law, Vehicle(), Encoder(), Header("n", False)).law
    assert (made.left.load_min_N, made.left.load_max_N) == (191.0, 1109.0)
    narrow = RadiusLaw(replace(law.left, load_min_N=0.5, load_max_N=1.5), law.right)
    made = from_law(narrow, Vehicle(), Encoder(), Header("n", False)).law
    assert (made.left.load_min_N, made.left.load_max_N) == (0.0, 2.5)


def test_law_and_vehicle_are_those_of_the_input(file: CoefficientFile, law: RadiusLaw) -> None:
    for wheel, given_ in ((file.law.left, law.left), (file.law.right, law.right)):
        np.testing.assert_array_equal(wheel.covariance, given_.covariance)
        assert (wheel.radius_ref_m, wheel.slope_m_per_N, wheel.dof, wheel.n_runs) == (
            given_.radius_ref_m,
            given_.slope_m_per_N,
            given_.dof,
            given_.n_runs,
        )
    assert file.geometry == Vehicle()


def test_a_change_makes_a_valid_file_of_another_checksum(file: CoefficientFile, tmp_path: Path) -> None:
    effect = EffectSection(effect="track_width", parameters={"relative": {"value": 3e-3, "unit": "1"}})
    changed = file.changed(effects=[effect], created="2025-03-31")
    path = tmp_path / "c.json"
    path.write_bytes(changed.to_bytes())
    assert load_coefficients(path).effects == [effect]
    assert changed.checksum != file.checksum
    with pytest.raises(CalibError, match="created"):
        file.changed(created="31.3.2025")


def test_strata_that_are_no_parts_of_the_covariance_make_no_file(law: RadiusLaw) -> None:
    half = 0.5 * law.left.covariance
    strata = LineEstimate(np.zeros(2), 50.0, 3.0, 3e-10, 1e-10, half, half, None, hc3=False, design="crossed")
    head = (Vehicle(), Encoder(), Header("corridor", True))
    made = from_law(replace(law, left=replace(law.left, strata=strata)), *head)
    assert made.law.left.dof_of([1.0, 0.0]) == pytest.approx(strata.dof([1.0, 0.0]))
    assert "strata" not in made.to_dict()["wheels"]["right"]  # type: ignore[index]
    with pytest.raises(BadInputError, match="strata"):
        from_law(replace(law, left=replace(law.left, strata=replace(strata, cov_within=2 * half))), *head)


def test_impossible_coefficients_make_no_file(law: RadiusLaw) -> None:
    """A correlation beyond 1, a radius that reaches zero, a step beyond half a wrap."""
    with pytest.raises(BadInputError, match="correlation"):
        bad = replace(law.left, covariance=np.array([[1e-12, 1e-13], [1e-13, 1e-16]]))
        from_law(RadiusLaw(bad, law.right), Vehicle(), Encoder(), Header("n", False))
    with pytest.raises(BadInputError, match="above zero"):
        bad = replace(law.left, slope_m_per_N=-2e-4)
        from_law(RadiusLaw(bad, law.right), Vehicle(), Encoder(), Header("n", False))
    narrow = from_law(law, Vehicle(), Encoder(wrap_bits=8), Header("n", False))
    assert narrow.limits.max_step.value < 0.02
    with pytest.raises(BadInputError, match="half a wrap"):
        narrow.changed(limits=narrow.limits.model_dump() | {"max_step": {"value": 0.5, "unit": "m"}})


def test_load_points_are_the_means_of_runs_that_agree_to_a_newton() -> None:
    points = load_points([300.1, 299.9, 800.0, np.nan], [310.0, 310.2, 700.0, 1.0])
    assert set(points) == {"L300 R310", "L800 R700"}
    # atol: rounding of a mean of two
    np.testing.assert_allclose(points["L300 R310"], (300.0, 310.1), rtol=0, atol=1e-9)
    many = np.arange(200.0, 400.0)
    assert load_points(many, many) == {}


def test_a_payload_weighed_many_times_is_one_load_point() -> None:
    """Five payloads weighed twelve times with 1.5 N scatter are five points, each the mean of its weighings."""
    rng = np.random.default_rng(3)
    true = np.repeat([300.0, 450.0, 600.0, 750.0, 900.0], 12)
    left, right = (true + rng.normal(0.0, 1.5, len(true)) for _ in range(2))
    points = load_points(left, right)
    assert len(points) == 5
    expected = [(left[true == load].mean(), right[true == load].mean()) for load in np.unique(true)]
    # atol: rounding of a mean of twelve
    np.testing.assert_allclose(list(points.values()), expected, rtol=0, atol=1e-9)


def test_steps_of_payload_finer_than_a_scale_remain_steps() -> None:
    """Loads 4 N apart over 60 N are no scatter of one load; on a vehicle a tenth as heavy, 2 N are a step."""
    steps = np.repeat(np.arange(300.0, 360.0, 4.0), 3)
    assert len(load_points(steps, steps)) == 15
    assert len(load_points([30.0, 32.0], [30.0, 32.0])) == 2
    assert len(load_points([300.0, 302.0], [300.0, 302.0])) == 1


def test_what_a_file_lacks_or_has_wrong_is_said_in_plain_words() -> None:
    with pytest.raises(ValidationError) as lacking:
        EffectSection.model_validate({})
    assert first_fault(lacking.value)[1:] == ("nothing", "a value")
    with pytest.raises(ValidationError) as wrong:
        EffectSection.model_validate(dict.fromkeys(EffectSection.model_fields, 3))
    assert not first_fault(wrong.value)[2].startswith("Input")


def test_loads_are_refused_where_the_law_itself_is_written(law: RadiusLaw) -> None:
    file = from_law(law, Vehicle(), Encoder(), Header("n", False))
    for to in ("json", "c", "c_effects"):
        with pytest.raises(BadInputError, match="leave it out"):
            export(file, to, ExportOptions(loads=(LoadPair(400.0, 400.0),)))
