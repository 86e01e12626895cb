"""A law is held against what it leaves of its runs, and against other readings of the table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.coefficients.build import from_fit
from calib.coefficients.file import CoefficientFile
from calib.errors import ImplausibleError
from calib.radius.fit import fit_campaign
from calib.radius.law import RadiusLaw
from tests.radius.campaigns import campaign_of

N = 30
#: loads left and right, driven in an order by chance
PAIRS = np.array([(300, 300), (346, 1019), (1019, 346), (700, 700), (1100, 1100), (540, 540)], dtype=float)
LOADS = PAIRS[np.random.default_rng(4).permutation(np.arange(N) % len(PAIRS))]
DAY = np.repeat(["d1", "d2", "d3"], N // 3)


def driven(scatter: float = 1e-4, seed: int = 1, *, heavy: bool = False) -> Campaign:
    """Return runs whose radii scatter by a share, and by sessions a tenth of a per mille."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(37.0, 42.0, N)
    numbers = {"load_left_N": LOADS[:, 0], "load_right_N": LOADS[:, 1]}
    numbers["distance_m"] = distance + rng.normal(0.0, 0.0015, N)
    for side, radius, slope in (("left", 0.10009, 1.27e-6), ("right", 0.09988, 1.25e-6)):
        drawn = rng.standard_t(3, N) / np.sqrt(3.0) if heavy else rng.standard_normal(N)
        off = 1.0 + scatter * drawn + np.repeat(1e-4 * rng.standard_normal(3), N // 3)
        true = (radius + slope * (numbers[f"load_{side}_N"] - 300.0)) * off
        numbers[f"counts_{side}"] = np.floor(distance / (2.0 * np.pi * true) * 4096.0)
    return campaign_of(numbers, labels={"session": DAY})


def altered(made: Campaign, **columns: np.ndarray) -> Campaign:
    return replace(made, runs=replace(made.runs, numbers={**made.runs.numbers, **columns}))


def exchanged(made: Campaign, name: str, at: np.ndarray) -> Campaign:
    left, right = (made.runs.number(f"{name}_{side}") for side in ("left", "right"))
    name_left, name_right = f"{name}_left", f"{name}_right"
    return altered(made, **{name_left: np.where(at, right, left), name_right: np.where(at, left, right)})


def with_loads(made: Campaign, loads: np.ndarray) -> Campaign:
    return altered(made, load_left_N=loads[:, 0], load_right_N=loads[:, 1])


def loads_exchanged(made: Campaign, at: np.ndarray) -> Campaign:
    loads = np.column_stack([made.runs.number(f"load_{side}_N") for side in ("left", "right")])
    return with_loads(made, np.where(at[:, None], loads[:, ::-1], loads))


FIVE = np.isin(np.arange(N), np.flatnonzero(LOADS[:, 0] != LOADS[:, 1])[:5])
SORTED = LOADS[np.lexsort((LOADS[:, 1], LOADS[:, 0]))]
BLUNDERS = {
    "the loads of the row after": with_loads(driven(), np.roll(LOADS, 1, axis=0)),
    "the loads of the row before": with_loads(driven(), np.roll(LOADS, -1, axis=0)),
    "with loads of other runs": with_loads(driven(), LOADS[np.random.default_rng(8).permutation(N)]),
    "loads of other runs in": with_loads(driven(), SORTED),
    f"the loads of left and right exchanged in {', '.join(f'r{run}' for run in np.flatnonzero(FIVE))}": loads_exchanged(
        driven(), FIVE
    ),
    "the counts of left and right exchanged in r10, r11": exchanged(driven(), "counts", DAY == "d2"),
    "the loads, or else the counts, of left and right exchanged in all runs": exchanged(driven(), "counts", DAY != ""),
    # the load of the axle beside each wheel: no other reading of the rows says so
    "hold loads, counts and distances": with_loads(driven(), LOADS.sum(axis=1)[:, None].repeat(2, axis=1)),
}


@pytest.mark.parametrize("named", BLUNDERS)
def test_loads_that_are_not_their_runs_make_no_law(named: str) -> None:
    """Runs then scatter a hundred times beyond the instruments: no law, no file, and the reading that fits is named."""
    fit = fit_campaign(BLUNDERS[named])
    assert fit.verdict == "wrong"
    assert any(named in sentence for sentence in fit.implausible), fit.implausible
    with pytest.raises(ImplausibleError):
        from_fit(fit)


def test_one_mistyped_distance_accuses_no_loads() -> None:
    """Some load in the table suits any radius: a run far off alone is named itself."""
    distance = driven().runs.number("distance_m").copy()
    distance[5] *= 0.5
    found = fit_campaign(altered(driven(), distance_m=distance)).implausible
    assert found and not any("loads of other runs" in text for text in found)
    assert any("first of r5" in text for text in found)


def test_two_distances_exchanged_do_not_hide_each_other() -> None:
    distance = driven().runs.number("distance_m").copy()
    apart = int(np.argmax(np.abs(np.diff(distance))))
    distance[[apart, apart + 1]] = distance[[apart + 1, apart]]
    found = fit_campaign(altered(driven(), distance_m=distance)).implausible
    assert all(f"r{run}" in found[0] for run in (apart, apart + 1))


@pytest.mark.parametrize("factor", [4.0, 2.0, 0.5])
def test_a_session_whose_counts_are_a_factor_off_is_named(factor: float) -> None:
    made = driven()
    counts = {f"counts_{side}": made.runs.number(f"counts_{side}") for side in ("left", "right")}
    wrong = {name: np.where(DAY == "d2", factor * column, column) for name, column in counts.items()}
    found = fit_campaign(altered(made, **wrong)).implausible
    assert all("in session d2" in text and f"{1.0 / factor:.1g}" in text for text in found if "wheel's radius" in text)
    assert found


def test_loads_beyond_the_permitted_make_no_law() -> None:
    """Payloads in newtons for kilograms follow the radii as well as right ones: the limit alone tells."""
    found = fit_campaign(with_loads(driven(), 8.0 * LOADS)).implausible
    assert any("5000 N is permitted" in text for text in found)


@pytest.mark.parametrize(
    ("scatter", "heavy"), [(2e-4, False), (6e-4, False), (1e-3, False), (2e-4, True), (6e-4, True)]
)
def test_sound_runs_keep_their_law(scatter: float, heavy: bool) -> None:
    """Scatter of paths, up to a thousandth and with heavy tails, beside a load effect of a hundredth."""
    for seed in range(6):
        assert not fit_campaign(driven(scatter, seed, heavy=heavy)).implausible


def test_what_is_common_to_both_wheels_moves_their_mean_by_all_of_it() -> None:
    """Rangefinder and day move both radii alike: mean and difference vary as they do where fitted by themselves."""
    made = altered(driven(2e-5), load_right_N=LOADS[:, 0])
    drawn = np.random.default_rng(5).normal(0.0, 0.008, N) + np.repeat([0.01, -0.006, 0.002], N // 3)
    loads = np.tile([300.0, 500.0, 700.0, 900.0, 1100.0], N // 5)
    far = made.runs.number("distance_m")
    counts = {
        f"counts_{side}": far / (2 * np.pi * (0.1 + 1.3e-6 * (loads - 300.0))) * 4096 for side in ("left", "right")
    }
    made = altered(with_loads(made, loads[:, None].repeat(2, axis=1)), distance_m=far + drawn, **counts)
    law = fit_campaign(made).law
    for single in (False, True):
        spread = law.covariance_at((700.0, 700.0), 1e-3, single_run=single)
        alike = spread[0, 1] / np.sqrt(spread[0, 0] * spread[1, 1])
        assert alike == pytest.approx(1.0, abs=0.02)
        assert spread[2, 2] == pytest.approx(1e-6)
    read = load_coefficients_of(made)
    np.testing.assert_allclose(read.covariance(single_run=True)[:4, :4], law.covariance(single_run=True)[:4, :4])


def load_coefficients_of(made: Campaign) -> RadiusLaw:
    fit = replace(fit_campaign(made), provenance={})
    return CoefficientFile.model_validate_json(from_fit(fit, inputs={}).to_bytes()).law


def test_one_wrong_row_is_named_alone() -> None:
    """Loads on either side of the middle mirror each other: neither like loads nor all other rows are exchanged."""
    loads = np.resize([(300.0, 1100.0), (700.0, 700.0), (1100.0, 300.0)], (N, 2))
    loads = loads + np.random.default_rng(6).normal(0.0, 0.5, (N, 2))
    made = with_loads(driven(), loads)
    counts = {}
    for side, load, radius in zip(("left", "right"), loads.T, (0.10009, 0.09988), strict=True):
        true = (radius - 1.3e-6 * (load - 300.0)) * (1.0 + 1e-4 * np.random.default_rng(7).standard_normal(N))
        counts[f"counts_{side}"] = np.floor(made.runs.number("distance_m") / (2 * np.pi * true) * 4096.0)
    found = fit_campaign(loads_exchanged(altered(made, **counts), np.arange(N) == 6)).implausible
    assert all("exchanged in r6, they scatter" in text or "exchanged in r6, or" in text for text in found)
    assert not any(" more" in text for text in found)
    assert len(found) == 2


def test_a_straight_law_over_heavy_loads_is_no_scatter_and_no_turn() -> None:
    """Radii that change by 6 % of a span, on both sides against each other: no run is omitted, nothing is wrong."""
    loads = np.resize([(800.0, 5000.0), (3000.0, 3000.0), (5000.0, 800.0)], (N, 2))
    made = with_loads(driven(), loads)
    distance = made.runs.number("distance_m")
    counts = {
        f"counts_{side}": np.floor(distance / (2 * np.pi * (0.1 - 1.45e-6 * (load - 800.0))) * 4096.0)
        for side, load in zip(("left", "right"), loads.T, strict=True)
    }
    fit = fit_campaign(altered(made, **counts))
    assert (fit.implausible, fit.radii.left_out) == ((), ())
    shuffled = {name: column[np.random.default_rng(9).permutation(N)] for name, column in counts.items()}
    assert fit_campaign(altered(made, **shuffled)).implausible
