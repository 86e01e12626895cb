"""A departure that residuals need not show is named where it explains them, and only there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign, Logs
from calib.campaign.read import read_campaign
from calib.gap.plan.planned_runs import joined
from calib.kinematics import recording_of
from calib.kinematics.adequacy import GeometryVerdict
from calib.kinematics.departures import find_departure
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.joint_fit import drive_of, fit_parameters
from calib.kinematics.model import window_segments
from calib.kinematics.result import Geometry
from tests.blunders import plant
from tests.blunders.blunders import TRICYCLE, Change, columns_times
from tests.kinematics import campaigns, steered
from tests.kinematics.campaigns import Truth


def faults(folder: Path, change: Change | None) -> dict[str, str]:
    """Return codes and sentences of the faults that a tricycle's geometry along the path names."""
    recording = plant.tricycle(np.random.default_rng(3))
    if change is not None:
        change(recording)
    found = estimate_geometry(read_campaign(plant.write(recording, folder / "c")), using="windows")
    assert found.passed is (change is None)
    return {fault.code: fault.text for fault in found.faults}


def test_a_sound_recording_has_none(tmp_path: Path) -> None:
    assert not faults(tmp_path, None)


def test_the_play_of_a_steering_is_named_with_its_size(tmp_path: Path) -> None:
    """20 mrad, to a tenth: each curvature is reached from either side."""
    text = faults(tmp_path, TRICYCLE["steering with a play of 0.02 rad"])["steering_play"]
    play_mrad = float(text.partition("play of ")[2].partition(" mrad")[0])
    assert play_mrad == pytest.approx(20.0, rel=0.1)


def test_an_axis_that_is_squeezed_is_named(tmp_path: Path) -> None:
    """Or the other one as stretched, which is the same but for the scale of the wheels."""
    text = faults(tmp_path, columns_times(1.0, 0.95, 1.0))["axis_scale"]
    assert ("ref_y_m" in text and "short" in text) or ("ref_x_m" in text and "long" in text)


@pytest.mark.parametrize("lag_s", [0.0, 0.2])
def test_wheels_that_follow_their_angle_late_are_named(lag_s: float, tmp_path: Path) -> None:
    """Where no route is driven twice too, with the delay to a quarter; a vehicle that steers at once is calibrated."""
    folder = steered.write(tmp_path / "c", lambda angle, _: steered.late(angle, lag_s), radius_m=0.1005)
    found = estimate_geometry(read_campaign(folder))
    text = {fault.code: fault.text for fault in found.faults}.get("steering_shift", "")
    assert found.passed is (lag_s == 0.0)
    if lag_s:
        assert float(text.partition("steers ")[2].partition(" s ")[0]) == pytest.approx(lag_s, rel=0.25)


def test_a_wheelbase_that_no_vehicle_has_leads_to_the_steering_too(tmp_path: Path) -> None:
    """Play bends short changes of the angle most, as a longer wheelbase does."""
    folder = steered.write(tmp_path / "c", lambda angle, _: 0.8 * angle, drive="ackermann", runs=8)
    settings = folder / "campaign.toml"
    settings.write_text(settings.read_text().replace("wheelbase_m = 1.0", "wheelbase_m = 0.7"))
    found = estimate_geometry(read_campaign(folder))
    assert any("play or lag of the steering acts alike: see 'calib diagnose'" in sentence for sentence in found.why)


def played(angle: steered.Array, play_rad: float) -> steered.Array:
    """Return the angle of wheels that follow with a play."""
    wheel, out = 0.0, []
    for sensor in angle:
        wheel = min(max(wheel, sensor - 0.5 * play_rad), sensor + 0.5 * play_rad)
        out.append(wheel)
    return np.array(out)


@pytest.mark.parametrize("play_rad", [0.0, 0.03])
def test_play_is_named_along_the_path_of_a_car(play_rad: float, tmp_path: Path) -> None:
    """It was within the noise of short windows, and the scale of the steering made up for it."""
    folder = steered.write(
        tmp_path / "c", lambda angle, _: played(angle, play_rad), runs=3, drive="ackermann", along=True
    )
    found = estimate_geometry(read_campaign(folder))
    assert found.using == "windows"
    assert found.passed is (play_rad == 0.0)
    for name, truth in (("steering_scale", 1.0), ("wheelbase_m", steered.WHEELBASE_M)):
        # two intervals of 95 %: beyond four standard uncertainties
        if name not in found.undetermined:
            assert abs(found[name].value - truth) < 2.0 * found[name].half_width
    if play_rad:
        text = {fault.code: fault.text for fault in found.faults}["steering_play"]
        assert float(text.partition("play of ")[2].partition(" mrad")[0]) == pytest.approx(30.0, rel=0.1)


