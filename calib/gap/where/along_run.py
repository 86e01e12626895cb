"""Where inside the run the gap opens: a zone, a joint, the turns, the stops."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from calib.campaign.model import Campaign
from calib.gap.data.channels import Channel
from calib.gap.data.observations import Observations
from calib.gap.where.result import PlaceLine
from calib.gap.where.stretches import CHANNELS, FEWEST_RUNS, scan_route
from calib.gap.where.traces import Trace, traces_of
from calib.gap.where.windows import compare_windows

FALSE_FINDING: Final = 0.05


def find_places(
    campaign: Campaign, observations: Observations, rng: np.random.Generator
) -> tuple[tuple[PlaceLine, ...], tuple[str, ...]]:
    """Say where inside the runs the gap opens, smallest p first, and what cannot be asked of these runs.

    A run's calibration, that is an offset and a slope of the gap along the way, is left out first. The rest is searched
    for a stretch over which it grows, on the same route by all of its runs (corridor runs out and back by their place
    on the floor), and compared between turns and straights, stops and none. All p values are multiplied by the number
    of places looked at; the chance of any false place is 5 %.
    """
    traces = traces_of(campaign.included(), observations)
    if not traces:
        return (), ("no log has a continuous reference or range_m: where inside a run the gap opens cannot be said",)
    groups: dict[str, list[Trace]] = {}
    for trace in traces:
        groups.setdefault(trace.kind, []).append(trace)
    notes: list[str] = []
    n_tests = 0
    candidates: list[PlaceLine] = []
    for kind, group in groups.items():
        if len(group) < FEWEST_RUNS:
            notes.append(
                f"{kind or 'a route'}: fewer than {FEWEST_RUNS} runs with a trace; no place along it is sought"
            )
            continue
        both_ways = len({trace.back for trace in group}) == 2
        for channel in CHANNELS:
            for signed in (False, True) if both_ways and channel is Channel.HEADING else (False,):
                stretch = scan_route(kind, group, channel, rng, signed=signed)
                if stretch is not None:
                    candidates.append(stretch[0])
                    n_tests += stretch[1]
    compared = compare_windows(traces)
    n_tests += len(compared)
    corrected = [
        replace(place, p_value=float(min(1.0, place.p_value * max(n_tests, 1)))) for place in (*candidates, *compared)
    ]
    places = sorted((place for place in corrected if place.p_value <= FALSE_FINDING), key=lambda place: place.p_value)
    return tuple(places), tuple(notes)
