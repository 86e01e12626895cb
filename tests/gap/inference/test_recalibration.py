"""Which calibration parameters are off beside effects, against dense closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.gap.effects import Effect
from calib.gap.effects.radii import DIRECTIONS, TYPICAL, TemperatureRadius
from calib.gap.effects.turning import LoadDependentTrack
from calib.gap.inference import recalibration, scalar_products
from calib.gap.inference.fit import CALIBRATION_SD, fit
from calib.gap.inference.least_squares import LinearSystem
from calib.gap.inference.marginal_likelihood import FLOOR_DOF
from calib.gap.inference.recalibration import (
    ATTRIBUTED_SHIFT_SHARE,
    MIN_EFFECT_SD,
    NAMES,
    SUBSETS,
    Recalibration,
    SubsetWeights,
    judge_recalibration,
    weigh_subsets,
    without_unidentified,
)
from calib.gap.plan import noise_at
from calib.gap.predict import predict
from tests.gap.effects.making import Motion, Run, rich_runs, situation

ALIASES = ("rangefinder_scale", "beam_misalignment")
SHIFTS = {"temperature_radius": ("radius_scale",)}


def judged(
    truth: Callable[[Run, Motion], None],
    *,
    effect: Effect | None = None,
    shifts: dict[str, tuple[str, ...]] | None = None,
) -> Recalibration:
    """The judgement on rich runs with instruments that scatter as stated."""
    rng = np.random.default_rng(1)

    def shaken(run: Run, now: Motion) -> None:
        truth(run, now)
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    # the made steering angle jumps within a step, which the front channels would show
    s = situation([replace(run, front=False) for run in rich_runs()], truth=shaken)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    forms = [] if effect is None else effect.forms(s)
    fitted = fit(nominal, noise, forms, steps=8)
    system, effects = LinearSystem(fitted, nominal, noise, forms), tuple(form.effect for form in forms)
    search = SimpleNamespace(fitted=fitted, system=system, effects=effects, alternatives=(), gains=0.0)
    return judge_recalibration(search, shifts or {})  # type: ignore[arg-type]


def radius_scale(run: Run, now: Motion) -> None:
    now.left = now.right = 0.004


def unequal_radii(run: Run, now: Motion) -> None:
    now.left, now.right = -0.0015, 0.0015


def track_width(run: Run, now: Motion) -> None:
    now.track = 0.015


TRUE = {"radius_scale": 0.004, "unequal_radii": 0.003, "track_width": 0.015}


@pytest.mark.parametrize("truth", [radius_scale, unequal_radii, track_width], ids=NAMES)
def test_the_parameter_that_is_off_is_named_alone(truth: Callable[[Run, Motion], None]) -> None:
    made = judged(truth)
    name = truth.__name__
    assert made.subsets[0] == made.needed == (name,)
    assert made.probability(name) > 0.95
    expected = np.array([TRUE[name] if one == name else 0.0 for one in NAMES])
    # four standard uncertainties
    np.testing.assert_allclose((made.values - expected) / made.sd, 0.0, atol=4)
    np.testing.assert_allclose(made.probabilities.sum(), 1.0, rtol=1e-12)


def test_two_parameters_off_are_both_named() -> None:
    def both(run: Run, now: Motion) -> None:
        radius_scale(run, now)
        track_width(run, now)

    assert judged(both).subsets[0] == ("radius_scale", "track_width")


def test_a_sound_calibration_names_none() -> None:
    assert judged(lambda run, now: None).subsets[0] == ()


def warm(run: Run, now: Motion) -> None:
    now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 15.0)


def test_a_temperature_counted_from_another_zero_is_no_recalibration() -> None:
    """Counted from 15 degrees instead of the mean, both radii are off by a constant that belongs to the effect."""
    assert judged(warm, effect=TemperatureRadius(), shifts=SHIFTS).subsets[0] == ()
    # the control: unless the effect says so, the constant is named
    assert judged(warm, effect=TemperatureRadius()).subsets[0] == ("radius_scale",)


def test_a_shift_beyond_the_effect_is_a_recalibration_all_the_same() -> None:
    """A zero point explains no more than the effect's own size."""

    def more(run: Run, now: Motion) -> None:
        warm(run, now)
        now.left = now.right = now.left + 0.015

    assert judged(more, effect=TemperatureRadius(), shifts=SHIFTS).subsets[0] == ("radius_scale",)


