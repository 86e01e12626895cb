"""Checks of counters: what a jump of one means, and a wheel that does not count."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.checks.counts import (
    clock,
    count_jumps,
    dead_counters,
    interrupted_counts,
    log_speed,
    reversed_wheels,
    turn_direction,
)
from calib.campaign.checks.paths import implausible_paths
from calib.campaign.model import Logs
from calib.campaign.read import read_campaign
from tests.campaign.making import campaign, with_log_columns, with_numbers
from tests.kinematics import campaigns as driven
from tests.kinematics.test_named_blunders import Columns, changed


def test_a_jump_of_a_whole_counter_is_named_as_its_overflow() -> None:
    """Where no width is known, a jump of 65536 counts is said to be the overflow of a 16-bit counter."""
    made = campaign(runs_per_load=1)
    counts = 0.2 * made.logs.columns["counts_left"]
    part = slice(made.logs.offsets[3], made.logs.offsets[4])
    counts[part] -= 65536.0 * (np.arange(part.stop - part.start) > 700)
    (found,) = count_jumps(with_log_columns(made, counts_left=counts))
    assert "a 16-bit counter overflows in 1 run(s) (" in found.text
    assert "give encoder.wrap_bits = 16" in found.text
    counts[part] += 30000.0 * (np.arange(part.stop - part.start) > 700)
    (found,) = count_jumps(with_log_columns(made, counts_left=counts))
    assert "wrap_bits" not in found.text and "first in sample 702 by -35" in found.text


def test_counts_that_overflow_show_no_turn_the_other_way() -> None:
    """A counter that jumps by twice what it turned says that one run turned the other way; its log tells the jump."""
    made = driven.campaign(driven.both_ways(2), driven.Truth(), np.random.default_rng(3), along=True, samples=80)
    left, right = (made.runs.number(f"counts_{side}").copy() for side in ("left", "right"))
    jump = 2.0 * (left[0] - right[0])
    right[0] += jump
    other = with_numbers(made, counts_right=right)
    assert [note.run_id for note in turn_direction(other)] == [made.runs.run_id[0]]
    counts = made.logs.columns["counts_right"].copy()
    counts[made.logs.offsets[0] + 40 : made.logs.offsets[1]] += jump
    assert not list(turn_direction(with_log_columns(other, counts_right=counts)))


def _read(tmp_path: Path, turned: np.ndarray, step_s: float) -> tuple[np.ndarray, list[str]]:
    """The counts of a log of two wheels as read, and the codes of the notes of the reading."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "campaign.toml").write_text('format = "calib-campaign/1"\n[vehicle]\ndrive = "differential"\n')
    (tmp_path / "runs.csv").write_text("run_id,session\nr1,d1\n")
    rows = [f"{step_s * number:.3f},{counts:.0f},{counts:.0f}" for number, counts in enumerate(turned)]
    (tmp_path / "logs" / "r1.csv").write_text("\n".join(["t_s,counts_left,counts_right", *rows]) + "\n")
    made = read_campaign(tmp_path)
    return made.logs.columns["counts_left"], [note.code for note in made.notes]


def test_overflows_of_a_counter_that_is_read_seldom_are_undone(tmp_path: Path) -> None:
    """Steps of a third of the counter's span leave no doubt, as long as none comes near half of it."""
    driven = np.concatenate([np.zeros(4), np.cumsum(np.tile([9000.0, 16000.0, 22000.0, 16000.0], 10))])
    counts, codes = _read(tmp_path, np.mod(driven + 42364, 65536), 0.5)
    assert np.array_equal(counts - counts[0], driven)
    assert "wrap" in codes


def test_a_counter_that_is_reset_did_not_overflow(tmp_path: Path) -> None:
    """A reset near the top of a counter's span is no overflow: undone, it is no step like the others."""
    driven = np.cumsum(np.full(400, 150.0))
    driven[390:] -= driven[389]
    counts, codes = _read(tmp_path, driven, 0.05)
    assert np.array_equal(counts, driven)
    assert "wrap" not in codes


def test_a_wheel_without_a_count_is_no_sound_campaign() -> None:
    """Single runs are named; a column that is empty of counts throughout is said once."""
    made = campaign(logs=False)
    right = made.runs.number("counts_right")
    dead = np.arange(len(right)) % 9 == 3
    found = list(dead_counters(with_numbers(made, counts_right=right * ~dead)))
    assert [note.run_id for note in found] == ["r003", "r012", "r021"]
    (found,) = dead_counters(with_numbers(made, counts_right=0.0 * right))
    assert "in 30 runs" in found.text


