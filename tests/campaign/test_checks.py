"""Each check finds its fault and leaves a sound campaign alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.check import CHECKS, check_campaign
from calib.errors import RefusedError
from calib.radius.fit import fit_campaign
from tests.campaign.faults import (
    FAULTS,
    Fault,
    faster_back,
    in_feet,
    number,
    scaled,
    turning,
    warmer_each_session,
    without_logs,
)
from tests.campaign.making import campaign, wandering, with_log_columns, with_numbers


def test_headings_on_a_map_are_absolute() -> None:
    """A turn to the left that ends at a negative heading is sound there; without a log nothing is known."""
    made = turning(-1.0)(campaign())
    logs = campaign().logs
    heading = np.concatenate([np.linspace(-3.2, -1.6, length) for length in logs.lengths])
    here = replace(made, reference=replace(made.reference, frame="map"))
    assert not list(CHECKS["turn_direction"](here))
    columns = {"t_s": logs.columns["t_s"], "ref_theta_rad": heading}
    assert not list(CHECKS["turn_direction"](replace(here, logs=replace(logs, columns=columns))))
    columns["ref_theta_rad"] = -heading
    assert list(CHECKS["turn_direction"](replace(here, logs=replace(logs, columns=columns))))


@pytest.mark.parametrize(("fault", "said"), [(wandering, []), (in_feet, ["are they in feet?"])])
def test_positions_on_a_map_are_judged_from_the_start(fault: Fault, said: list[str]) -> None:
    """However far the map's origin lies, and wherever a run leads; without a start nothing is known."""
    made, heading = fault(campaign()), 2.0
    x, y = (made.runs.number(name) for name in ("ref_x_m", "ref_y_m"))
    end = 5000.0 - 300.0j + (x + 1j * y) * np.exp(1j * heading)
    theta = made.runs.number("ref_theta_rad") + heading
    made = with_numbers(made, ref_x_m=end.real, ref_y_m=end.imag, ref_theta_rad=theta)
    made = replace(made, reference=replace(made.reference, frame="map"))
    n = int(made.logs.offsets[-1])
    start = {"ref_x_m": np.full(n, 5000.0), "ref_y_m": np.full(n, -300.0), "ref_theta_rad": np.full(n, heading)}
    placed = replace(made, logs=replace(made.logs, columns={**made.logs.columns, **start}))
    assert [note.text.partition("; ")[2].partition("; ")[2] for note in CHECKS["implausible"](placed)] == said
    assert not list(CHECKS["implausible"](made))


def test_positions_in_degrees_on_the_globe_are_named() -> None:
    """A degree of latitude is 111 km: they move by a hundred-thousandth of what the wheels rolled."""
    made = campaign()
    rolled = np.concatenate([np.linspace(0.0, 8.0, length) for length in made.logs.lengths])
    path = {"ref_x_m": 11.0 + 9e-6 * rolled, "ref_y_m": 48.0 + 0.0 * rolled}
    placed = replace(made, logs=replace(made.logs, columns={**made.logs.columns, **path}))
    placed = replace(placed, reference=replace(placed.reference, frame="map"))
    assert any("degrees of latitude and longitude?" in note.text for note in CHECKS["implausible"](placed))


def test_a_ratio_that_all_runs_of_such_loads_have_is_not_swapped() -> None:
    """Loads that lie mirrored beside a step of the radii, which the other runs do not know."""
    made = without_logs(campaign(runs_per_load=4))
    payload = made.runs.number("payload_kg")
    heavy, light = payload == payload.max(), payload == 0
    kept = made.select((heavy & (np.cumsum(heavy) <= 2)) | (light & (np.cumsum(light) <= 4)))
    few = kept.runs.number("payload_kg") > 0
    left, right = (kept.runs.number(f"counts_{side}") for side in ("left", "right"))
    mirrored = left / np.median((right / left)[~few])
    stepped = with_numbers(kept, counts_right=np.where(few, mirrored, right))
    assert not list(CHECKS["swapped_wheels"](stepped))