#: legs at several speeds and yaw rates, since each lasts as long
ROUTE = [(2.0, 0.0), (0.0, 0.0), (1.0, 1.5), (0.0, -2.0), (3.0, 0.5), (0.0, 0.0), (1.5, -2.5), (0.5, 1.0)]


def recorded(truth: Truth, samples: int = 300) -> Campaign:
    """Return four recordings of a minute, two of them mirrored."""
    routes = [("route", [(way, sense * turn) for way, turn in ROUTE]) for sense in (1, -1, 1, -1)]
    rng = np.random.default_rng(1)
    return campaigns.campaign(routes, truth, rng, along=True, walk=1e-3, duration_s=60.0, samples=samples)


def along(truth: Truth) -> Geometry:
    return estimate_geometry(recorded(truth), using="windows")


def test_a_clock_that_runs_fast_is_told_from_a_slow_one() -> None:
    """By the residuals, in one step of a linear model, which is small against the rate: to a third."""
    made = recorded(Truth(delay_s=0.06, clock_rate=0.005), samples=1200)
    recording = recording_of(made, "rear")
    segments = window_segments(recording, 40)
    fitted = fit_parameters(made, drive_of(made, "rear", recording), recording, segments, sensor=True)
    found = find_departure(fitted, misfit=True)
    assert found is not None
    departure, size = found
    assert departure.named(size).code == "clock_rate" and " % fast " in departure.named(size).text
    assert size == pytest.approx(0.005, rel=1.0 / 3.0)


@pytest.mark.parametrize("rate", [0.0, -0.002])
def test_a_clock_at_another_rate_is_named_and_the_radii_corrected(rate: float) -> None:
    truth = Truth(delay_s=0.06, clock_rate=rate)
    found = along(truth)
    assert found.passed is (rate == 0.0)
    for name in ("radius_left_m", "radius_right_m", "track_m"):
        assert abs(found[name].value - getattr(truth, name)) < 2.0 * found[name].half_width
    if rate:
        text = {fault.code: fault.text for fault in found.faults}["clock_rate"]
        per_cent, _, sense = text.partition("runs ")[2].partition(" % ")
        assert float(per_cent) == pytest.approx(100.0 * abs(rate), rel=0.1)
        assert sense.startswith("slow")


def test_recordings_that_begin_on_the_move_hold_a_late_reference() -> None:
    """The pose at the first count is late, too: of the motion before it, and not of a vehicle that stood."""
    truth, rng = Truth(delay_s=0.15), np.random.default_rng(3)
    routes = [("route", [(way + 2.0, turn + sense) for way, turn in ROUTE]) for sense in (1.0, -1.0) * 8]
    made = campaigns.campaign(routes, truth, rng, along=True, duration_s=20.0)
    t_s = made.logs.columns["t_s"]
    keep = t_s >= 4.0
    columns = {name: column[keep] for name, column in made.logs.columns.items()}
    per_run = np.add.reduceat(keep, made.logs.offsets[:-1], dtype=np.int64)
    logs = Logs(np.concatenate(([0], np.cumsum(per_run))), columns | {"t_s": columns["t_s"] - 4.0})
    found = estimate_geometry(replace(made, logs=logs), using="windows")
    for name in ("radius_left_m", "radius_right_m", "track_m", "delay_s"):
        assert abs(found[name].value - getattr(truth, name)) < 2.0 * found[name].half_width
    assert found.passed


def of_both_lengths(delays_s: tuple[float, float], rate: float) -> Geometry:
    """Return the geometry of recordings of half a minute and of thrice that, with a delay each at the start."""
    rng, parts = np.random.default_rng(2), []
    for lasts_s, delay_s in zip((30.0, 90.0), delays_s, strict=True):
        routes = [("route", [(way, sense * turn) for way, turn in ROUTE * int(lasts_s / 30.0)]) for sense in (1, -1)]
        truth = Truth(delay_s=delay_s, clock_rate=rate)
        parts.append(
            campaigns.campaign(
                routes,
                truth,
                rng,
                along=True,
                walk=1e-3,
                duration_s=lasts_s,
                samples=int(15.0 * lasts_s),
                sigma=(5e-4, 5e-4),
            )
        )
    both = joined(*parts)
    names = np.array([f"r{number}" for number in range(len(both.runs))])
    runs = replace(both.runs, labels={**both.runs.labels, "run_id": names, "session": names})
    return estimate_geometry(replace(both, runs=runs), using="windows")


