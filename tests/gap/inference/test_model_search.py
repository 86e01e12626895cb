"""The search: the truth comes first where evidence is plenty; impossible signs and excluded effects do not come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from calib.gap.effects.library import library
from calib.gap.inference import local_search
from calib.gap.inference.fit import fit
from calib.gap.inference.local_search import SearchResult
from calib.gap.inference.model_search import _most_probable, _WeighedModels, search
from calib.gap.plan import noise_at
from calib.gap.predict import predict
from calib.types import FloatArray
from tests.gap.effects.making import MODEL, RADIUS_M, Motion, Run, rich_runs, situation

Truth = Callable[[Run, Motion], None]


@cache
def searched(truth: Truth, exclude: tuple[str, ...] = (), seed: int = 2) -> SearchResult:
    """The search on rich runs with instruments that scatter as stated, made once; nobody changes it."""
    rng = np.random.default_rng(seed)

    def shaken(run: Run, now: Motion) -> None:
        truth(run, now)
        now.laser_m += rng.normal(0, 0.0015)
        now.end_x_m, now.end_y_m = rng.normal(0, [0.002, 0.002])
        now.end_rad = rng.normal(0, 0.0008)

    runs = [replace(run, front=False) for run in rich_runs()]
    for run in runs[::6]:
        # another length: an offset of the laser is no scale of it
        run.pieces = [(5.0, 0.0)]
    s = situation(runs, truth=shaken)
    nominal = predict(s)
    noise = noise_at(nominal, {})
    return search(nominal, noise, fit(nominal, noise), library(s, exclude=exclude))


def load_radius(run: Run, now: Motion) -> None:
    now.left = 1.2e-6 / RADIUS_M * (run.load_left_N - MODEL.reference_load_N)
    now.right = 0.7e-6 / RADIUS_M * (run.load_right_N - MODEL.reference_load_N)


def temperature_radius(run: Run, now: Motion) -> None:
    now.left = now.right = 3e-4 * (run.numbers["temperature_C"] - 20.0)


def rangefinder_offset(run: Run, now: Motion) -> None:
    now.laser_m = 0.05


def humidity(run: Run, now: Motion) -> None:
    now.right = 0.02 * (run.numbers["humidity"] - 0.5)


def two(run: Run, now: Motion) -> None:
    temperature_radius(run, now)
    rangefinder_offset(run, now)


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        (load_radius, ("load_radius",)),
        (temperature_radius, ("temperature_radius",)),
        (rangefinder_offset, ("rangefinder_offset",)),
        (humidity, ("covariate:humidity",)),
        (two, ("rangefinder_offset", "temperature_radius")),
    ],
)
def test_with_plenty_of_evidence_the_truth_comes_first(truth: Truth, expected: tuple[str, ...]) -> None:
    """Effects many noise levels large, alone or two at once, on runs that vary everything."""
    found = searched(truth)
    assert found.effects == expected
    assert found.models[0] == expected
    assert found.probabilities[0] == found.probabilities.max() > 0.5
    assert found.probabilities.sum() == pytest.approx(1.0)
    assert list(found.probabilities) == sorted(found.probabilities, reverse=True)
    inclusion = found.inclusion()
    assert all(inclusion[name] > 0.5 for name in expected)


def test_noise_beside_a_strong_effect_seldom_looks_like_a_rest() -> None:
    """Of one in twenty draws a lack of fit may be said; two and more of four are then no chance (1.4 %)."""
    assert sum(searched(load_radius, seed=seed).rest > 0.5 for seed in range(2, 6)) < 2


def test_two_causes_are_found_among_the_pairs_of_the_likeliest_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As among all pairs: of a large library only those of so many effects are tried."""
    monkeypatch.setattr(local_search, "PAIRED", 4)
    assert searched.__wrapped__(two).effects == ("rangefinder_offset", "temperature_radius")


def scrub(run: Run, now: Motion) -> None:
    # nine tenths of it look like another track: the residual beside that shows by five noise levels
    now.track = 5e-4 * np.abs(now.kappa)


def test_an_effect_that_explains_a_shift_of_the_calibration_comes_before_it() -> None:
    """One cause for all of it is likelier than a calibration that is off and a smaller cause beside it."""
    found = searched(scrub)
    assert found.effects == ("curve_scrub",)
    assert found.inclusion()["curve_scrub"] > 0.5


def unequal(run: Run, now: Motion) -> None:
    now.left, now.right = -2e-3, 2e-3


def wide(run: Run, now: Motion) -> None:
    now.track = 0.016


def one_wheel(run: Run, now: Motion) -> None:
    now.right = 4e-3


@pytest.mark.parametrize("truth", [unequal, wide, one_wheel])
def test_a_calibration_that_is_off_is_no_effect(truth: Truth) -> None:
    """What a recalibration explains alone, no effect that could imitate it explains better."""
    found = searched(truth)
    assert found.effects == ()
    assert found.models[0] == ()
    assert found.nothing > 0.5


