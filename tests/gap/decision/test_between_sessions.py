"""Sizes are known no better than what steps between sessions leave, also where these are too small to be named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.gap.decision import constancy
from calib.gap.decision.constancy import SessionScatter, variance_component
from calib.gap.decision.held_out import Improvement
from calib.gap.effects.load import LoadRadius
from calib.gap.effects.radii import SessionStep, TemperatureRadius
from calib.gap.effects.turning import CurveScrub

#: degrees of freedom of the noise, as many as of fifty repeats
NOISE_DOF = 50.0
#: the search of a variance ends at a millionth of its logarithm, and its least is 4e-6 of the unit
SEARCH_ERROR = 1e-4
#: draws of a campaign, and four standard errors of a share of 95 % of them
DRAWS, SHARE_ERROR = 400, 0.044


def test_sessions_of_one_uncertainty_have_the_variance_of_a_one_way_classification() -> None:
    """Closed form: the mean square less the variance of one estimate, with its share of the degrees of freedom."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        estimates, own = rng.normal(0.0, 1.5, 6), 0.25
        expected = np.mean(estimates**2) - own
        variance, dof = variance_component(estimates, own * np.eye(6))
        assert variance == pytest.approx(max(expected, 0.0), rel=SEARCH_ERROR)
        assert dof == pytest.approx(6.0 * (variance / (variance + own)) ** 2)


def test_what_the_runs_do_not_tell_of_the_sessions_adds_nothing() -> None:
    """A step that shifts with the mean, by any amount, has no say in the variance."""
    estimates, covariance = np.array([0.7, -0.9, 0.4, 300.0]), np.diag([0.1, 0.1, 0.1, 1e6])
    alone = variance_component(estimates[:3], covariance[:3, :3])
    assert variance_component(estimates, covariance) == pytest.approx(alone, rel=1e-3)
    assert variance_component(0.1 * estimates, covariance) == (0.0, 0.0)


@pytest.mark.parametrize("n_sessions", [2, 4])
def test_the_interval_of_a_mean_holds_it_in_95_of_100_campaigns(n_sessions: int) -> None:
    """A radius that steps by up to five times what a session's runs leave, beside another that steps alike."""
    rng = np.random.default_rng(n_sessions)
    for step in (0.0, 1.0, 5.0):
        held = 0
        for _ in range(DRAWS):
            left, right = rng.normal(0.0, np.hypot(1.0, step), (2, n_sessions))
            # the mean of the left radius is free, the right one is known
            beside = np.eye(2 * n_sessions)
            beside[:n_sessions, :n_sessions] += 1e6
            variance, dof = variance_component(np.concatenate([left, right]), beside)
            half = 2.0086 / np.sqrt(n_sessions)  # Student's t of 50 degrees of freedom
            if variance:
                scatter = SessionScatter(np.eye(1) / n_sessions, (1.0 + variance) * np.eye(1) / n_sessions, dof)
                half *= float(scatter.widening(np.eye(1), NOISE_DOF)[0])
            held += abs(left.mean()) <= half
        assert held / DRAWS >= 0.95 - SHARE_ERROR


@pytest.mark.parametrize(
    ("effect", "closed", "sessions", "by", "refuted"),
    [
        ("curve_scrub", 0.6, 8, "session", True),  # F of 9 with 1 and 6 degrees of freedom: p = 0.02
        ("curve_scrub", 0.4, 8, "session", False),  # F of 4: p = 0.09
        ("curve_scrub", 0.9, 4, "session", False),  # F of 18 with 1 and 2: p = 0.051
        ("curve_scrub", 0.97, 3, "session", False),
        ("curve_scrub", 0.97, 2, "session", False),
        ("curve_scrub", -0.2, 8, "session", False),
        ("temperature_radius", 0.9, 8, "session", False),  # what drifts follows the order, as steps that last do
        ("load_radius", 0.98, 8, "session", False),  # one load a session confounds the two by design
        ("curve_scrub", 0.6, 8, "run", False),
    ],
)
def test_steps_are_no_alternative_to_what_predicts_the_held_out_sessions(
    monkeypatch: pytest.MonkeyPatch, effect: str, closed: float, sessions: int, by: str, *, refuted: bool
) -> None:
    """A session's own step is not told by the others; what few sessions agree on may be chance."""
    whole = Improvement(5.0, 1.1, (1.0, 6.0), (0.8, 1.1))
    form = SimpleNamespace(effect=effect, parameters=(None,))
    kinds = (CurveScrub, TemperatureRadius, LoadRadius, SessionStep)
    evidence = SimpleNamespace(
        held_out=SimpleNamespace(improvement=whole, closure=SimpleNamespace(held_out=by)),
        effects={kind.id: kind() for kind in kinds},
        fitted=SimpleNamespace(forms=[form], parameters=np.ones(1)),
        observations=SimpleNamespace(labels={"session": np.repeat(np.arange(sessions), 3)}),
        nominal=None,
        noise=None,
        search=SimpleNamespace(weighting=None),
        left_out=None,
    )
    monkeypatch.setattr(constancy, "fit", lambda *_, **__: evidence.fitted)
    monkeypatch.setattr(constancy, "HeldOutFit", lambda *_: None)
    monkeypatch.setattr(constancy, "left_with_others", lambda *_, **__: (np.ones(1), by))
    without = replace(whole, closed_ci95=(closed, 1.2))
    monkeypatch.setattr(constancy, "improvement_of", lambda *_, **__: without)
    groups = constancy.without_refuted(evidence, [[effect, "session_step", "track_width"]])  # type: ignore[arg-type]
    assert groups == [[effect, "track_width"] if refuted else [effect, "session_step", "track_width"]]
