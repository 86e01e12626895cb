"""A fix is recommended where it helps beyond noise, harms nowhere and is determined; else `why` says what lacks."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.gap.decision import Trial
from calib.gap.decision.causes import Finding, _means
from calib.gap.decision.constancy import SizeDifference
from calib.gap.decision.diagnosis import Cause, Fix, Quantity, Unexplained
from calib.gap.decision.fix import (
    PLAN,
    alternatives,
    elsewhere,
    harmed,
    holds_zero,
    opened,
    ranked,
    reasons,
    shown_by_many,
)
from calib.gap.decision.held_out import ChannelClosure, Closure, Improvement
from calib.gap.effects import Form, Parameter, always
from calib.gap.effects.library import effect_class
from calib.gap.effects.radii import NAMES
from calib.gap.observations import Channel
from calib.kinematics.readings import PLAUSIBLE_CHANGE, PLAUSIBLE_TRACK_CHANGE

#: nine tenths of the gap close for certain
CLOSES = Improvement(5.0, 1.2, (3.5, 4.1), (0.9, 1.0))
#: a signal of ten: it helps for certain, and how much it closes cannot be told
SMALL = Improvement(1.25, 1.02, (0.1, 0.35), (0.4, 1.6))


def cause(name: str = "load_radius", low: float = 1.0, high: float = 2.0, signal: float = 30.0) -> Cause:
    size = {"slope": Quantity(0.5 * (low + high), (low, high), "m/N")}
    return Cause(name, "", "", 0.9, share=1.0, signal=signal, parameters=size)


def trial(growth_sd: float, value: str = "square_cw") -> Trial:
    return Trial("kind", value, 0.012, 0.019, growth_sd=growth_sd)


def test_a_fix_that_helps_and_harms_nowhere_has_nothing_against_it() -> None:
    for improvement in (CLOSES, SMALL, replace(CLOSES, closed_ci95=(0.51, 0.7))):
        assert reasons(Finding([cause()], {"load_radius": 0.9}), improvement, [trial(-5.0), trial(1.0)]) == []


def test_of_equally_probable_causes_one_whose_size_may_be_zero_does_not_lead() -> None:
    large, sure = cause("track_width", -1.0, 8.0, 27.0), cause("reference_yaw", 1.0, 2.0, 17.0)
    likely = replace(cause("wear", -1.0, 1.0), probability=0.95)
    assert ranked([large, sure, likely]) == [likely, sure, large]


def test_what_no_whole_percent_parts_is_equally_probable_and_keeps_its_place() -> None:
    strong, weak = (replace(cause(name), probability=p) for name, p in (("wear", 0.96 - 1e-4), ("reference_yaw", 0.96)))
    ranks = [(each.effect, each.probability) for each in ranked([strong, weak])]
    assert ranks == [
        ("wear", 0.96),
        ("reference_yaw", 0.96),
    ]


def opened_by(before: np.ndarray, after: np.ndarray, levels: np.ndarray) -> list[str]:
    """Return what is said of residuals (n, 6) of so many runs whose noise levels (6,) replicates tell."""
    noise = SimpleNamespace(floor=np.broadcast_to(levels, before.shape), dof=40.0)
    usable = np.broadcast_to(np.arange(6) != Channel.DISTANCE, before.shape)
    return list(opened(usable, noise, before, after))  # type: ignore[arg-type]


def test_a_correction_that_puts_a_channel_off_which_was_right_is_no_fix() -> None:
    """Joints of the floor turn the body: unequal radii close the heading, and the steering angle pays for it."""
    rng, levels = np.random.default_rng(4), np.array([1.0, 2e-3, 3e-3, 4e-3, 3e-3, 2e-3])
    noise = levels * rng.standard_normal((40, 6))
    turned = 1e-2 * np.eye(6)[Channel.STEERING]
    (text,) = opened_by(noise, noise + turned, levels)
    before, after = (1e3 * np.sqrt(np.mean((noise + off)[:, Channel.STEERING] ** 2)) for off in (0.0, turned))
    assert text.startswith(f"held out, steering gets worse from {before:.2f} to {after:.1f} mrad (noise 2 mrad)")


def test_noise_and_errors_that_cancel_in_part_put_no_channel_off() -> None:
    """Sizes fitted to noise alone are off by its share; of two errors the one left may be larger than both."""
    rng, levels = np.random.default_rng(5), np.ones(6)
    said = 0
    for _ in range(200):
        before = rng.standard_normal((20, 6))
        # one size of twenty readings, as uncertain as these leave it
        said += bool(opened_by(before, before + rng.standard_normal(6) / np.sqrt(20.0), levels))
    # expected growth is one square of twenty
    assert said == 0
    gap, other = 3.0 * np.eye(6)[Channel.LATERAL], 0.5 * np.eye(6)[Channel.LATERAL]
    noise = rng.standard_normal((20, 6))
    assert not opened_by(noise + gap, noise + gap + other, levels)
    assert opened_by(noise + gap, noise + gap + 4.0 * other, levels)


@pytest.mark.parametrize(
    ("improvement", "words"),
    [
        (None, "no run could be held out"),
        (replace(CLOSES, improvement_ci95=(-0.1, 0.3)), "an improvement of -0.1 to +0.3: not shown to help"),
        (replace(CLOSES, closed_ci95=(0.4, 0.7)), "closes 40 to 70 % of the gap, where 50 % are to be certain"),
    ],
)
def test_what_does_not_help_enough_is_no_fix(improvement: Improvement | None, words: str) -> None:
    (why,) = reasons(Finding([cause()], {"load_radius": 0.9}), improvement)
    assert words in why


@pytest.mark.parametrize(("low", "said"), [(-1.26, True), (-1e-12, False), (0.05, False)])
def test_a_gap_that_few_conditions_show_is_no_reason_to_correct_all(low: float, said: bool) -> None:
    """Drawn anew, conditions without those few get worse by the fix; what it does nothing to does not."""
    why = shown_by_many(Fix(recommended=True), Closure(ci95=(low, 1.0))).why
    assert [*why] == ["drawn anew from these conditions it closes -126 to 100 %: too few show it; " + PLAN] * said


def test_beside_a_small_unexplained_residual_more_than_half_of_the_gap_closes_for_certain() -> None:
    small = Unexplained(share=0.03, signal=28.0)
    barely = Improvement(11.2, 2.2, (0.04, 11.2), (0.01, 1.93))
    assert reasons(Finding([cause(signal=156.0)], {"load_radius": 0.95}), barely) == []
    (why,) = reasons(Finding([cause(signal=156.0)], {"load_radius": 0.95}, small), barely)
    assert "closes 1 to 193 % of the gap, where 50 % are to be certain" in why
    assert (
        reasons(Finding([cause(signal=156.0)], {"load_radius": 0.95}, small), replace(barely, closed_ci95=(0.64, 1.3)))
        == []
    )


def test_beside_a_channel_that_stays_above_its_noise_more_than_half_of_the_gap_closes_for_certain() -> None:
    """A residual may show on held-out runs that no lack of fit of all runs is probable for."""
    third = replace(CLOSES, closed_ci95=(0.34, 1.04))
    line = ChannelClosure(Channel.DISTANCE, 6.2e-3, 7.3e-3, 2.5e-3, 0.14)
    finding = Finding([cause(signal=156.0)], {"load_radius": 0.95})
    (why,) = reasons(finding, third, closure=Closure(channels=(line,)))
    assert "closes 34 to 104 % of the gap, where 50 % are to be certain" in why
    assert reasons(finding, third, closure=Closure(channels=(replace(line, after_rms=2.6e-3),))) == []
    assert reasons(finding, CLOSES, closure=Closure(channels=(line,))) == []


@pytest.mark.parametrize(
    ("effect", "value", "plausible", "kept_back"),
    [
        ("radius_scale", 2.3, False, 1),
        ("radius_scale", 0.1, False, 0),
        ("track_width", 0.2, False, 0),
        ("track_width", -0.4, False, 1),
        ("track_width", 0.56, True, 0),
    ],
)
def test_a_length_that_no_vehicle_is_off_by_is_no_fix(
    effect: str, value: float, plausible: bool, kept_back: int
) -> None:
    """Feet read as metres make radii 3.3 times their nominal value; `calib geometry` calls 15 % (track 30 %) wrong.

    The effective track of skid steering may be 2.5 times the stated one.
    """
    size = {"relative": Quantity(value, (0.99 * value, 1.01 * value), "1")}
    found = replace(cause(effect), parameters=size, plausible=plausible, family="calibration")
    why = reasons(Finding([found], {effect: 0.96}), CLOSES)
    assert len(why) == kept_back and all("beyond any vehicle's" in text for text in why)


def test_the_bounds_of_lengths_are_those_of_the_geometry() -> None:
    bounds = {name: effect_class(name).wrong_beyond for name in NAMES}
    assert bounds == {**dict.fromkeys(NAMES, PLAUSIBLE_CHANGE), "track_width": PLAUSIBLE_TRACK_CHANGE}


def test_a_size_whose_interval_holds_zero_is_no_fix() -> None:
    """One parameter of several may hold zero: a lever arm ahead has no part to the side."""
    (why,) = reasons(Finding([cause("wear", -1.0, 2.0)], {"wear": 0.9}), CLOSES)
    assert "the interval of wear holds zero (slope -1 to 2 m/N)" in why
    lever = replace(cause(), parameters={**cause().parameters, "y": Quantity(0.0, (-1.0, 1.0), "m")})
    assert reasons(Finding([lever], {"load_radius": 0.9}), CLOSES) == []


def test_causes_that_are_rather_not_all_at_work_are_no_fix() -> None:
    both = [cause("load_radius"), cause("wear")]
    assert reasons(Finding(both, {"load_radius": 0.9, "wear": 0.8}), CLOSES) == []
    (why,) = reasons(Finding(both, {"load_radius": 0.9, "wear": 0.4}), CLOSES)
    assert "all of its causes are at work is 0.36 (load_radius 0.90, wear 0.40)" in why
    (alone,) = reasons(Finding([cause("wear")], {"wear": 0.55}), CLOSES)
    assert "is 0.55 (wear 0.55)" in alone


def test_beside_the_largest_cause_each_is_surer_than_one_alone() -> None:
    """0.9 x 0.7 is 0.63, enough for all together; but the smaller of the two is dropped for little."""
    large, small = replace(cause("load_radius"), share=0.8), replace(cause("wear"), share=0.2)
    assert reasons(Finding([large], {"load_radius": 0.7}), CLOSES) == []
    assert reasons(Finding([large, small], {"load_radius": 0.7, "wear": 0.9}), CLOSES) == []
    (why,) = reasons(Finding([large, small], {"load_radius": 0.9, "wear": 0.7}), CLOSES)
    assert "all of its causes are at work is 0.63" in why


@pytest.mark.parametrize(("share", "signal", "against"), [(0.2, 4.0, 0), (0.2, 6.0, 1), (0.01, 6.0, 0)])
def test_beside_an_unexplained_residual_of_half_its_signal_a_cause_is_no_fix(
    share: float, signal: float, against: int
) -> None:
    """It may be a part of that; a residual of a small share does not matter."""
    found = reasons(Finding([cause(signal=10.0)], {"load_radius": 0.9}, Unexplained(share, signal)), CLOSES)
    assert len(found) == against


@pytest.mark.parametrize(
    ("effect", "times", "low", "against"),
    [
        ("wear", 1.1, 0.4, 1),
        ("wear", 1.1, 0.8, 0),
        ("wear", 3.0, 0.6, 0),
        ("wear", 9.0, 0.93, 1),
        ("wear", 9.0, 0.96, 0),
        ("unequal_radii", 5.0, 0.4, 0),
    ],
)
def test_a_size_beyond_what_is_plausible_has_to_close_the_gap_for_certain(
    effect: str, times: float, low: float, against: int
) -> None:
    """What is left is below half of what the largest size that may be does; radii and track have their own bound."""
    odd = replace(cause(effect), plausible=False, remark="beyond what is physically plausible", times=times)
    why = reasons(Finding([odd], {effect: 0.96}), replace(CLOSES, closed_ci95=(low, 1.2)))
    assert sum("beyond what" in text and f"{100 * low:.0f} to 120 %" in text for text in why) == against


def test_a_size_beyond_what_is_plausible_of_a_cause_that_is_rather_not_at_work_is_no_fix() -> None:
    """However much it closes on these runs: something else does it."""
    odd = replace(cause("wear"), plausible=False, remark="beyond what is physically plausible", times=1.1)
    for probability, against in ((0.4, 1), (0.6, 0)):
        why = reasons(Finding([replace(odd, probability=probability)], {"wear": 0.96}), CLOSES)
        assert sum(f"its probability {probability:.2f}" in text for text in why) == against


def test_causes_that_leave_nothing_to_measure_a_length_are_no_fix() -> None:
    """A tape and a tracking system that agree are not both wrong by one share: the wheels that disagree are."""
    both = [cause("reference_scale"), cause("rangefinder_scale")]
    (why,) = reasons(Finding(both, {"reference_scale": 0.96, "rangefinder_scale": 0.96}), CLOSES)
    assert "nothing is left that measures one" in why
    assert reasons(Finding(both[:1], {"reference_scale": 0.96}), CLOSES) == []


def test_harm_beyond_noise_keeps_a_fix_back_and_is_named_with_its_size() -> None:
    """The limit is that of one false alarm in a hundred campaigns: 2.33 for one trial, 3.09 for ten (normal tables)."""
    (why,) = reasons(Finding([cause()], {"load_radius": 0.9}), CLOSES, [trial(4.2)])
    assert "kind square_cw gets worse from 12 to 19 mm, 4.2 standard deviations beyond noise" in why
    assert harmed([trial(2.4)]) and not harmed([trial(2.2)])
    ten = [trial(3.0), *(trial(0.0, f"route {n}") for n in range(9))]
    assert not harmed(ten)
    assert harmed([*ten[1:], trial(3.2)])


#: a flexible effect (a place of the floor) that follows a weak cause's signal and pays for its parameters
TIED = (("steering_scale", "floor_zone"),)
DIFFERS = {"wear": SizeDifference("wear", "kind", "square_cw", "corridor", 0.3, 0.1, 1e-4)}
LEFT = Unexplained(0.2, 12.0, ())


@pytest.mark.parametrize(
    ("floor_zone", "unexplained", "differing", "counted"),
    [
        (0.004, None, {}, False),
        (0.2, None, {}, True),
        (0.004, LEFT, {}, True),
        (0.004, replace(LEFT, share=0.01), {}, False),
        (0.004, None, DIFFERS, True),
    ],
)
def test_an_alternative_that_holds_nowhere_else_counts_where_it_is_probable_or_odds_mean_nothing(
    floor_zone: float, unexplained: Unexplained | None, differing: dict[str, SizeDifference], *, counted: bool
) -> None:
    # beside the named cause it is no alternative
    models = (("steering_scale",), ("floor_zone",), ("floor_zone", "steering_scale"))
    search = SimpleNamespace(models=models, probabilities=np.array([0.75, floor_zone, 0.2]))
    evidence = SimpleNamespace(search=search, named=("steering_scale",), effects={})
    instead = alternatives(evidence, Finding((), {}, unexplained, differing, TIED))  # type: ignore[arg-type]
    assert bool(elsewhere(["steering_scale"], instead)) is counted


def test_a_law_whose_mean_slope_alone_is_determined_is_sized_by_that() -> None:
    """Straight runs tell the mean of both wheels' slopes, 2e-6 +- 2.5e-7, and nothing of their difference."""
    left = Parameter("slope_left", "m/N", typical=1e-6, largest=6e-6)
    law = Form("load_radius", "", (left, replace(left, name="slope_right")), always())

    def sized(mean: float) -> tuple[dict[str, Quantity], Cause]:
        one = np.ones((2, 2))
        covariance = 1.25e-7**2 * one + 2e-5**2 * (2.0 * np.eye(2) - one)
        means = _means(law, np.full(2, mean), covariance, 2.0)
        wheels = {one.name: Quantity(mean, (mean - 4e-5, mean + 4e-5), "m/N") for one in law.parameters}
        return means, replace(cause("load_radius"), parameters=wheels | means)

    means, named = sized(2e-6)
    assert means["slope_mean"].ci95 == pytest.approx((1.75e-6, 2.25e-6)) and not holds_zero(named)
    means, named = sized(2e-7)
    assert means == {} and holds_zero(named)