def test_something_that_is_off_gets_its_likeliest_name() -> None:
    """Where a gap is probable, the most probable cause is present, though each alone be less likely than none."""

    def faint(run: Run, now: Motion) -> None:
        now.track = 3e-4 * np.abs(now.kappa)

    found = searched(faint)
    assert found.nothing < 0.5
    assert found.effects == ("curve_scrub",)


@dataclass
class Sets:
    """A search that only knows which set is present, and which one is the most probable about its path."""

    current_effects: tuple[str, ...]

    def by_effects(self, models: list[tuple[str, ...]], probability: FloatArray) -> dict[tuple[str, ...], float]:
        return dict(zip(models, probability.tolist(), strict=True))

    def best_form(self, effects: tuple[str, ...], models: object, probability: object) -> tuple[str, ...]:
        return effects

    def with_current(self, model: tuple[str, ...]) -> Sets:
        return Sets(model)


@pytest.mark.parametrize("other", [("b",), ("b", "c")])
@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("better", [True, False])
def test_of_sets_that_take_turns_the_smallest_or_the_likeliest_about_its_own_path_is_kept(
    other: tuple[str, ...], first: bool, better: bool
) -> None:
    """Each is most probable about the other's path: the fewer effects win, then the own path, from any start."""
    each = {("a",): other, other: ("a",)}

    def weigh(local: Sets) -> _WeighedModels:
        models = [each[local.current_effects], local.current_effects]
        at_hand = 1.0 if (local.current_effects == other) is better else 0.0
        return _WeighedModels(models, np.array([[0.6, 0.4]]), np.array([True]), 1.0, at_hand, np.zeros((2, 1)))  # type: ignore[arg-type]

    start = Sets(("a",) if first else other)
    settle = lambda local, fitted: (local, None)  # noqa: E731
    kept, _, _ = _most_probable(start, None, False, settle, weigh)  # type: ignore[arg-type, return-value]
    assert kept.current_effects == (other if better and len(other) == 1 else ("a",))


def test_a_set_whose_fit_runs_away_is_not_moved_to() -> None:
    def weigh(local: Sets) -> _WeighedModels:
        return _WeighedModels([("b",), ("a",)], np.array([[0.6, 0.4]]), np.array([True]), 1.0, 0.0, np.zeros((2, 1)))  # type: ignore[list-item]

    kept, _, _ = _most_probable(Sets(("a",)), None, False, lambda local, fitted: None, weigh)  # type: ignore[arg-type]
    assert kept.current_effects == ("a",)


def test_without_a_gap_nothing_comes_first() -> None:
    found = searched(lambda run, now: None)
    assert found.effects == ()
    assert found.rest < 0.5
    assert found.nothing > 0.5


def hidden(run: Run, now: Motion) -> None:
    """A share of the radii that no column of the run table tells: another by load and speed, in no order."""
    now.left = now.right = 4e-3 * np.sin(37.0 * run.load_left_N + 91.0 * run.speed_mps)


def test_a_large_cause_keeps_its_probability_beside_a_rest() -> None:
    """What no effect describes is the lack of fit; it does not take the probability of the cause beside it."""

    def both(run: Run, now: Motion) -> None:
        rangefinder_offset(run, now)
        hidden(run, now)
        now.right = now.left

    found = searched(both)
    assert found.rest > 0.9
    assert found.inclusion()["rangefinder_offset"] > 0.9
    alone = searched(hidden)
    assert alone.rest > 0.9
    assert alone.inclusion().get("rangefinder_offset", 0.0) < 0.5


def gained(run: Run, now: Motion) -> None:
    now.left = -6e-3 * (run.speed_mps - 0.3)


def test_a_sign_that_cannot_be_is_left_out() -> None:
    """Counts are lost, never gained: a left wheel that loses with speed is found, one that gains is something else."""

    def lost(run: Run, now: Motion) -> None:
        now.left = 6e-3 * (run.speed_mps - 0.3)

    assert searched(lost).inclusion()["lost_counts"] > 0.3
    found = searched(gained)
    for form, theta in zip(found.fitted.forms, found.fitted.theta, strict=True):
        assert all(p.sign * size >= 0 for p, size in zip(form.parameters, theta, strict=True))
        assert "left wheel, share" not in form.label


def test_an_excluded_effect_is_in_no_hypothesis_and_leaves_an_unknown_behind() -> None:
    """Without its cause in the library, a gap of the temperature is not called nothing."""
    found = searched(temperature_radius, exclude=("temperature_radius",))
    assert all("temperature_radius" not in model for model in found.models)
    assert "temperature_radius" not in found.forms
    assert found.effects or found.rest > 0.5
    assert found.nothing < 0.5


def test_a_step_that_lasts_is_two_sizes_and_no_wear() -> None:
    """A step for each session has as many sizes as sessions, and wear, which has two, took its place."""

    def lasting(run: Run, now: Motion) -> None:
        now.left = now.right = 1e-3 * (run.session != rich_runs()[0].session)

    (form,) = searched(lasting).fitted.forms
    assert (form.effect, len(form.parameters)) == ("session_step", 2)
    assert form.label.startswith("from ")