def test_a_turn_about_a_wheel_is_no_dead_counter() -> None:
    """A wheel about which the vehicle turns, as the reference says too, counts nothing rightly."""
    made = campaign(logs=False)
    n = len(made.runs)
    turn = 2 * np.pi * made.vehicle.wheel_radius_m * 3.0 / made.vehicle.track_m
    pivots = with_numbers(
        made, counts_left=np.zeros(n), counts_right=np.full(n, 3 * 4096.0), distance_m=np.full(n, np.nan)
    )
    assert list(dead_counters(pivots)) == []
    turned = with_numbers(pivots, ref_theta_rad=np.full(n, turn), distance_m=np.full(n, 1.2))
    assert list(dead_counters(turned)) == []


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1e3, "milliseconds"), (1e6, "microseconds"), (1 / 86400, "days"), (1.0, ""), (20.0, ""), (1 / 20, "")],
)
def test_a_speed_that_no_vehicle_drives_names_the_clock(factor: float, said: str) -> None:
    """All logs alike, without a set speed; 25 mm/s and 10 m/s are slow and fast, but driven."""
    made = campaign(logs=True)
    numbers = {name: cells for name, cells in made.runs.numbers.items() if name != "speed_mps"}
    made = replace(made, runs=replace(made.runs, numbers=numbers))
    timed = with_log_columns(made, t_s=factor * made.logs.columns["t_s"])
    found = [note.text for note in log_speed(timed)]
    assert [f"is it in {said}?" in text for text in found] == [True] * bool(said)


def test_a_wheel_that_stands_is_not_slow() -> None:
    """Its counter trembles by a count."""
    made = campaign(logs=True)
    still = {f"counts_{side}": np.arange(made.logs.offsets[-1]) % 2.0 for side in ("left", "right")}
    assert not [note for note in log_speed(with_log_columns(made, **still)) if note.code == "clock_unit"]


def way_m(log: Columns) -> np.ndarray:
    return np.cumsum(np.hypot(*(np.diff(log[name], prepend=log[name][0]) for name in ("ref_x_m", "ref_y_m"))))


BLUNDERS = {
    "millimetres": lambda log: {name: 1e3 * log[name] for name in ("ref_x_m", "ref_y_m")},
    "the vertical axis": lambda log: {"ref_y_m": 0.15 + 1e-3 * np.sin(np.arange(len(log["ref_y_m"])))},
    "both one column": lambda log: {"counts_right": log["counts_left"]},
    "sound": lambda log: {},
    # wheels that differ bend a straight path, at an even speed
    "a straight line": lambda log: {"ref_x_m": way_m(log), "ref_y_m": 0.0 * log["ref_y_m"]},
}


@pytest.mark.parametrize("headings", [True, False])
@pytest.mark.parametrize("blunder", BLUNDERS)
def test_paths_by_reference_and_wheels_are_of_one_length_and_plane(blunder: str, headings: bool) -> None:
    """In any frame, with headings or without; what went straight is no vertical axis."""
    squares = [("s", driven.square(2.0, s)) for s in (1, -1) * 2]
    made = driven.campaign(squares, driven.Truth(), np.random.default_rng(1), along=True)

    def damaged(log: Columns) -> Columns:
        out = log | BLUNDERS[blunder](log)
        return out if headings else {name: values for name, values in out.items() if name != "ref_theta_rad"}

    notes = [(note.level, blunder in note.text) for note in implausible_paths(changed(made, damaged))]
    assert notes == [("wrong", True)] * (blunder not in {"sound", "a straight line"})


def test_a_sensor_beside_the_axle_moves_in_turns_on_the_spot() -> None:
    """The axle's middle does not: nothing tells the unit of positions there."""
    spins = [(f"spin_{s}", [(0.0, s * 6.3)]) for s in (1, -1) * 3]
    truth = driven.Truth(sensor=(0.3, 0.1, 0.0))
    made = driven.campaign(spins, truth, np.random.default_rng(1), along=True)
    assert not list(implausible_paths(made))


def test_logs_that_are_all_uneven_are_one_line() -> None:
    """One that is uneven among even ones is named by its run."""
    made = campaign(runs_per_load=1)
    time, starts = made.logs.columns["t_s"].copy(), made.logs.offsets[:-1]
    time[starts[1] + 100 : made.logs.offsets[2]] += 3.0
    assert [note.run_id for note in clock(with_log_columns(made, t_s=time))] == [str(made.runs.run_id[1])]
    for first, end in zip(starts, made.logs.offsets[1:], strict=True):
        time[first + 200 : end] += 3.0
    (found,) = clock(with_log_columns(made, t_s=time))
    assert found.level == "suspicious" and "of 5 of 5 logs come unevenly" in found.text