@pytest.mark.parametrize(("check", "code", "level", "fault", "run_id"), FAULTS)
def test_a_fault_is_found_where_it_is(check: str, code: str, level: str, fault: Fault, run_id: str) -> None:
    found = list(CHECKS[check](fault(campaign())))
    assert [note for note in found if (note.code, note.level, note.run_id) == (code, level, run_id)], found
    if run_id and code not in {"distance_disagrees", "distance_span", "wrapped_total"}:
        # one spoilt run is not reported as many
        assert {note.run_id for note in found} == {run_id}


@pytest.mark.parametrize("check", CHECKS)
def test_every_check_has_a_fault_to_find(check: str) -> None:
    assert check in {name for name, *_ in FAULTS}


@pytest.mark.parametrize("seed", range(8))
def test_a_sound_campaign_is_left_alone(seed: int) -> None:
    report = check_campaign(campaign(seed=seed))
    assert report.sound
    assert (report.wrong, report.suspicious, report.info) == ((), (), ())


@pytest.mark.parametrize("seed", range(8))
def test_runs_that_wander_with_the_right_track_and_distance_are_left_alone(seed: int) -> None:
    """However the wheels differ from run to run: their difference leaves the bow alone."""
    report = check_campaign(wandering(campaign(seed=seed), seed=seed))
    assert report.suspicious == ()


def test_the_track_that_the_bows_want_is_named() -> None:
    """Within the few percent that 30 runs tell."""
    (found,) = CHECKS["track_against_bows"](wandering(campaign(), track_m=0.6))
    named = float(found.text.rsplit("is the track ", 1)[1].split(" m?")[0])
    assert abs(named / 0.6 - 1.0) < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_straight_runs_whose_wheels_slip_say_nothing_of_the_track(seed: int) -> None:
    """A guide keeps the runs straight, slip and unequal radii bend what the counts say: the slope of noise is none."""
    made, rng = wandering(campaign(seed=seed), seed=seed), np.random.default_rng(seed)
    logs = made.logs
    apart = np.cumsum(rng.normal(0.0, 10.0, len(logs.columns["t_s"])))
    rolled = (logs.columns["counts_left"] + logs.columns["counts_right"]) / 2
    columns = {"counts_left": 1.002 * rolled - apart, "counts_right": 0.998 * rolled + apart}
    slipped = with_numbers(
        with_log_columns(made, **columns),
        ref_y_m=rng.normal(0.0, 2e-3, len(made.runs)),
        ref_theta_rad=rng.normal(0.0, 8e-4, len(made.runs)),
    )
    assert list(CHECKS["track_against_bows"](slipped)) == []


def test_turns_that_agree_are_left_alone() -> None:
    assert list(CHECKS["turn_direction"](turning(1.0)(campaign()))) == []


def test_the_reason_of_a_factor_is_named() -> None:
    """Counts a factor 2, 4 or pi off are told apart."""
    for factor, word in ((2.0, "twice"), (4.0, "four times"), (np.pi, "pi times too many"), (0.25, "quarter")):
        (found,) = CHECKS["count_scale"](scaled(factor)(campaign()))
        assert word in found.text


def test_an_excluded_run_is_kept_and_not_complained_about() -> None:
    made = number("counts_left", lambda c: c / 2, 4)(campaign())
    flagged = made.runs.excluded.copy()
    flagged[4] = True
    report = check_campaign(replace(made, runs=replace(made.runs, excluded=flagged)))
    assert report.suspicious == ()
    assert (report.found.n_runs, report.found.n_excluded) == (30, 1)


