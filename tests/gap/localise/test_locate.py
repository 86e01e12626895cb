"""Where the gap lies: channels, covariates by Holm's steps, runs, and places inside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from statsmodels.regression.linear_model import OLS
from statsmodels.stats.multitest import multipletests

from calib.campaign.model import Campaign
from calib.gap.inference.fit import fit
from calib.gap.inference.noise import Noise, estimate_noise
from calib.gap.localise import FALSE_FINDING_PROBABILITY, Trace, _slope, compare_windows
from calib.gap.localise.locate import (
    CovariateResult,
    GapLocation,
    holm_corrected,
    locate,
)
from calib.gap.observations import Channel
from calib.gap.observations.from_campaign import observations_of
from calib.gap.predict import Path, predict, residuals
from calib.plant.design import good_design, poor_design
from calib.plant.effects import find
from calib.plant.make import make_campaign
from calib.types import FloatArray


def seen(campaign: Campaign) -> tuple[Path, Noise, FloatArray]:
    s = observations_of(campaign)
    nominal = predict(s)
    gap = residuals(nominal, nominal)
    base = fit(nominal, estimate_noise(nominal, gap))
    return nominal, estimate_noise(base.path, base.left), gap


def located(
    campaign: Campaign, nominal: Path, noise: Noise, gap: FloatArray, left: FloatArray | None = None, seed: int = 0
) -> GapLocation:
    """Where a gap lies, shown against the noise level; nothing of it explained by default."""
    rng = np.random.default_rng(seed)
    return locate(nominal, noise, gap, noise.floor, gap if left is None else left, campaign, rng)


def table(campaign: Campaign) -> dict[str, CovariateResult]:
    made = located(campaign, *seen(campaign))
    return {line.name: line for line in made.covariates}


def made(effect: str, times: float, seed: int = 5, needs: frozenset[str] = frozenset()) -> Campaign:
    rng = np.random.default_rng(seed)
    design = good_design(rng, n_runs=60, needs=needs)
    return make_campaign(design, {effect: times * find(effect, "").typical}, rng)


def test_without_a_gap_few_campaigns_show_any_covariate() -> None:
    """Of 5 campaigns without a gap at most 2 show anything: at 5 % each that fails once in 860 times."""
    false = 0
    for seed in range(5):
        rng = np.random.default_rng(300 + seed)
        design = good_design(rng, n_runs=40) if seed % 2 else poor_design("corridor_only", rng)
        false += any(line.significant for line in table(make_campaign(design, {}, rng)).values())
    assert false <= 2


@pytest.mark.parametrize(
    ("effect", "covariate", "channel"),
    [
        ("track_width", "turn", Channel.HEADING),
        ("temperature_radius", "temperature_C", Channel.DISTANCE),
        ("travel_direction", "direction", Channel.DISTANCE),
    ],
)
def test_the_covariate_that_an_effect_acts_through_leads_the_table(
    effect: str, covariate: str, channel: Channel
) -> None:
    found = table(made(effect, 3.0))
    first = next(iter(found.values()))
    assert first.name == covariate
    assert first.channel is channel
    assert first.significant
    assert first.ci95 is not None
    assert first.ci95[0] <= first.share <= first.ci95[1]
    assert first.share > 0.8


def test_a_share_is_that_of_the_variance_beyond_the_floor() -> None:
    """Closed form: a gap a x + b y with independent x, y beyond unit noise has shares a^2 and b^2 of their sum."""
    campaign = made("track_width", 0.0)
    nominal, noise, _ = seen(campaign)
    s = nominal.s
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, len(s)))
    x, y = (x - x.mean()) / x.std(), y - y.mean()
    y -= x * (x @ y) / (x @ x)
    y /= y.std()
    gap = np.zeros((len(s), 6))
    gap[:, 3] = noise.floor[:, 3] * (8.0 * x + 6.0 * y)
    given = {**s.numbers, "payload_kg": x}
    object.__setattr__(s, "numbers", given)
    shares = {line.name: line for line in located(campaign, nominal, noise, gap).covariates}
    # 64 of 100; the noise level's own unit variance, absent here, and the degree of freedom move it by 1 to 2 %
    assert shares["payload_kg"].share == pytest.approx(0.64, abs=0.03)
    assert shares["payload_kg"].channel is Channel.HEADING


def test_the_worst_run_stands_first() -> None:
    campaign = made("track_width", 0.0)
    nominal, noise, gap = seen(campaign)
    s = nominal.s
    gap = gap.copy()
    gap[7, 3] = 50 * noise.floor[7, 3]
    worst = located(campaign, nominal, noise, gap).runs[0]
    assert worst.run_id == str(s.labels["run_id"][7])
    assert worst.channel is Channel.HEADING
    # 50 noise levels were put in
    assert worst.z == pytest.approx(50.0, rel=1e-9)


def test_channels_say_root_mean_square_and_floor_of_what_was_measured_only() -> None:
    rng = np.random.default_rng(1)
    campaign = make_campaign(poor_design("squares_one_load", rng), {}, rng)
    nominal, noise, gap = seen(campaign)
    s = nominal.s
    where = located(campaign, nominal, noise, gap)
    assert where.channel(Channel.DISTANCE) is None
    on = s.usable[:, 3]
    heading = where.channel(Channel.HEADING)
    assert heading is not None
    assert heading.rms == pytest.approx(np.sqrt(np.mean(gap[on, 3] ** 2)), rel=1e-12)


@pytest.mark.parametrize("seed", [5, 6])
def test_a_zone_of_the_floor_is_found_where_it_was_put(seed: int) -> None:
    """The zone's ends lie within half a metre of the true ones, and within their intervals or a grid step of them."""
    rng = np.random.default_rng(seed)
    design = good_design(rng, n_runs=60, needs={"trace", "corridor"})
    campaign = make_campaign(design, {"track_width": 0.0}, rng)
    nominal, noise, gap = seen(campaign)
    zone = (6.0, 8.0)
    logs = campaign.logs
    x, theta = logs.columns["ref_x_m"].copy(), logs.columns["ref_theta_rad"]
    corridor = np.flatnonzero(design.kind == "corridor")
    for run in corridor:
        part = slice(int(logs.offsets[run]), int(logs.offsets[run + 1]))
        at = design.length_m - x[part] if design.direction[run] == "back" else x[part]
        inside = np.clip((at - zone[0]) / (zone[1] - zone[0]), 0.0, 1.0)
        # the wheels slip by 10 mm there: the reference falls behind them
        x[part] -= 0.010 * (inside if design.direction[run] != "back" else 1.0 - inside) * np.cos(theta[part])
    object.__setattr__(campaign, "logs", type(logs)(logs.offsets, {**logs.columns, "ref_x_m": x}))
    places = located(campaign, nominal, noise, gap, seed=seed).places
    found = next(place for place in places if place.where == "zone" and place.route == "corridor")
    assert found.channel is Channel.ALONG
    assert found.place is not None and found.place_ci95 is not None
    for end, true in enumerate(zone):
        assert found.place[end] == pytest.approx(true, abs=0.5)
        low, high = found.place_ci95[end]
        assert low - 0.25 <= true <= high + 0.25
    # 10 mm were lost
    assert abs(found.size) == pytest.approx(0.010, rel=0.1)


