"""Causes that follow quantities which went together on the runs driven are ambiguous, and their fix is held back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.gap.decision.confounding import any_probability, calibrated
from calib.gap.decision.decide import _by_family
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.decision.fix import disagreement, parting
from calib.gap.decision.held_out import Closure
from calib.gap.effects.library import effect_class
from tests.gap.effects.making import STRAIGHT, Motion, Run, Truth, campaign

Diagnosing = Callable[..., Diagnosis]
SESSIONS = ("s1", "s2", "s3")


def noisy(truth: Truth, seed: int) -> Truth:
    rng = np.random.default_rng(seed)

    def both(run: Run, now: Motion) -> None:
        truth(run, now)
        now.end_x_m, now.end_y_m, now.end_rad, now.laser_m = rng.normal(0.0, (2e-3, 2e-3, 1e-3, 1.5e-3))

    return both


def worn(run: Run, now: Motion) -> None:
    now.left = now.right = -6e-4 * SESSIONS.index(run.session)


def warmed(run: Run, now: Motion) -> None:
    now.left = now.right = -3e-4 * (run.numbers["temperature_C"] - 20.0)


def at(temperatures_C: tuple[tuple[float, float], ...]) -> list[Run]:
    """Eight straights a session, the two temperatures of the session in turn."""
    return [
        Run(STRAIGHT, session=session, front=False, numbers={"temperature_C": two[number % 2]})
        for session, two in zip(SESSIONS, temperatures_C, strict=True)
        for number in range(8)
    ]


RISING = ((18.0, 18.0), (20.0, 20.0), (22.0, 22.0))


@pytest.mark.parametrize("truth", [worn, warmed])
def test_a_temperature_that_rises_with_the_session_is_not_told_from_wear(diagnosing: Diagnosing, truth: Truth) -> None:
    """The data are the same with either of the two at work: even odds, no fix, and a run that tells."""
    verdict = diagnosing(campaign(at(RISING), truth=noisy(truth, 1)))
    assert verdict.kind is VerdictKind.AMBIGUOUS
    (cause,) = verdict.causes
    assert cause.probability <= 0.5
    assert any({"temperature_radius", "wear"} <= set(group) for group in verdict.groups)
    assert not verdict.recommended and any("corrections part" in why for why in verdict.fix.why)
    assert any(f"{cause.effect} from " in run.why for run in verdict.next_runs)


@pytest.mark.parametrize("temperatures_C", [((18.0, 22.0),) * 3, ((18.0, 18.0), (24.0, 24.0), (20.0, 20.0))])
def test_a_temperature_that_varies_otherwise_than_the_sessions_is_named(
    diagnosing: Diagnosing, temperatures_C: tuple[tuple[float, float], ...]
) -> None:
    """Within the sessions, or up and down: steps of the sessions follow that too, at odds that say no."""
    verdict = diagnosing(campaign(at(temperatures_C), truth=noisy(warmed, 2)), plan=False)
    assert verdict.kind is VerdictKind.EXPLAINED and verdict.recommended
    assert [cause.effect for cause in verdict.causes] == ["temperature_radius"]


def by_direction(run: Run, now: Motion) -> None:
    now.left = now.right = {"out": 8e-4, "back": -8e-4}[run.direction]


def both_ways(speeds_mps: dict[str, tuple[float, float]]) -> list[Run]:
    run = Run(STRAIGHT, front=False)
    return [
        replace(run, direction=direction, speed_mps=speeds_mps[direction][number % 2], session=session)
        for session in SESSIONS
        for direction in ("out", "back")
        for number in range(4)
    ]


def test_a_direction_with_a_speed_of_its_own_is_not_told_from_the_speed(diagnosing: Diagnosing) -> None:
    verdict = diagnosing(campaign(both_ways({"out": (0.3, 0.3), "back": (0.6, 0.6)}), truth=noisy(by_direction, 3)))
    assert any({"travel_direction", "speed_radius"} <= set(group) for group in verdict.groups)
    assert not verdict.recommended
    assert any("travel_direction from speed_radius" in run.why for run in verdict.next_runs)


def test_a_direction_at_both_speeds_is_told_from_the_speed(diagnosing: Diagnosing) -> None:
    verdict = diagnosing(
        campaign(both_ways({"out": (0.3, 0.6), "back": (0.3, 0.6)}), truth=noisy(by_direction, 3)), plan=False
    )
    assert "speed_radius" not in {name for group in verdict.groups for name in group}
    assert verdict.recommended


def test_on_journeys_that_are_given_the_corrections_speak_for_themselves() -> None:
    """Only where no journey to come is known does what went together hold a fix back."""
    group, closure = ["temperature_radius", "wear"], Closure(floor_rms_m=0.01)
    assert len([*disagreement(0.0, "runs driven", closure, [group])]) == 1
    assert not [*disagreement(0.0, "journeys", closure, [group])]
    assert parting(["load_radius", "wear"]) == parting(["wear"]) == []


def test_what_drifts_is_not_told_from_what_follows_load_or_speed() -> None:
    """What wears says nothing of the next load, while laws of the load agree."""
    assert parting(["wear", "load_radius", "track_width"]) == ["wear", "load_radius"]
    assert parting(["load_radius", "load_radius_nonlinear"]) == parting(["curve_scrub", "load_dependent_track"]) == []


def test_steps_of_the_sessions_stay_a_form_unless_they_are_as_probable(monkeypatch: pytest.MonkeyPatch) -> None:
    effects = {name: effect_class(name) for name in ("temperature_radius", "session_step")}
    evidence = SimpleNamespace(named=["temperature_radius"], effects=effects)
    likely: set[str] = set()
    monkeypatch.setattr("calib.gap.decision.decide.confounding.as_probable", lambda *_: likely)
    group = ["temperature_radius", "session_step"]
    assert _by_family(evidence, [group])[0] == [["temperature_radius"]]  # type: ignore[arg-type]
    likely.add("session_step")
    assert _by_family(evidence, [group])[0] == [group]  # type: ignore[arg-type]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_a_parameter_and_its_alias_are_as_probable_together_however_they_share_it(share: float) -> None:
    """A certain track or scrub is certain, where half of the odds say one and half the other."""
    search = SimpleNamespace(models=[("curve_scrub",), ()], probabilities=[share, 1.0 - share])
    recalibration = SimpleNamespace(subsets=[("track_width",), ()], probabilities=[1.0 - share, share])
    evidence = SimpleNamespace(search=search, recalibration=recalibration)
    together = any_probability(evidence, {"curve_scrub", "track_width"})  # type: ignore[arg-type]
    assert together == pytest.approx(calibrated(1.0))
    assert any_probability(evidence, {"curve_scrub"}) == pytest.approx(calibrated(share))  # type: ignore[arg-type]


def test_a_group_too_large_to_identify_a_cause_is_counted_not_listed() -> None:
    """Six are listed, as in the sentence; of a dozen the first and how many others."""
    names = [f"effect_{n}" for n in range(12)]
    closure = Closure(floor_rms_m=1e-3)
    listed, counted = (" ".join(disagreement(1.0, "journeys", closure, [names[:n]])) for n in (6, 12))
    assert "effect_0 or effect_1 or effect_2 or effect_3 or effect_4 or effect_5, and" in listed
    assert "effect_0 or 11 other effects, and" in counted
    assert "effect_1 " not in counted
