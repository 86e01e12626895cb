"""Uncertainty that is the same in every run enters every interval and does not average out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.errors import CalibError
from calib.radius.effective import declared_sources
from calib.radius.fit import fit_campaign
from calib.radius.result import Fit
from tests.campaign.making import campaign

SCALE = 2e-4


def declared(**sections: dict[str, object]) -> Campaign:
    return replace(campaign(), extra={"uncertainty": sections})


def std_radius(fit: Fit) -> float:
    return float(np.sqrt(fit.left.law.covariance[0, 0]))


def test_nothing_declared_changes_nothing() -> None:
    plain, empty = fit_campaign(campaign()), fit_campaign(replace(campaign(), extra={"uncertainty": {}}))
    assert plain.to_dict() == empty.to_dict()


def test_a_scale_of_the_rangefinder_scales_radius_and_slope() -> None:
    """R = S / (2 pi n): a relative error of S is one of r at every load, so that its covariance is u^2 c c^T."""
    plain, with_scale = fit_campaign(campaign()), fit_campaign(declared(rangefinder={"scale": {"std": SCALE}}))
    law = plain.left.law
    c = SCALE * np.array([law.radius_ref_m, law.slope_m_per_N])
    more = with_scale.left.law.covariance - law.covariance
    # rtol: the runs scatter about their line, and the scale acts on the runs
    np.testing.assert_allclose(more, np.outer(c, c), rtol=2e-3)


def test_it_is_the_effect_of_an_actual_error() -> None:
    """The sensitivity against a campaign whose distances are all longer by one standard uncertainty."""
    plain = campaign()
    for section, key, unit, change in (
        ("rangefinder", "scale", 1e-4, lambda d: d * (1 + 1e-4)),
        ("rangefinder", "offset_m", 1e-3, lambda d: d + 1e-3 * np.sign(d)),
    ):
        numbers = {**plain.runs.numbers, "distance_m": change(plain.runs.number("distance_m"))}
        biased = fit_campaign(replace(plain, runs=replace(plain.runs, numbers=numbers)))
        fit = fit_campaign(declared(**{section: {key: {"std": unit}}}))
        shift = biased.left.estimate.coefficients - fit.left.estimate.coefficients
        # rtol: the path corrections change in second order; atol: ordinary least squares stands for the weights of the
        # sessions, which for an offset moves the slope by less than a ten-thousandth of it
        np.testing.assert_allclose(fit.left.estimate.systematic[0], shift, rtol=5e-3, atol=1e-10)


def test_more_runs_do_not_make_it_smaller() -> None:
    """Four times the runs halve the random part and leave the systematic one."""
    entry = {"rangefinder": {"scale": {"half_width": SCALE, "distribution": "rectangular"}}}
    small = replace(campaign(runs_per_load=3), extra={"uncertainty": entry})
    large = replace(campaign(runs_per_load=12), extra={"uncertainty": entry})
    least = SCALE / np.sqrt(3.0) * fit_campaign(small).left.law.radius_ref_m
    random_parts = []
    for one in (small, large):
        fit = fit_campaign(one)
        assert std_radius(fit) >= least
        low, high = fit.left.radius_ref_ci95_m
        assert 0.5 * (high - low) >= 1.95 * least  # 1.96, the normal's, at infinitely many degrees of freedom
        random_parts.append(float(np.sqrt((fit.left.estimate.cov_within + fit.left.estimate.cov_between)[0, 0])))
    assert random_parts[1] < 0.75 * random_parts[0]  # one half, known from few sessions


def test_a_beam_off_the_way_counts_in_second_order() -> None:
    """A beam at the angle a measures S / cos a: a half width of 10 mrad moves radii by a^2 / sqrt(20) at most."""
    fit = fit_campaign(declared(rangefinder={"beam_rad": {"half_width": 0.01, "distribution": "rectangular"}}))
    relative = fit.left.estimate.systematic[0, 0] / fit.left.law.radius_ref_m
    np.testing.assert_allclose(relative, 0.01**2 / np.sqrt(20.0), rtol=1e-3)  # runs scatter about their line


def test_a_scale_of_the_weighing_moves_slope_and_centre() -> None:
    fit = fit_campaign(declared(weighing={"scale": {"std": 0.01}, "offset_N": {"std": 2.0}}))
    law = fit.left.law
    expected = -law.slope_m_per_N * np.array([[0.01 * law.reference_load_N, 0.01], [2.0, 0.0]])
    np.testing.assert_allclose(fit.left.estimate.systematic[:2], expected, rtol=1e-12)


def test_bands_hold_it_too() -> None:
    plain, more = fit_campaign(campaign()), fit_campaign(declared(rangefinder={"scale": {"std": SCALE}}))
    for single_run in (False, True):
        widths = [
            np.subtract(*reversed(fit.left.band_m([300.0, 700.0], single_run=single_run))) for fit in (plain, more)
        ]
        assert (widths[1] > widths[0]).all()


def test_the_fit_is_read_back_with_it() -> None:
    fit = fit_campaign(declared(rangefinder={"scale": {"std": SCALE, "type": "A", "dof": 9}}))
    again = Fit.from_dict(fit.to_dict())
    assert again.to_dict() == fit.to_dict()
    np.testing.assert_array_equal(again.left.estimate.systematic, fit.left.estimate.systematic)


def test_the_budget_names_each_source_with_type_and_distribution() -> None:
    fit = fit_campaign(declared(rangefinder={"scale": {"half_width": SCALE, "distribution": "triangular"}}))
    line = fit.radii.budget[-1]
    assert (line.name, line.kind, line.distribution) == ("rangefinder: scale", "B", "triangular")
    np.testing.assert_allclose(line.std_left_m, SCALE / np.sqrt(6) * float(np.mean(fit.left.radius_m)), rtol=1e-9)


@pytest.mark.parametrize(
    "section",
    [
        5,
        {"laser": {"scale": {"std": 1e-4}}},
        {"rangefinder": {"scail": {"std": 1e-4}}},
        {"rangefinder": {"scale": 1e-4}},
        {"rangefinder": {"scale": {}}},
        {"rangefinder": {"scale": {"std": -1e-4}}},
        {"rangefinder": {"scale": {"std": float("nan")}}},
        {"rangefinder": {"scale": {"std": 1e-4, "half_width": 1e-4}}},
        {"rangefinder": {"scale": {"std": 1e-4, "distribution": "flat"}}},
    ],
)
def test_what_cannot_be_understood_is_refused(section: object) -> None:
    with pytest.raises(CalibError, match="uncertainty"):
        declared_sources(replace(campaign(), extra={"uncertainty": section}))
