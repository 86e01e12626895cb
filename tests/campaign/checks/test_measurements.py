"""Checks of the wheel loads against the payload."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.checks.measurements import distance_span, implausible_loads, loads_against_payload
from calib.campaign.model import Campaign
from calib.campaign.read import loads_from_payload
from tests.campaign.making import campaign, with_numbers


def _without_places(payload_kg: Sequence[float] | None = None, seed: int = 5) -> Campaign:
    """A sound campaign that does not say where the payload lies, so that no load follows from the vehicle."""
    made = campaign(logs=False, seed=seed)
    numbers = {name: cells for name, cells in made.runs.numbers.items() if name not in ("payload_x_m", "payload_y_m")}
    made = replace(made, runs=replace(made.runs, numbers=numbers))
    if payload_kg is None:
        return made
    payload = np.resize(np.asarray(payload_kg, dtype=float), len(made.runs))
    loads = {f"load_{side}_N": 300.2 + 4.0 * payload for side in ("left", "right")}
    return with_numbers(made, payload_kg=payload, **loads)


@pytest.mark.parametrize("runs", [[7], [4, 17]])
def test_a_load_that_contradicts_its_payload_is_named_without_a_place(runs: list[int]) -> None:
    """The empty vehicle's loads beside a payload of 50 to 200 kg leave the line of the other runs."""
    made = _without_places()
    loaded = np.isin(np.arange(len(made.runs)), runs)
    empty = {
        f"load_{side}_N": np.where(loaded, 300.0, made.runs.number(f"load_{side}_N")) for side in ("left", "right")
    }
    found = list(loads_against_payload(with_numbers(made, **empty)))
    assert [note.run_id for note in found] == [f"r{run:03d}" for run in runs]
    right = made.runs.number("load_left_N") + made.runs.number("load_right_N")
    for note, run in zip(found, runs, strict=True):
        assert "found 600 N" in note.text
        assert float(note.text.split("ask for ")[1].split(" N")[0]) == pytest.approx(right[run], rel=0.01)


@pytest.mark.parametrize("payload_kg", [None, [0], [0, 200], [0] * 29 + [200], [0] * 14 + [200], range(0, 300, 10)])
def test_loads_that_rise_with_the_payload_are_left_alone(payload_kg: Sequence[float] | None) -> None:
    """Also a payload that was driven once or twice, of which no other run tells the load."""
    assert list(loads_against_payload(_without_places(payload_kg))) == []


def test_payloads_at_several_places_are_left_alone() -> None:
    """Loads that differ with the place of the payload scatter about the line, and none is far from it."""
    made = _without_places()
    share = np.array([3.0, 4.0, 5.5, 6.0])[np.arange(len(made.runs)) % 4]
    loads = 300.2 + share * made.runs.number("payload_kg")
    assert list(loads_against_payload(with_numbers(made, load_left_N=loads, load_right_N=loads))) == []


def _placed(share: float, factor: float, *assumed: str, payload: bool = True) -> Campaign:
    """Loads in units of `factor`: both rear wheels carry a share of vehicle (100 kg) and payload."""
    made = _without_places()
    loads = 0.5 * share * 9.81 * (100.0 + made.runs.number("payload_kg")) * factor
    made = with_numbers(made, load_left_N=loads, load_right_N=loads)
    numbers = {name: cells for name, cells in made.runs.numbers.items() if payload or name != "payload_kg"}
    return replace(made, runs=replace(made.runs, numbers=numbers), assumed=assumed)


MASS, PLACE = "vehicle.mass_kg", ("vehicle.cog_x_m", "vehicle.wheelbase_m")
KG, TWICE = "are they in kg", "are they in N times 9.81"


@pytest.mark.parametrize("share", [0.21, 0.5, 1.0])
@pytest.mark.parametrize(("factor", "unit"), [(1 / 9.81, KG), (9.81, TWICE)])
def test_a_payload_tells_the_unit_of_the_loads_without_a_mass(share: float, factor: float, unit: str) -> None:
    """A kilogram adds at most its weight of 9.81 N to two wheels, and no load of use adds less than a fifth of it."""
    found = [note.text for note in loads_against_payload(_placed(share, factor, MASS, *PLACE))]
    assert sum(unit in text for text in found) == 1
    assert not any("are they in" in note.text for note in loads_against_payload(_placed(share, 1.0, MASS, *PLACE)))


@pytest.mark.parametrize("share", [0.25, 0.6, 1.0])
def test_a_stated_mass_tells_the_unit_wherever_its_centre_is(share: float) -> None:
    """Two wheels carry a fifth of the empty vehicle to all of it; a place that nobody stated says no more."""
    for factor, said in ((1 / 9.81, [KG]), (1.0, [])):
        made = _placed(share, factor, *PLACE, payload=False)
        made = replace(made, vehicle=replace(made.vehicle, wheelbase_m=2.5))
        assert [note.text.split("; ")[-1].partition(":")[0] for note in implausible_loads(made)] == said