def test_a_clock_that_recordings_of_different_lengths_hide_is_named() -> None:
    """A delay of each recording takes most of it up, and the radii the rest."""
    found = of_both_lengths((0.0, 0.0), 1e-3)
    assert [fault.code for fault in found.faults] == ["clock_rate"] and not found.delays
    # without it they are a thousandth off, and no residual shows it
    assert found["radius_left_m"].value == pytest.approx(Truth().radius_left_m, rel=2e-4)


def test_delays_of_their_own_are_no_clock() -> None:
    """Longer recordings have the longer delay here, as with a clock, but the same at start and end."""
    found = of_both_lengths((0.02, 0.08), 0.0)
    assert found.delays and not found.faults
    assert found["radius_left_m"].value == pytest.approx(Truth().radius_left_m, rel=2e-4)


#: headings that walk by 1 mrad a root metre leave a slip open by 0.4 % (scatter over seeds), three of these
SLIP_WITHIN = 1.2


@pytest.mark.parametrize(
    ("truth", "code"),
    [
        (Truth(), ""),
        (Truth(slip_s_per_rad=0.02), "turn_slip"),
        # far from small beside what is known of the windows
        (Truth(slip_s_per_rad=0.06), "turn_slip"),
        (Truth(slip_s_per_m=0.1), "speed_slip"),
        (Truth(side_slip_s=0.1), "outward_slip"),
    ],
)
def test_slip_that_grows_with_yaw_rate_or_speed_or_outward_is_doubtful(truth: Truth, code: str) -> None:
    found = along(truth)
    assert found.verdict is (GeometryVerdict.DOUBTFUL if code else GeometryVerdict.CALIBRATED)
    assert [fault.code for fault in found.faults] == [code] * bool(code)
    slip = max(truth.slip_s_per_rad, truth.slip_s_per_m, truth.side_slip_s)
    assert not code or float(found.faults[0].text.split()[4]) == pytest.approx(100.0 * slip, abs=SLIP_WITHIN)


@pytest.mark.parametrize("side_slip_s", [0.0, 0.1])
def test_a_sensor_that_slip_in_turns_displaces_is_never_calibrated(side_slip_s: float) -> None:
    """Residuals refuse the windows, too, and ends by themselves, where headings differ, are another cause's."""
    routes = [("route", [(way, sense * turn) for way, turn in ROUTE]) for sense in (1, -1) * 5]
    truth, rng = Truth(side_slip_s=side_slip_s), np.random.default_rng(1)
    found = estimate_geometry(campaigns.campaign(routes, truth, rng, along=True, walk=1e-3, duration_s=20.0))
    assert found.using == "windows" and found.passed is (side_slip_s == 0.0)
    assert [fault.code for fault in found.faults] == ["outward_slip"] * bool(side_slip_s)
    off_m = abs(found["sensor_x_m"].value)
    assert (off_m > found["sensor_x_m"].half_width) is (side_slip_s > 0.0)


@pytest.mark.parametrize("strafe", [0.0, 0.06])
def test_rollers_that_slip_to_the_side_are_named(strafe: float) -> None:
    """Six parts of a hundred of the way to the side, the commonest fault of such a drive."""
    found = estimate_geometry(campaigns.mecanum(np.random.default_rng(4), strafe=strafe))
    assert found.verdict is (GeometryVerdict.DOUBTFUL if strafe else GeometryVerdict.CALIBRATED)
    assert [fault.code for fault in found.faults] == ["strafe_slip"] * bool(strafe)
    assert not strafe or float(found.faults[0].text.split()[4]) == pytest.approx(100.0 * strafe, abs=SLIP_WITHIN)


def test_counters_that_wrap_at_any_number_are_named() -> None:
    """At 30,000 counts; the estimate is that of the counts unwrapped."""
    made = campaigns.campaign(campaigns.mixed(1), Truth(), np.random.default_rng(1), samples=400)
    columns = {name: part % 30000 if name.startswith("counts") else part for name, part in made.logs.columns.items()}
    found = estimate_geometry(replace(made, logs=replace(made.logs, columns=columns)))
    assert [fault.code for fault in found.faults] == ["counts_wrap"]
    assert "30000" in found.faults[0].text
    assert found.ratio("radius_right_m", "radius_left_m").value == pytest.approx(0.0498 / 0.0505, rel=1e-3)
