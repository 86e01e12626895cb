"""Which verdict it is, on findings written by hand: no campaign is needed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from calib.gap.decision import Trial, decide
from calib.gap.decision import kind as deciding
from calib.gap.decision.causes import limited_beside, places_as_unexplained
from calib.gap.decision.diagnosis import Cause, Evidence, Quantity, Unexplained, VerdictKind
from calib.gap.decision.fix import noise_bounded
from calib.gap.decision.held_out import Closure, Improvement
from calib.gap.decision.kind import fails, is_shown, kind_of, no_mere_noise, scatters_alone, stands_off
from calib.gap.inference import REPORTED_GAP_PROBABILITY
from calib.gap.localise.locate import CovariateResult
from calib.gap.observations import Channel
from calib.types import IntArray

#: the correction of one certain effect closes the gap on held-out runs
CLOSED = Closure(fraction=0.98, ci95=(0.95, 1.0), floor_rms_m=0.004)


def cause(probability: float = 0.9) -> Cause:
    return Cause("load_radius", "", "", probability, share=1.0, signal=30.0, parameters={})


def trial(after: float, growth_sd: float = -5.0, before: float = 500.0) -> Trial:
    """A held-out value whose thirty readings square to thirty by noise alone, to 70 one time in a hundred."""
    squares = {"before_square": before, "after_square": after, "noise_square": 30.0, "noise_limit": 70.0}
    return Trial("kind", "square_cw", 0.05, 0.01, **squares, growth_sd=growth_sd)


def verdict(
    fraction: float | None = 0.98,
    ci95: tuple[float, float] | None = (0.95, 1.0),
    *,
    gap: float = 1.0,
    n_named: int = 1,
    probability: float = 0.5,
    **given: Any,
) -> VerdictKind:
    closure = Closure(fraction=fraction, ci95=ci95, floor_rms_m=0.004)
    return kind_of(gap, [cause(probability)] * n_named, closure, **given)


def test_one_clear_effect_explains_the_gap() -> None:
    assert verdict() is VerdictKind.EXPLAINED


def test_without_a_probable_gap_there_is_none_even_if_causes_are_named() -> None:
    assert verdict(gap=0.99 * REPORTED_GAP_PROBABILITY) is VerdictKind.NO_GAP


def test_without_a_noise_level_nothing_is_decided() -> None:
    assert verdict(supported=False) is VerdictKind.UNDECIDED
    assert verdict(gap=0.0, supported=False) is VerdictKind.UNDECIDED
    # runs that end off by a tenth of their length by any effect: no noise does that
    assert verdict(supported=False, misfit=0.1) is VerdictKind.UNKNOWN


def test_what_is_taken_off_runs_not_fitted_on_is_no_noise_at_any_level() -> None:
    """Of a noise level that nothing supports it is open how much of the rest it is, not whether there is a gap."""
    half = Improvement(5.4, 2.2, (2.7, 3.8), (0.55, 0.95))
    assert is_shown([cause(0.95)], half)
    assert not is_shown([cause(0.8)], half)
    assert not is_shown([], half)
    assert not is_shown([cause(0.95)], replace(half, closed_ci95=(0.45, 1.0)))
    assert not is_shown([cause(0.95)], None)


def test_a_confounded_effect_is_ambiguous() -> None:
    assert verdict(tied=True) is VerdictKind.AMBIGUOUS


def test_several_causes_beside_a_small_unexplained_residual_explain() -> None:
    """Real robots have several small imperfections at once, and a residual that carries next to nothing."""
    assert verdict(n_named=5, unexplained_share=0.02) is VerdictKind.EXPLAINED


@pytest.mark.parametrize(
    "given",
    [
        {"unexplained_share": 0.3},
        {"unexplained_share": 1.0},
        {"incomplete": fails(trial(400.0))},
        {"fraction": 0.8, "ci95": (0.6, 0.88)},
        {"fraction": 0.5, "ci95": (0.4, 0.6)},
        {"unexplained_share": 0.3, "tied": True},
        {"unexplained_share": 0.9, "probability": 0.9, "fraction": 0.1, "ci95": (-0.2, 0.9)},
    ],
    ids=[
        "unexplained",
        "excluded",
        "not transferred",
        "closes 0.8",
        "closes 0.5",
        "confounded too",
        "mostly unexplained",
    ],
)
def test_what_leaves_a_residual_explains_in_part(given: dict[str, Any]) -> None:
    assert verdict(**given) is VerdictKind.PARTLY_EXPLAINED


@pytest.mark.parametrize(
    "given",
    [
        {"unexplained_share": 0.9, "fraction": 0.1, "ci95": (-0.2, 0.9)},
        {"unexplained_share": 0.9, "fraction": None, "ci95": None},
        {"fraction": 0.1, "ci95": (-0.2, 0.4)},
        {"n_named": 0, "unexplained_share": 1.0, "fraction": None, "ci95": None},
        {"misfit": 0.2},
        {"gap": 0.1, "misfit": 0.2},
        # even if probable: an effect that is in no library is imitated by those that are
        {"unexplained_share": 0.6, "probability": 0.9, "fraction": 0.3, "ci95": (0.1, 0.45)},
    ],
    ids=[
        "unexplained, no closure",
        "unexplained, closure unmeasured",
        "no closure",
        "nothing named",
        "blunder",
        "blunder beside a large noise level",
        "certainly less than half",
    ],
)
def test_what_closes_nothing_leaves_the_cause_unknown(given: dict[str, Any]) -> None:
    assert verdict(**given) is VerdictKind.UNKNOWN


def test_an_unexplained_part_within_the_interval_of_the_closure_is_none() -> None:
    """A closure of 0.8 whose interval holds 1 is what a sound fix of a small gap shows on few runs."""
    assert verdict(0.8, (0.5, 1.0)) is VerdictKind.EXPLAINED


def test_a_probable_gap_without_any_cause_is_unknown() -> None:
    """With nothing named, even without a probable residual: that there is a gap is what matters."""
    assert verdict(None, None, gap=0.8, n_named=0) is VerdictKind.UNKNOWN
    assert verdict(None, None, gap=0.2, n_named=0) is VerdictKind.NO_GAP


@pytest.mark.parametrize(
    ("share", "signal", "expected"),
    [(0.4, 60.0, 0.5), (0.4, 29.0, 0.9), (0.04, 60.0, 0.9)],
    ids=["weaker than the residual", "stronger than the residual", "a residual of a small share"],
)
def test_a_cause_weaker_than_the_unexplained_residual_has_even_odds_at_most(
    share: float, signal: float, expected: float
) -> None:
    """What left so much unexplained may have left that little, too; the signal of the cause is 30."""
    assert [each.probability for each in limited_beside([cause()], Unexplained(share, signal))] == [expected]


def test_of_an_incomplete_hypothesis_the_strongest_cause_alone_keeps_its_probability() -> None:
    """Its evidence compares wrong models only: several share one effect outside the library between them."""
    causes = [cause(), replace(cause(), effect="speed_radius", signal=25.0)]
    for beyond, weaker in ((False, 0.9), (True, 0.5)):
        limited = limited_beside(causes, Unexplained(0.4, 20.0, beyond_noise=beyond))
        assert [each.probability for each in limited] == [0.9, weaker]


def test_even_odds_raise_no_probability() -> None:
    assert limited_beside([cause(0.3)], Unexplained(0.4, 60.0))[0].probability == 0.3


def test_without_an_unexplained_residual_the_causes_stay_as_they_are() -> None:
    assert limited_beside([cause()], None) == [cause()]


def test_a_place_of_the_floor_that_other_causes_outweigh_is_unexplained() -> None:
    """It follows what their forms leave; one that explains more than half by itself stays a cause."""
    effects = {"load_radius": SimpleNamespace(by_place=False), "floor_zone": SimpleNamespace(by_place=True)}
    evidence = cast(Evidence, SimpleNamespace(effects=effects))
    zone = Cause("floor_zone", "", "x 4 m", 0.96, share=0.1, signal=8.0, parameters={})
    placed, left = places_as_unexplained(
        evidence, [replace(cause(), share=0.8), zone], Unexplained(0.1, 6.0, ("heading",))
    )
    assert placed == [zone]
    assert left == Unexplained(0.2, pytest.approx(10.0), ("on the floor, x 4 m", "heading"))
    larger = replace(zone, share=0.9)
    assert places_as_unexplained(evidence, [replace(cause(), share=0.1), larger], None) == ([], None)


@pytest.mark.parametrize(
    ("off", "found"),
    [
        ({3: 6.0}, False),  # one run by itself
        ({3: 6.0, 9: 3.9}, True),  # another of its route, beyond what its eight readings reach by noise
        ({3: 6.0, 9: -3.9}, False),  # to the other side
        ({3: 6.0, 10: 3.9}, False),  # of another route
        ({3: 3.9, 9: 3.9}, False),  # none beyond what all readings reach by noise
    ],
)
def test_two_runs_of_a_route_that_agree_are_no_single_runs(off: dict[int, float], found: bool) -> None:
    """Forty-eight runs of six routes, no two under the same conditions."""
    left = np.zeros((48, 6))
    left[list(off), 2] = list(off.values())
    runs = np.arange(48)
    observations = SimpleNamespace(
        usable=np.ones((48, 6), bool), condition=runs, kind=runs % 6, run=runs, windowed=False
    )
    noise = SimpleNamespace(floor=np.ones((48, 6)), dof=90.0, levels_dof=None)
    evidence = SimpleNamespace(observations=observations, noise=noise, fitted=SimpleNamespace(left=left))
    assert stands_off(evidence) is found  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("run", "omitted", "found"),
    [(np.arange(24) // 2, {}, False), (np.arange(24), {}, True), (np.arange(24) // 2, {"rec9": 0.01}, True)],
)
def test_windows_of_one_recording_that_agree_share_what_its_radii_are_off_by(
    run: IntArray, omitted: dict[str, float], found: bool
) -> None:
    """Two windows alike stand off: of one recording that scatters, or of two recordings.

    Where another recording was omitted the scatter is of none that was alone: no all-clear beside windows so far off.
    """
    left = np.zeros((24, 6))
    left[6:8, 2] = 6.0
    condition = np.arange(24) // 2
    observations = SimpleNamespace(
        usable=np.ones((24, 6), bool), condition=condition, kind=condition, run=run, windowed=True
    )
    noise, situation = SimpleNamespace(floor=np.ones((24, 6)), dof=90.0, levels_dof=None), SimpleNamespace()
    situation.omitted, fitted = omitted, SimpleNamespace(left=left)
    evidence = SimpleNamespace(observations=observations, noise=noise, fitted=fitted, situation=situation)
    assert stands_off(evidence) is found  # type: ignore[arg-type]


@pytest.mark.parametrize(("low", "kind"), [(-0.1, VerdictKind.PARTLY_EXPLAINED), (0.1, VerdictKind.EXPLAINED)])
def test_what_held_out_runs_do_not_confirm_is_not_explained(
    monkeypatch: pytest.MonkeyPatch, low: float, kind: VerdictKind
) -> None:
    monkeypatch.setattr(decide, "misfit_of", lambda evidence: 0.0)
    monkeypatch.setattr(decide, "kind_of", lambda *given, **further: VerdictKind.EXPLAINED)
    held_out = SimpleNamespace(improvement=Improvement(1.22, 1.16, (low, 0.2), (0.0, 1.0)), closure=None)
    evidence = SimpleNamespace(held_out=held_out, noise=SimpleNamespace(supported=True), trials=())
    assert decide._kind(evidence, 0.9, [], None, [], {}, doubted=False) is kind  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("times", "dof", "lines", "off", "told"),
    [
        (1.2, 0.0, (), 0.0, False),  # within what the stated level may be off by
        (2.0, 0.0, (), 0.0, True),
        (2.0, 9.0, (), 0.0, False),  # repeats measured the noise
        (2.0, 0.0, ("payload_kg",), 0.0, False),  # noise follows no covariate
        (2.0, 0.0, (), 0.6, False),  # nor takes runs off by half their length
    ],
)
def test_what_none_driven_twice_scatter_by_is_no_gap_shown(
    monkeypatch: pytest.MonkeyPatch, times: float, dof: float, lines: tuple[str, ...], off: float, told: bool
) -> None:
    monkeypatch.setattr(deciding, "misfit_of", lambda evidence: off)
    evidence = SimpleNamespace(
        observations=SimpleNamespace(usable=np.ones((40, 2), bool)),
        noise=SimpleNamespace(dof=dof, supported=True),
        fitted=SimpleNamespace(chi_square=80.0 * times**2),
        where=SimpleNamespace(significant=lines),
    )
    assert bool(scatters_alone(evidence)) is told  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("excess", "channel", "told"),
    [
        (3.4, Channel.HEADING, "3.4 times as much in heading"),
        (1.5, Channel.HEADING, ""),  # a stated level may be off by as much
        (3.4, Channel.ALONG, ""),  # another channel
        (3.4, None, ""),  # of a wheel, in no channel
        (13.0, None, "13 times as much in heading"),  # runs of another vehicle among the repeats
    ],
)
def test_repeats_that_scatter_far_more_than_stated_and_follow_what_was_written_down_measure_no_noise(
    excess: float, channel: Channel | None, told: str
) -> None:
    """A wheel that slips on cold mornings alone was no gap, with exit status 0."""
    every = np.full(len(Channel), 1.1)
    every[Channel.HEADING] = excess
    line = CovariateResult("temperature_C", channel, 1.0, None, 1e-3, significant=True, n_units=36)
    evidence = SimpleNamespace(noise=SimpleNamespace(excess=every), where=SimpleNamespace(significant=(line,)))
    words = no_mere_noise(evidence)  # type: ignore[arg-type]
    assert told in words and bool(words) is bool(told)
    assert ("follow temperature_C" in words) is (told.startswith("3.4"))


@pytest.mark.parametrize(
    ("supported", "dof", "windowed", "bounded"),
    [(True, 0.0, True, True), (False, 17.0, False, True), (False, 17.0, True, False), (False, 0.0, False, False)],
)
def test_runs_that_differ_hold_all_their_noise_and_windows_or_assumed_sigmas_do_not(
    supported: bool, dof: float, windowed: bool, bounded: bool
) -> None:
    """What a correction takes away beyond too high a level it takes at the right one, so no repeats are asked for."""
    evidence = SimpleNamespace(
        noise=SimpleNamespace(supported=supported, dof=dof), observations=SimpleNamespace(windowed=windowed)
    )
    assert noise_bounded(evidence) is bounded  # type: ignore[arg-type]


@pytest.mark.parametrize(("off", "kind"), [(0.03, VerdictKind.PARTLY_EXPLAINED), (0.98, VerdictKind.UNKNOWN)])
def test_no_cause_is_shown_where_runs_end_off_as_no_vehicle_does(
    monkeypatch: pytest.MonkeyPatch, off: float, kind: VerdictKind
) -> None:
    """Exchanged wheels made a radius of -160 % a certain cause, as it closed 84 % where nothing supports the noise."""
    monkeypatch.setattr(decide, "misfit_of", lambda _: off)
    shown = Cause("radius_scale", "", "", 0.96, 0.7, 2850.0, {"relative": Quantity(-1.6, (-1.61, -1.59), "1")})
    improvement = Improvement(240.0, 97.0, (142.0, 143.0), (0.83, 0.84))
    evidence = SimpleNamespace(
        noise=SimpleNamespace(supported=False, dof=39.0),
        observations=SimpleNamespace(windowed=True),
        held_out=SimpleNamespace(improvement=improvement, closure=Closure(fraction=0.84, ci95=(0.75, 0.88))),
        trials=(),
    )
    given = (cast(Evidence, evidence), 1.0, [shown], None, [], {}, False)
    assert decide._kind(*given) is kind


@pytest.mark.parametrize(
    ("improved", "kind"), [((-0.17, -0.04), VerdictKind.UNKNOWN), ((-0.17, 0.04), VerdictKind.PARTLY_EXPLAINED)]
)
def test_what_certainly_leads_held_out_runs_further_off_is_no_cause(
    monkeypatch: pytest.MonkeyPatch, improved: tuple[float, float], kind: VerdictKind
) -> None:
    """Radii that followed a temperature, where one session's start was off: each other session ended further off."""
    monkeypatch.setattr(decide, "misfit_of", lambda _: 0.001)
    named = Cause("temperature_radius", "", "", 0.96, 0.76, 8.1, {"alpha": Quantity(1e-4, (5e-5, 1.5e-4), "1/K")})
    closure = Closure(fraction=0.4, ci95=(-0.6, 1.2))
    evidence = SimpleNamespace(
        noise=SimpleNamespace(supported=True, dof=64.0),
        held_out=SimpleNamespace(improvement=Improvement(1.33, 1.43, improved, (-0.6, 1.2)), closure=closure),
        trials=(),
    )
    given = (cast(Evidence, evidence), 1.0, [named], None, [], {}, True)
    assert decide._kind(*given) is kind