def test_a_wrong_track_opens_in_the_turns() -> None:
    campaign = made("track_width", 3.0, needs=frozenset({"trace"}))
    places = located(campaign, *seen(campaign)).places
    assert places[0].where == "turns"
    assert places[0].channel is Channel.HEADING
    # heading gained per radian of turn is minus the relative error of the track: three times the typical 1 %
    typical = find("track_width", "").typical
    assert places[0].size == pytest.approx(-3 * typical, rel=0.1)


def test_the_stated_place_of_the_sensor_opens_no_gap_in_turns() -> None:
    """A sensor beside the axle moves along by its arm times the turn, as the vehicle does not."""
    campaign = made("track_width", 3.0, needs=frozenset({"trace"}))
    arm, yaw = 0.2 + 0.1j, 0.3
    columns = campaign.logs.columns
    turned = np.exp(1j * columns["ref_theta_rad"])
    # the sensor's motion since the start, in the frame of its own start
    at = (columns["ref_x_m"] + 1j * columns["ref_y_m"] + arm * (turned - 1.0)) * np.exp(-1j * yaw)
    logs = replace(campaign.logs, columns={**columns, "ref_x_m": at.real, "ref_y_m": at.imag})
    reference = replace(campaign.reference, sensor_x_m=arm.real, sensor_y_m=arm.imag, sensor_yaw_rad=yaw)
    aside = replace(campaign, reference=reference, logs=logs)
    (before, *_), (place, *others) = (located(each, *seen(each)).places for each in (campaign, aside))
    assert (place.where, place.channel) == (before.where, before.channel) == ("turns", Channel.HEADING)
    assert place.size == pytest.approx(before.size, rel=1e-6)
    assert not [line for line in others if line.channel is Channel.ALONG]


def test_without_a_continuous_reference_no_place_is_named_and_that_is_said() -> None:
    campaign = made("track_width", 1.0)
    made_of = located(campaign, *seen(campaign))
    assert made_of.places == ()
    assert "continuous reference" in made_of.notes[0]


def test_of_a_simulator_that_gives_ends_no_place_is_named_and_that_is_said() -> None:
    """The path that opens in the turns is the model's, which is not what was simulated."""
    campaign = made("track_width", 3.0, needs=frozenset({"trace"}))
    ends = {f"sim_{name}": campaign.runs.number(f"ref_{name}") for name in ("x_m", "y_m", "theta_rad")}
    simulated = replace(campaign, runs=replace(campaign.runs, numbers={**campaign.runs.numbers, **ends}))
    made_of = located(simulated, *seen(simulated))
    assert made_of.places == ()
    assert "simulated ends have no path" in made_of.notes[0]


def line(p_value: float, share: float = 0.5) -> CovariateResult:
    return CovariateResult(f"p{p_value}", Channel.ALONG, share, None, p_value, significant=False)