#: what becomes of the counts of two samples in twenty -> whether they are lost
INTERRUPTED = {
    "lost": (lambda step, kept: step * kept, True),
    "held and made up for": (
        lambda step, kept: np.diff(np.maximum.accumulate(np.cumsum(step) * kept), prepend=0.0),
        False,
    ),
    "sound": (lambda step, kept: step, False),
}


@pytest.mark.parametrize("sides", [("left",), ("left", "right")])
@pytest.mark.parametrize("what", INTERRUPTED)
def test_counts_that_stand_still_between_samples_at_full_speed_are_lost(what: str, sides: tuple[str, ...]) -> None:
    """A log that holds the last value for two samples has the counts in the third."""
    made, (change, lost) = campaign(logs=True), INTERRUPTED[what]

    def changed_log(log: Columns) -> Columns:
        kept = np.arange(len(log["t_s"])) % 20 >= 2
        names = [f"counts_{side}" for side in sides]
        return log | {name: np.cumsum(change(np.diff(log[name], prepend=log[name][0]), kept)) for name in names}

    notes = list(interrupted_counts(changed(made, changed_log)))
    # two of twenty, but for those at the ends
    share = [float(note.text.partition("for ")[2].partition(" %")[0]) for note in notes]
    assert [note.where.count("counts_") for note in notes] == [len(sides)] * lost and all(
        9.0 <= percent <= 10.0 for percent in share
    )


@pytest.mark.parametrize("of", ["increments", "totals", "scattered stamps"])
def test_rows_that_are_missing_take_their_increments_along(of: str) -> None:
    """One of ten: a total holds them in the next row, and stamps that scatter leave none out."""
    made, rng = campaign(logs=True), np.random.default_rng(1)

    def changed_log(log: Columns) -> Columns:
        if of == "scattered stamps":
            scatter = rng.normal(scale=0.35 * np.diff(log["t_s"]).mean(), size=len(log["t_s"]))
            return log | {"t_s": np.sort(log["t_s"] + scatter)}
        rows = np.arange(len(log["t_s"])) % 10 != 5
        steps = {name: np.diff(log[name], prepend=log[name][0]) for name in ("counts_left", "counts_right")}
        kept = {name: cells[rows] for name, cells in log.items()}
        return kept | ({name: np.cumsum(step[rows]) for name, step in steps.items()} if of == "increments" else {})

    logs = [changed_log(made.logs.of(run)) for run in range(len(made.runs))]
    offsets = np.concatenate(([0], np.cumsum([len(log["t_s"]) for log in logs])))
    whole = Logs(offsets, {name: np.concatenate([log[name] for log in logs]) for name in logs[0]})
    notes = list(interrupted_counts(replace(made, logs=whole)))
    assert ["rows are missing" in note.text for note in notes] == [True] * (of == "increments")
    # of the counts that are left, with the ramps at the ends
    assert all(9.0 <= float(note.text.partition("for ")[2].partition(" %")[0]) <= 12.0 for note in notes)


@pytest.mark.parametrize(("pause_s", "ramp_s"), [(0.3, 0.5), (2.0, 1.0)])
def test_a_vehicle_that_stops_and_starts_is_no_loss(pause_s: float, ramp_s: float) -> None:
    """It slows down before, and where the reference does not move either, it stood."""
    made = campaign(logs=True)

    def with_stops(log: Columns, ramp_s: float) -> Columns:
        # a stop every ten seconds: full speed, ramp, pause, ramp
        phase = np.mod(log["t_s"], 10.0) - 5.0
        speed = np.clip((np.abs(phase) - pause_s / 2) / ramp_s, 0.0, 1.0)
        way = np.cumsum(speed)
        position = {"ref_x_m": way, "ref_y_m": 0.0 * way}
        return {"counts_left": np.round(100.0 * way), "counts_right": np.round(100.0 * way), **position}

    assert not list(interrupted_counts(changed(made, lambda log: with_stops(log, ramp_s))))
    assert not list(interrupted_counts(changed(made, lambda log: with_stops(log, 1e-3))))


def test_runs_driven_backward_by_their_end_poses_have_no_reversed_wheels() -> None:
    """Counts of both wheels fall and the vehicle ends behind its start; without an end pose it is asked about."""
    made, back = campaign(runs_per_load=2), np.arange(len(campaign(runs_per_load=2).runs)) % 4 == 3
    sides = {name: np.where(back, -1.0, 1.0) * made.runs.number(name) for name in ("counts_left", "counts_right")}
    x_m = np.where(back, -1.0, 1.0) * made.runs.number("distance_m")
    assert len(list(reversed_wheels(with_numbers(made, **sides)))) == 2 * back.sum()
    assert list(reversed_wheels(with_numbers(made, **sides, ref_x_m=x_m))) == []
