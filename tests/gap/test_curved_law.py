"""A law of the load that bends is found beside a model that holds the best straight line, as `calib fit` gives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.gap.decision.diagnosis import Diagnosis, VerdictKind
from calib.gap.diagnose import diagnose_in_full
from tests.gap.effects.making import MODEL, RADIUS_M, Motion, Run, campaign

PAYLOADS_KG = (0.0, 45.0, 90.0, 135.0, 180.0, 225.0)
#: of the laser, 20 m away
LASER_M = 1.5e-3
#: slope of the radius at the lightest load: the line leaves 20 to 40 um, 4 to 8 mm on 20 m
SLOPE_M_PER_N = -1e-6
Diagnosing = Callable[..., Diagnosis]


def load_N(payload_kg: float) -> float:
    return 300.0 + 0.4 * 9.81 * payload_kg


def radius_m(load: float | np.ndarray, exponent: float) -> float | np.ndarray:
    """A radius that follows a power of the load."""
    return RADIUS_M + SLOPE_M_PER_N * 300.0 * ((load / 300.0) ** exponent - 1.0) / exponent


def bent(exponent: float, seed: int) -> Campaign:
    """Corridor runs of two lengths at six loads, of a model with the least-squares line through the radii there."""
    loads = np.array([load_N(each) for each in PAYLOADS_KG])
    slope, at_zero = np.polyfit(loads, radius_m(loads, exponent), 1)
    radius = at_zero + slope * MODEL.reference_load_N
    model = replace(
        MODEL, radius_left_m=radius, radius_right_m=radius, slope_left_m_per_N=slope, slope_right_m_per_N=slope
    )
    rng = np.random.default_rng(seed)

    def truth(run: Run, now: Motion) -> None:
        now.left = now.right = radius_m(run.load_left_N, exponent) / (at_zero + slope * run.load_left_N) - 1.0
        now.laser_m += rng.normal(0.0, LASER_M)

    runs = [
        Run(
            [((20.0, 15.0)[number // 6 % 2], 0.0)],
            load_left_N=load,
            load_right_N=load,
            session=f"s{number // 36}",
            front=False,
            log=False,
        )
        for number, load in enumerate(np.tile(loads, 12))
    ]
    runs = [replace(run, numbers={"payload_kg": PAYLOADS_KG[n % len(PAYLOADS_KG)]}) for n, run in enumerate(runs)]
    made = campaign(runs, model=model, truth=truth)
    numbers = {name: column for name, column in made.runs.numbers.items() if not name.startswith("ref_")}
    return replace(made, runs=replace(made.runs, numbers=numbers))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_bend_is_named_beside_the_line_that_the_model_has(diagnosing: Diagnosing, seed: int) -> None:
    """Line and curve, large and opposite, are one law: it is named and its correction recommended."""
    found = diagnosing(bent(0.5, seed), plan=False)
    assert {cause.effect for cause in found.causes} >= {"load_radius_nonlinear"}
    assert {cause.effect for cause in found.causes} <= {"load_radius_nonlinear", "load_radius", "radius_scale"}
    assert found.kind is VerdictKind.EXPLAINED and found.recommended
    (line,) = (line for line in found.closure.channels if line.channel.label == "distance")
    # most of the bend's squares are gone on runs not fitted on
    assert line.fraction is not None and line.fraction > 0.9


def test_a_line_beside_a_line_is_no_gap(diagnosing: Diagnosing) -> None:
    assert diagnosing(bent(1.0, 1), plan=False).kind is VerdictKind.NO_GAP


def test_no_part_of_a_fix_is_recommended_beside_a_gap_that_may_be_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """What helps on held-out runs may be the noise that looks like a gap."""
    monkeypatch.setattr("calib.gap.decision.confounding.gap_probability", lambda _: 0.8)
    fix = diagnose_in_full(bent(0.5, 1), plan=False).fix
    assert not fix.recommended and any("a gap at all is 0.80" in why for why in fix.why)