@pytest.mark.parametrize("seed", range(20))
def test_the_lines_that_stand_are_those_of_statsmodels(seed: int) -> None:
    """Same p values, same decisions, no matter what order they come in."""
    rng = np.random.default_rng(seed)
    p_values = rng.uniform(size=rng.integers(1, 15)) ** rng.integers(1, 8)
    table = holm_corrected([line(float(p)) for p in p_values])
    assert [entry.p_value for entry in table] == sorted(p_values)
    stands = multipletests([entry.p_value for entry in table], alpha=FALSE_FINDING_PROBABILITY, method="holm")[0]
    assert [entry.significant for entry in table] == stands.tolist()


def test_an_empty_table_stays_empty() -> None:
    assert holm_corrected([]) == ()


def test_of_equal_p_the_larger_share_stands_first() -> None:
    assert [entry.share for entry in holm_corrected([line(0.2, 0.1), line(0.2, 0.7)])] == [0.7, 0.1]


#: two ways to the same double: matrix products in another order
ROUNDING = 1e-9


def drawn(n_runs: int, seed: int = 0) -> tuple[FloatArray, FloatArray, np.ndarray]:
    rng = np.random.default_rng(seed)
    design = np.stack([rng.uniform(0.5, 1.5, 12 * n_runs), rng.normal(size=12 * n_runs)], axis=1)
    run = np.repeat(np.arange(n_runs), 12)
    gap = design @ [0.02, -0.5] + 0.1 * rng.normal(size=n_runs)[run] + 0.05 * rng.normal(size=len(run))
    return design, gap, run


def test_few_runs_have_the_errors_of_ordinary_least_squares() -> None:
    """Statsmodels' OLS on the same rows gives the same slope, error and degrees of freedom."""
    design, gap, run = drawn(5)
    expected = OLS(gap, design).fit()
    size, error, dof = _slope(design, gap, run)
    assert size == pytest.approx(expected.params[1], rel=ROUNDING)
    assert error == pytest.approx(expected.bse[1], rel=ROUNDING)
    assert dof == expected.df_resid


def test_many_runs_have_errors_clustered_by_run() -> None:
    """Statsmodels' clustered covariance without its own small-sample factor, times runs over runs less two."""
    design, gap, run = drawn(12)
    expected = OLS(gap, design).fit(cov_type="cluster", cov_kwds={"groups": run, "use_correction": False})
    size, error, dof = _slope(design, gap, run)
    assert size == pytest.approx(expected.params[1], rel=ROUNDING)
    assert error == pytest.approx(expected.bse[1] * np.sqrt(12 / 10), rel=ROUNDING)
    assert dof == 10


def trace(run: int, per_rad: float, rng: np.random.Generator, *, ranged: bool = False) -> Trace:
    """A run of 40 m that turns by a radian in every other metre and gains heading with the turn."""
    way = np.linspace(0.0, 40.0, 401)
    turn = np.concatenate(([0.0], np.cumsum(np.where(np.floor(way[:-1]) % 2 == 1, 0.1, 0.0))))
    heading = per_rad * turn + np.concatenate(([0.0], np.cumsum(rng.normal(0, 1e-4, 400))))
    nothing = np.zeros_like(way)
    unknown = np.full_like(way, np.nan)
    return Trace(
        f"r{run}", "route", False, way, turn, way, nothing, nothing, unknown if ranged else heading, nothing, way
    )


def test_a_gap_that_grows_with_the_turn_is_found_with_its_size() -> None:
    """Heading of 0.01 rad gained per radian, walk of 1 mrad a run beside it: the interval holds the truth."""
    rng = np.random.default_rng(1)
    lines = compare_windows([trace(run, 0.01, rng) for run in range(10)])
    heading = next(line for line in lines if line.channel is Channel.HEADING and line.where == "turns")
    assert heading.ci95[0] <= 0.01 <= heading.ci95[1]
    assert heading.size == pytest.approx(0.01, rel=0.05)
    assert heading.p_value < 1e-6
    assert heading.unit == "rad/rad"
    assert heading.n_runs == 10


def test_runs_without_a_heading_are_not_asked_for_it() -> None:
    """A rangefinder alone: no line on the heading, and none of its NaN anywhere."""
    rng = np.random.default_rng(2)
    lines = compare_windows([trace(run, 0.01, rng, ranged=True) for run in range(10)])
    assert {line.channel for line in lines} == {Channel.ALONG}
    assert all(np.isfinite([line.size, *line.ci95, line.p_value]).all() for line in lines)


def test_what_is_left_is_tested_as_the_gap_is() -> None:
    """A gap that grows with the load alone correlates with it; what is left without it, with nothing."""
    campaign = made("load_radius", 20.0)
    nominal, noise, gap = seen(campaign)
    where = [located(campaign, nominal, noise, gap, left).rest for left in (gap, 0.0 * gap)]
    assert where[0] is not None
    assert where[1] is not None
    assert any("load" in line.name or "payload" in line.name for line in where[0].significant)
    assert not where[1].significant