@pytest.mark.parametrize(("zero_N", "named"), [(600.0, ()), (0.0, ()), (1000.0, ()), (-300.0, ("track_width",))])
def test_a_track_is_that_of_a_load_which_a_vehicle_can_bear_or_off_by_itself(
    zero_N: float, named: tuple[str, ...]
) -> None:
    """The model may hold at another load than its reference load (600 N), but at none below zero."""

    def loaded(run: Run, now: Motion) -> None:
        now.track = 4e-5 * (run.load_left_N + run.load_right_N - zero_N)

    shifts = {"load_dependent_track": ("track_width",)}
    made = judged(loaded, effect=LoadDependentTrack(), shifts=shifts)
    assert made.likeliest == named
    # all of it is in the fit, named or not
    assert made.values[2] == pytest.approx(4e-5 * (600.0 - zero_N), abs=4 * made.sd[2])


#: rounding of sums over some hundred rows, in log-evidence units
ROUNDING = 1e-6
#: without a lack of fit, and with the evidence as it is
#: of one subset of so many: 0.3, 0.15 and 0.075 for all of a size together, of which there are 5, 5 and 1
PRIOR_ODDS = (1.0, 0.06, 0.03, 0.075)


@pytest.mark.parametrize(("named", "off"), [(True, ("radius_scale",)), (False, ())])
def test_a_parameter_shares_its_probability_with_its_aliases_beside_a_named_effect(
    monkeypatch: pytest.MonkeyPatch, named: bool, off: tuple[str, ...]
) -> None:
    """A law and larger radii, or the law and one of two instruments' scales, each 0.8 times as likely: one is at work.

    Where the others explain the law as well, nothing needs the radii.
    """
    weights = {probability: np.full(len(SUBSETS), -30.0) for probability in (0, 1)}
    weights[0][SUBSETS.index(())] = weights[1][SUBSETS.index((0,))] = 0.0
    judged_beside = iter([weights[1], weights[0], weights[0]])
    monkeypatch.setattr(recalibration, "weigh_subsets", lambda *_: SubsetWeights(next(judged_beside), 0.0))
    monkeypatch.setattr(recalibration, "free_estimates", lambda *_: ((), (), ()))
    s = situation([replace(run, front=False) for run in rich_runs()], truth=warm)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    forms = TemperatureRadius().forms(s)
    fitted = fit(nominal, noise, forms, steps=8)
    system = SimpleNamespace(
        forms=[SimpleNamespace(effect=name) for name in ("temperature_radius", *ALIASES)],
        nominal=nominal,
        noise=noise,
    )
    others = [((0, 1), 0.8), ((0, 2), 0.8)] if named else [((1,), 0.8), ((2,), 0.8)]
    search = SimpleNamespace(
        fitted=fitted, system=system, effects=("temperature_radius",), alternatives=others, gains=0.0, weighting=None
    )
    made = judge_recalibration(search, {})  # type: ignore[arg-type]
    assert made.likeliest == off
    assert made.instead["radius_scale"] == ALIASES


