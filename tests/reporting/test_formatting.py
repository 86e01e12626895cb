"""How numbers are written."""

from __future__ import annotations

from decimal import ROUND_HALF_EVEN, Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.reporting import table
from calib.reporting.formatting import (
    MISSING,
    aligned,
    capital,
    fixed,
    measured,
    probability,
    prose,
    span,
    table_lines,
    two_digits,
)


@given(st.floats(min_value=1e-9, max_value=1e9))
def test_an_uncertainty_keeps_two_significant_digits(std: float) -> None:
    """Against decimal arithmetic: rounded at the second significant digit."""
    exact = Decimal(std)
    step = Decimal(1).scaleb(exact.adjusted() - 1)
    expected = (exact / step).quantize(Decimal(1), rounding=ROUND_HALF_EVEN) * step
    assert Decimal(two_digits(std)) == expected


@given(st.floats(min_value=-1e3, max_value=1e3), st.floats(min_value=1e-6, max_value=10))
def test_value_and_uncertainty_end_at_the_same_place(value: float, std: float) -> None:
    text, u = measured(value, std)
    places = len(text.partition(".")[2])
    assert places == len(u.partition(".")[2])
    # atol: half of the last printed digit, and the last bit of the value
    np.testing.assert_allclose(float(text.replace("−", "-")), value, rtol=1e-12, atol=0.5 * 10.0**-places * (1 + 1e-9))


def test_a_negative_zero_is_no_number() -> None:
    assert fixed(-0.00001, 2) == "0.00"
    assert fixed(-1.25, 1) == "−1.2"


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_not_a_number_is_a_dash(value: float | None) -> None:
    assert fixed(value, 2) == two_digits(value) == probability(value) == MISSING


def test_decimal_points_stand_below_each_other() -> None:
    """After filling up, every number has as many places behind the point; a missing point has a blank as wide."""
    made = aligned([("a", "0.16"), ("b", "3.8"), ("c", "18"), ("d", MISSING)], 1)
    assert [len(row[1].replace("\u2008", ".").partition(".")[2]) for row in made[:3]] == [2, 2, 2]
    assert [row[1].strip("\u2007\u2008") for row in made] == ["0.16", "3.8", "18", MISSING]


def test_a_group_of_columns_is_not_parted_where_a_table_is() -> None:
    """Its title stands whole, above all its columns, in the second part, which has the first column too."""
    groups = ("Error of the radius | a (%)", "Error of the radius | b (%)")
    made = table("", ("run", *(f"number{k}" for k in range(7)), *groups), [["1"] * 10])
    lines = [line.text for line in table_lines(made, 84)]
    (titles,) = [number for number, line in enumerate(lines) if "Error" in line]
    assert lines[titles].strip() == "Error of the radius"
    assert lines[titles + 2].split() == ["run", "a", "b"]


def test_spans_of_one_value_are_one_value() -> None:
    assert span(0.5, 0.5, "m/s") == "0.5 m/s"
    assert span(-0.2, 0.2, "m", ".3f") == "−0.200 to 0.200 m"


def test_prose_gets_the_signs_of_print() -> None:
    assert prose("about 3 um at -2 degC, chi2(1) of S_O in m/s^2") == "about 3 µm at −2 °C, χ²(1) of Sₒ in m/s²"
    assert prose("run r-12 of 2025-03-31, album um-x") == "run r-12 of 2025-03-31, album µm-x"


def test_a_sentence_begins_with_a_capital_but_for_a_name() -> None:
    assert capital("the clock runs fast") == "The clock runs fast"
    assert capital("ref_theta_rad: found degrees") == "ref_theta_rad: found degrees"
