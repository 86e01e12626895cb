"""Checks of the wheel loads against the payload."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.campaign.checks.measurements import loads_against_payload
from calib.campaign.model import Campaign
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