def _system() -> LinearSystem:
    rng = np.random.default_rng(3)

    def truth(run: Run, now: Motion) -> None:
        now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 20.0)
        now.laser_m, now.end_x_m, now.end_y_m = rng.normal(0, [0.0015, 0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    s = situation([replace(run, front=False) for run in rich_runs()], truth=truth)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    forms = TemperatureRadius().forms(s)[:1]
    return LinearSystem(fit(nominal, noise, forms, steps=8), nominal, noise, forms)


def _log_density(gap: np.ndarray, columns: np.ndarray) -> float:
    """Student's t whose scale matrix is I + X X^T, without its constant."""
    covariance = np.eye(len(gap)) + columns @ columns.T
    square = gap @ np.linalg.solve(covariance, gap)
    return float(-0.5 * (FLOOR_DOF + len(gap)) * np.log1p(square / FLOOR_DOF) - 0.5 * np.linalg.slogdet(covariance)[1])


def _of_subset(gap: np.ndarray, fixed: np.ndarray, unit: np.ndarray, times: np.ndarray) -> float:
    """The density with these columns at their common scale, its prior and the choice of the scale paid for."""
    if not len(times):
        return _log_density(gap, fixed)
    scale = np.clip(np.sqrt(np.mean(times**2)), 0.1, 10.0)
    return _log_density(gap, np.concatenate([fixed, scale * unit], axis=1)) + np.log(PRIOR_ODDS[len(times)] / 4.0)


def test_each_subset_weighs_what_its_density_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Log weights beside a form are those of the dense normal model, up to one constant; so is the free calibration."""
    monkeypatch.setattr(recalibration, "TOLERANCE", 1e-9)
    monkeypatch.setattr(scalar_products, "PRIOR_REST", 1e-300)
    system = _system()
    size, values = np.array([2.0]), np.array([0.002, 0.001, 0.02])
    weights = weigh_subsets(system, [0], [size], values, np.eye(5), {"temperature_radius": ("radius_scale",)})
    directions = (system.calibration / CALIBRATION_SD) @ DIRECTIONS.T
    contribution = system.of(0) @ size
    excused = (
        directions[:, :1] / np.linalg.norm(directions[:, 0]) * ATTRIBUTED_SHIFT_SHARE * np.linalg.norm(contribution)
    )
    fixed = np.concatenate([system.calibration[:, 3:], system.of(0) * MIN_EFFECT_SD, excused], axis=1)
    unit, times = directions * TYPICAL, values / TYPICAL
    expected = np.array([_of_subset(system.gap, fixed, unit[:, list(k)], times[list(k)]) for k in SUBSETS])
    # one wheel's radius alone, or beside the track, is what a scale and a ratio do together
    wheels = system.calibration[:, :2] / CALIBRATION_SD[:2] * TYPICAL[0]
    of_wheels = (values @ DIRECTIONS)[:2] / TYPICAL[0]
    for beside, place in (([], SUBSETS.index((0, 1))), ([2], SUBSETS.index((0, 1, 2)))):
        for wheel in (0, 1):
            columns = np.concatenate([unit[:, beside], wheels[:, [wheel]]], axis=1)
            sizes = np.concatenate([times[beside], of_wheels[[wheel]]])
            expected[place] = np.logaddexp(expected[place], _of_subset(system.gap, fixed, columns, sizes))
    free = _log_density(system.gap, np.concatenate([fixed, system.calibration[:, :3]], axis=1))
    assert weights.each - weights.free == pytest.approx(expected - free, abs=ROUNDING)
    assert weights.over_free == pytest.approx(np.log(np.exp(expected - free).sum()), abs=ROUNDING)


def test_probabilities_are_weights_over_their_sum() -> None:
    each = np.log(np.arange(1.0, 9.0)) - 700.0
    weights = SubsetWeights(each, free=-699.0)
    assert weights.probabilities == pytest.approx(np.arange(1.0, 9.0) / 36.0)
    assert weights.over_free == pytest.approx(np.log(36.0) - 1.0)


def test_a_parameter_that_is_no_likelier_for_the_data_is_not_held_to_be_off() -> None:
    """Straight runs say nothing of ratio and track: what the prior alone makes of them is no finding.

    The prior odds of the subsets, one wheel's radius as a way of its own, in own code: 0.3 / 5 for each of one, 0.15 /
    5 for each of two, 0.075 for all three; both radii off in scale and in ratio may also be one wheel's, twice.
    """
    _, one, two, three = PRIOR_ODDS
    prior = np.array([1.0, one, one, one, two + 2 * one, two, two, three + 2 * two])
    speaks = np.array([0 in subset for subset in SUBSETS], dtype=float)
    silent = prior * speaks / (prior * speaks).sum()
    assert SUBSETS[int(np.argmax(silent))] != (0,)
    assert without_unidentified(SUBSETS[int(np.argmax(silent))], silent) == (0,)
    louder = prior * np.array([10.0 ** len(subset) for subset in SUBSETS])
    assert without_unidentified((0, 1, 2), louder / louder.sum()) == (0, 1, 2)
