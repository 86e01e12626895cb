"""Truths of loads: laws of the radius, creep, payloads that are misreported."""

from __future__ import annotations

import numpy as np

from tests.gap.effects.making import RADIUS_M, TRACK_M, Motion, Run
from tests.gap.effects.truths.cases import LOGGED, SLOPED, G, case


@case("load_radius", "", 1.3e-6, -0.8e-6)
def _(run: Run, now: Motion) -> None:
    now.left = 1.3e-6 * (run.load_left_N - 300.0) / RADIUS_M
    now.right = -0.8e-6 * (run.load_right_N - 300.0) / RADIUS_M


def nonlinear(exponent: float, label: str) -> None:
    @case("load_radius_nonlinear", label, 1.3e-6, 0.9e-6)
    def _(run: Run, now: Motion) -> None:
        # c F^p less its value at 300 N, c such that the slope there is the size
        def change(load: float, slope: float) -> float:
            c = slope / (exponent * 300.0 ** (exponent - 1.0))
            return c * (load**exponent - 300.0**exponent) / RADIUS_M

        now.left, now.right = change(run.load_left_N, 1.3e-6), change(run.load_right_N, 0.9e-6)


nonlinear(0.5, "exponent 0.5")
nonlinear(0.7, "exponent 0.7")
nonlinear(0.85, "exponent 0.85")
nonlinear(2.0, "quadratic")


# the band gives way during the run too, by half a minute on three minutes at most: within 2 % of the largest
@case("load_creep", "whole load, time constant 3 min", 2e-7, 3e-7, within=2e-2, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    gone = 1.0 - np.exp(-(run.numbers["minutes_under_load"] + (now.t_s - 0.5 * now.dt_s) / 60.0) / 3.0)
    now.left, now.right = -2e-7 * run.load_left_N * gone / RADIUS_M, -3e-7 * run.load_right_N * gone / RADIUS_M


# the vehicle's own load on each wheel, from its mass and where its middle lies
UNLADEN_N = 0.5 * 100.0 * G * (1.0 - 0.388)


@case("load_creep", "load above the unladen, time constant 30 min", 2e-7, 3e-7, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    gone = 1.0 - np.exp(-(run.numbers["minutes_under_load"] + (now.t_s - 0.5 * now.dt_s) / 60.0) / 30.0)
    now.left = -2e-7 * (run.load_left_N - UNLADEN_N) * gone / RADIUS_M
    now.right = -3e-7 * (run.load_right_N - UNLADEN_N) * gone / RADIUS_M


@case("load_creep", "change of load, time constant 30 min", 2e-7, 3e-7, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    """The band's set follows the loads in the order driven: old load, then exponentially to the new one."""
    index = next(i for i, other in enumerate(LOGGED) if other is run)
    left = right = UNLADEN_N
    for earlier in reversed(LOGGED[:index]):
        if earlier.load_left_N != run.load_left_N:
            left, right = earlier.load_left_N, earlier.load_right_N
            break
    rest = np.exp(-(run.numbers["minutes_under_load"] + (now.t_s - 0.5 * now.dt_s) / 60.0) / 30.0)
    now.left = -2e-7 * ((run.load_left_N - UNLADEN_N) * (1.0 - rest) + (left - UNLADEN_N) * rest) / RADIUS_M
    now.right = -3e-7 * ((run.load_right_N - UNLADEN_N) * (1.0 - rest) + (right - UNLADEN_N) * rest) / RADIUS_M


@case("load_dependent_track", "", 6e-6)
def _(run: Run, now: Motion) -> None:
    now.track = 6e-6 * (run.load_left_N + run.load_right_N - 600.0)


def loaded(load_N: float) -> float:
    """Radius of the sloped model under a load."""
    return RADIUS_M + 1.2e-6 * (load_N - 300.0)


@case("payload_mass", "payload of 150 kg", 0.2, model=SLOPED)
def _(run: Run, now: Motion) -> None:
    if run.numbers["payload_kg"] == 150.0:
        more_N = 0.2 * 150.0 * G
        now.left = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) + 0.02 / TRACK_M) / loaded(run.load_left_N)
        now.right = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) - 0.02 / TRACK_M) / loaded(run.load_right_N)


@case("payload_mass", "all payloads", 0.1, model=SLOPED)
def _(run: Run, now: Motion) -> None:
    """A scale that reads a tenth too little under every payload."""
    more_N = 0.1 * run.numbers["payload_kg"] * G
    now.left = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) + 0.02 / TRACK_M) / loaded(run.load_left_N)
    now.right = 1.2e-6 * more_N * (0.5 * (1.0 - 0.3) - 0.02 / TRACK_M) / loaded(run.load_right_N)


@case("payload_position", "sideways", 0.05, model=SLOPED)
def _(run: Run, now: Motion) -> None:
    moved_N = run.numbers["payload_kg"] * G * 0.05 / TRACK_M
    now.left, now.right = 1.2e-6 * moved_N / loaded(run.load_left_N), -1.2e-6 * moved_N / loaded(run.load_right_N)


@case("payload_position", "lengthways", -0.05, model=SLOPED, runs=LOGGED)
def _(run: Run, now: Motion) -> None:
    moved_N = run.numbers["payload_kg"] * G * -0.05 / 1.0
    now.left = -1.2e-6 * 0.5 * moved_N / loaded(run.load_left_N)
    now.right = -1.2e-6 * 0.5 * moved_N / loaded(run.load_right_N)
    # a larger front wheel counts less for its way
    now.front = 1.0 / (1.0 + 1.2e-6 * moved_N / RADIUS_M) - 1.0