def test_loads_of_some_runs_in_kilograms_are_told_by_the_least_share_of_the_weight() -> None:
    """One session of four in kg: a tenth of the weight on two wheels; those of all runs are another finding."""
    made = _placed(0.5, 1.0, *PLACE)
    of_session = made.runs.label("session") == "s2"
    loads = np.where(of_session, 1 / 9.81, 1.0) * made.runs.number("load_left_N")
    (found,) = implausible_loads(with_numbers(made, load_left_N=loads, load_right_N=loads))
    assert f"in {of_session.sum()} runs" in found.text and KG in found.text
    assert not list(implausible_loads(made))


def test_the_empty_vehicle_tells_a_unit_either_way() -> None:
    """Three runs without payload are no column of their own; where none is known to be empty all may be laden."""
    for payload, said in ((True, 1), (False, 0)):
        made = _placed(0.612, 9.81, payload=payload)
        kg = _without_places().runs.number("payload_kg")
        made = made.select((kg > 0) | (np.cumsum(kg == 0) <= 3))
        assert sum(TWICE in note.text for note in implausible_loads(made)) == said


@pytest.mark.parametrize(("factor", "unit"), [(1e2, "distance_cm"), (1e3, "distance_mm")])
def test_the_unit_of_a_distance_beyond_the_rangefinder_is_told_by_the_wheels(factor: float, unit: str) -> None:
    made = campaign()
    longer = np.where(made.runs.label("session") == "s2", factor, 1.0) * made.runs.number("distance_m")
    found = [note.text for note in distance_span(with_numbers(made, distance_m=longer))]
    assert len(found) == 6
    assert all(unit in text for text in found)


@pytest.mark.parametrize(
    ("left", "right", "off_N", "level"),
    [
        (1.05, 1.05, 0.0, "info"),
        (0.96, 1.0, 0.0, "info"),
        (1.015, 1.015, 0.0, ""),
        (1.0, 1.0, 90.0, "suspicious"),
        (1.12, 1.0, 0.0, "suspicious"),
    ],
)
def test_loads_that_are_off_alike_are_told_once(left: float, right: float, off_N: float, level: str) -> None:
    """Of a few per cent, within which a vehicle's statics are known, it is a remark; beyond, a finding of all runs."""
    made = campaign(logs=False)
    loads = (made.runs.number(f"load_{side}_N") * by for side, by in (("left", left), ("right", right)))
    spoilt = with_numbers(made, load_left_N=next(loads) + off_N, load_right_N=next(loads))
    found = list(loads_against_payload(spoilt))
    assert [note.level for note in found] == [level] * bool(level)
    assert not found or off_N or f"{left:.4g}"[:4] in found[0].text
    assert not any(note.run_id for note in found)


def test_a_scale_that_reads_low_in_all_runs_is_no_fault_of_the_heaviest() -> None:
    """Of payloads to one side the wheel beneath is off by more than statics may be, and by the same share as all."""
    made = campaign(logs=False)
    aside = with_numbers(made, payload_y_m=np.where(np.arange(len(made.runs)) % 7 == 3, 0.25, 0.02))
    left, right = loads_from_payload(aside.vehicle, aside.runs)
    low = with_numbers(aside, load_left_N=0.92 * left, load_right_N=0.92 * right)
    (found,) = loads_against_payload(low)
    assert (found.level, found.run_id) == ("suspicious", "")
    assert "0.92 and 0.92 times" in found.text
    # one of them weighed otherwise is its own fault
    light = np.where(np.arange(len(left)) == 3, 0.7, 0.92)
    alone = with_numbers(aside, load_left_N=light * left, load_right_N=light * right)
    assert "r003" in {note.run_id for note in loads_against_payload(alone)}


def test_an_own_load_that_was_assumed_contradicts_no_scale() -> None:
    """The centre of gravity moves load from one axle to the other: with it unknown, only the payload's part is told."""
    made = campaign(logs=False)
    loads = {f"load_{side}_N": made.runs.number(f"load_{side}_N") + 60.0 for side in ("left", "right")}
    heavier = with_numbers(made, **loads)
    assert list(loads_against_payload(heavier))
    assumed = replace(heavier, assumed=("vehicle.cog_x_m",))
    assert not list(loads_against_payload(assumed))
    loads["load_left_N"][5] *= 1.5
    (note,) = loads_against_payload(replace(with_numbers(made, **loads), assumed=("vehicle.cog_x_m",)))
    assert note.run_id == str(made.runs.run_id[5])


def test_loads_that_scatter_or_that_nobody_described_are_no_finding_of_all_runs() -> None:
    """Off by 6 % either way they are single runs at most, and a vehicle that was assumed asks for nothing."""
    made = campaign(logs=False)
    by = 1.0 + 0.06 * np.random.default_rng(3).standard_normal(len(made.runs))
    left = made.runs.number("load_left_N")
    assert all(note.run_id for note in loads_against_payload(with_numbers(made, load_left_N=by * left)))
    scaled = with_numbers(made, load_left_N=1.04 * left)
    assert list(loads_against_payload(replace(scaled, assumed=("vehicle.mass_kg",)))) == []