def test_a_campaign_of_excluded_runs_alone_is_wrong_and_fits_nothing() -> None:
    made = campaign()
    none = replace(made, runs=replace(made.runs, excluded=np.ones(len(made.runs), dtype=bool)))
    report = check_campaign(none)
    assert not report.sound and "are flagged as excluded" in report.wrong[0].text
    with pytest.raises(RefusedError, match="flagged as excluded"):
        fit_campaign(none)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("side", "other"), [("left", "right"), ("right", "left")])
def test_the_wheel_that_counts_backwards_is_the_one_to_negate(side: str, other: str) -> None:
    """Headings of straight runs may fit either sign; the counts' own does not."""
    made = campaign()
    left, right = (made.runs.number(f"counts_{each}") / made.encoder.counts_per_rev_left for each in ("left", "right"))
    # headings of the other sense than the counts': the wrong wheel fits better
    turned = (left - right) * 2 * np.pi * made.vehicle.wheel_radius_m / made.vehicle.track_m
    back = {f"counts_{side}": -made.runs.number(f"counts_{side}"), "ref_theta_rad": turned}
    said = " ".join(note.text for note in check_campaign(without_logs(with_numbers(made, **back))).wrong)
    assert f"the {side} wheel counts backwards in every straight run" in said
    assert f"negate counts_{other}" not in said


@pytest.mark.filterwarnings("error")
def test_distances_of_zero_are_told_without_a_warning() -> None:
    made = campaign()
    assert check_campaign(with_numbers(made, distance_m=0.0 * made.runs.number("distance_m"))).wrong


def test_one_load_a_session_is_said_to_be_inseparable() -> None:
    notes = [note.text for note in check_campaign(campaign(crossed=False)).suspicious]
    assert len(notes) == 1
    assert "cannot be told apart" in notes[0]


@pytest.mark.parametrize("apart", [True, False])
def test_loads_that_go_with_the_direction_are_said_to_be_inseparable(apart: bool) -> None:
    made = campaign(logs=False)
    out = np.arange(30) % 2 > 0 if apart else made.runs.number("payload_kg") > 75.0
    labels = {**made.runs.labels, "direction": np.where(out, "out", "back")}
    codes = [note.code for note in check_campaign(replace(made, runs=replace(made.runs, labels=labels))).suspicious]
    assert codes == ([] if apart else ["ordered_load"])


def test_columns_that_change_apart_are_left_alone() -> None:
    """Runs of a session at several temperatures, and both speeds in both directions."""
    made = warmer_each_session(campaign(), within_K=1.0)
    both = with_numbers(made, speed_mps=np.where(np.arange(len(made.runs)) % 4 < 2, 0.3, 0.6))
    assert not list(CHECKS["columns_as_one"](both))
    names = [note.where for note in CHECKS["columns_as_one"](faster_back(warmer_each_session(campaign())))]
    assert names == ["runs, columns speed and direction", "runs, columns temperature and order of the sessions"]


def test_the_summary_counts_what_is_there() -> None:
    found = check_campaign(campaign()).found
    assert (found.n_runs, found.n_logs, found.sessions["s1"]) == (30, 30, 6)
    assert found.payloads_kg == (0.0, 50.0, 100.0, 150.0, 200.0)
    assert found.rate_Hz == pytest.approx((20.0, 20.0), rel=1e-9)


@pytest.mark.parametrize("reset", [False, True])
def test_counts_that_run_on_are_told_as_such_alone(reset: bool) -> None:
    """Whether or not each session begins at zero; factors of single runs are none."""
    made = campaign(logs=False)
    session = made.runs.label("session")
    summed = {}
    for side in ("left", "right"):
        counts = made.runs.number(f"counts_{side}")
        parts = [np.cumsum(counts[session == one]) for one in dict.fromkeys(session.tolist())]
        summed[f"counts_{side}"] = np.concatenate(parts) if reset else np.cumsum(counts)
    report = check_campaign(with_numbers(made, **summed))
    assert [note.where for note in report.wrong] == ["runs, columns counts_left, counts_right"]
    assert "grow from run to run" in report.wrong[0].text
    assert report.suspicious == ()
