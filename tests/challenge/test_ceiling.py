"""The ceiling: what the best rule can reach, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calib.challenge import cases
from calib.challenge.cases import ceiling_of

#: standard error of a share over 4,000 draws is at most 0.008; three of them
DRAWN = 0.025
#: each of two
EVEN = 0.5


@pytest.fixture(autouse=True)
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw so often that shares are known to `DRAWN`."""
    monkeypatch.setattr(cases, "DRAWS", 4000)


def _phi(x: float) -> float:
    return 0.5 * (1 + math.erf(x / math.sqrt(2)))


@pytest.mark.parametrize("apart", [0.5, 1.0, 2.0, 4.0])
def test_two_effects_are_told_apart_as_often_as_their_distance_allows(
    monkeypatch: pytest.MonkeyPatch, apart: float
) -> None:
    """Two effects of known sign, d standard deviations apart: Phi(d / 2)."""
    monkeypatch.setattr(cases, "ONE_SIGN", ("a", "b"))
    signal = 8.0
    angle = 2 * math.asin(apart / (2 * signal))
    one, other = np.array([[1.0], [0.0], [0.0]]), np.array([[math.cos(angle)], [math.sin(angle)], [0.0]])
    reached = ceiling_of({"a": [one], "b": [other]}, signal, np.random.default_rng(1))
    assert reached is not None
    assert reached.free == pytest.approx(_phi(apart / 2), abs=DRAWN)


def test_an_exact_alias_halves_it() -> None:
    """Of three effects two are one: the best rule gets the third, and every second of the pair."""
    same, third = np.array([[1.0], [0.0]]), np.array([[0.0], [1.0]])
    reached = ceiling_of({"a": [same], "b": [2 * same], "c": [third]}, 12.0, np.random.default_rng(2))
    assert reached is not None
    assert reached.free == pytest.approx(2 / 3, abs=DRAWN)


def test_without_a_signal_only_chance_is_left_and_the_gate_lets_five_per_cent_through() -> None:
    """Of n orthogonal effects 1 / n at a signal of zero, and 5 % of that behind the gate."""
    effects = {str(number): [np.eye(10)[:, [number]]] for number in range(10)}
    reached = ceiling_of(effects, 1e-6, np.random.default_rng(3))
    assert reached is not None
    assert reached.free == pytest.approx(0.1, abs=1e-3)
    assert reached.gated == pytest.approx(0.005, abs=1e-3)


def test_a_strong_signal_of_effects_apart_reaches_it_all() -> None:
    """Directions in two dimensions each, at a signal of 20: everything is named, gate or no gate."""
    effects = {"a": [np.eye(4)[:, :2]], "b": [np.eye(4)[:, 2:]]}
    reached = ceiling_of(effects, 20.0, np.random.default_rng(4))
    assert reached is not None
    assert min(reached.free, reached.gated) > 0.99


def test_nothing_that_shows_has_no_ceiling() -> None:
    """Effects that a recalibration takes up whole leave nothing to be told apart."""
    assert ceiling_of({"a": [np.zeros((5, 1))]}, 5.0, np.random.default_rng(5)) is None


def test_the_own_ceiling_of_two_effects_a_known_way_apart_is_the_normal_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two effects of one sign d apart, equally likely: the nearer one is named, P = Phi(d / 2), each acts."""
    monkeypatch.setattr(cases, "ONE_SIGN", ("a", "b"))
    signal, angle = 4.0, 0.6
    one, other = np.array([[1.0], [0.0]]), np.array([[np.cos(angle)], [np.sin(angle)]])
    apart = signal * np.sqrt(2.0 - 2.0 * np.cos(angle))
    for effect, left in (("a", one[:, 0]), ("b", other[:, 0])):
        rng = np.random.default_rng(6)
        known = {"a": [one], "b": [other]}
        reached = ceiling_of(known, signal, rng, (effect, left))
        assert reached.free == pytest.approx(_phi(apart / 2), abs=DRAWN)
        assert reached.gated <= reached.free


def test_of_effects_that_leave_the_same_each_is_named_as_often_and_one_of_one_sign_goes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By hand: two exact aliases share the cases; where one of them has one sign only, its density there is twice."""
    line = np.array([[1.0], [1.0], [0.0]])
    alike = {"a": [line], "b": [3.0 * line]}
    strong = 20.0
    for effect in alike:
        assert ceiling_of(alike, strong, np.random.default_rng(7), (effect, line[:, 0])).free == EVEN
    monkeypatch.setattr(cases, "ONE_SIGN", ("b",))
    named = [ceiling_of(alike, strong, np.random.default_rng(8), (e, line[:, 0])) for e in alike]
    assert [reached.free for reached in named] == [0.0, 1.0]


def test_an_effect_outside_the_library_is_known_by_what_it_leaves() -> None:
    """A direction of its own, far from the library's: a strong one is always named."""
    left = np.array([0.0, 0.0, 1.0])
    reached = ceiling_of({"a": [np.eye(3)[:, :1]]}, 15.0, np.random.default_rng(9), ("zone", left))
    assert reached.free == reached.gated == 1.0
