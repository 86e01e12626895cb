"""Gross faults put right, whichever wheels are counted; of four: counters that run backwards, columns exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.geometry.drives import Drive
from calib.geometry.gross import Fault, front_faults, rear_faults, refuse_heading_unit, repaired
from calib.geometry.model import Model
from calib.geometry.recording import Recording
from calib.geometry.segments import Segments

WHEELS: Final = ("front_left", "front_right", "rear_left", "rear_right")
#: the columns as they stand count as wrong where others leave less than this part of what they leave
CLEARLY_LESS: Final = 0.25
#: and where they leave more than this part of the way and of the turns
POOR: Final = 0.1
#: readings that leave no more than this much of the least are as good
ALIKE: Final = 1.1
#: turns of less are noise
LEAST_TURN_RAD: Final = 0.05


def put_right(
    recording: Recording, segments: Segments, source: str, drive: Drive
) -> tuple[Recording, tuple[Fault, ...]]:
    """Return the recording with gross faults put right, and these faults.

    `recording`: wheels and reference; `source` ({"rear", "front", "wheels"}); `drive`: with its nominal values. Raises
    RefusedError where the reference's heading is in another unit than radians.
    """
    # first: with a heading of another unit any reading of the wheels that hardly turns would look best
    seen = segments.seen[:, 2]
    measured = segments.measured[seen, 2]
    nominal = np.array([item.nominal for item in drive.parameters])
    rest = Model(drive, recording, segments).predict(np.concatenate([nominal, np.zeros(4)])).residuals[seen, 2]
    refuse_heading_unit(measured - rest, measured)
    if source == "front":
        return front_faults(recording, segments)
    if source == "wheels":
        return wheels_faults(recording, segments, drive)
    fault = rear_faults(recording, segments)
    return (recording, ()) if fault is None else (repaired(recording, fault), (fault,))


def wheels_faults(recording: Recording, segments: Segments, drive: Drive) -> tuple[Recording, tuple[Fault, ...]]:
    """Return the recording with the wheels' signs and sides put right, and what was wrong.

    `recording`: of four wheels; `drive`: its nominal values tell which of the ways to read the four columns meets the
    reference.
    """
    nominal = np.array([item.nominal for item in drive.parameters])
    # neither sensor nor delay is known yet
    values = np.concatenate([nominal, np.zeros(4)])

    def left_by(turned: FloatArray) -> tuple[float, float]:
        return _left(Model(drive, recording.with_turned(turned), segments), values)

    turned = recording.steps.turned_rad
    as_it_stands = left_by(turned)[0]
    if as_it_stands < POOR:
        return recording, ()
    tried = [(left_by(turned[order] * signs[:, None]), fault, order, signs) for fault, order, signs in _readings()]
    least = min(left for (left, _), *_ in tried)
    if least > CLEARLY_LESS * as_it_stands:
        return recording, ()
    # two readings can differ by half a turn of the sensor alone: the one that turns it less is the likelier
    alike = [one for one in tried if one[0][0] <= ALIKE * least + 1e-9]
    _, fault, order, signs = min(alike, key=lambda one: one[0][1])
    return recording.with_turned(turned[order] * signs[:, None]), (fault,)


def _readings() -> Iterator[tuple[Fault, list[int], FloatArray]]:
    """Yield faults, with the order and the signs of the four columns that put them right."""
    same, plain = list(range(4)), np.ones(4)
    for at, wheel in enumerate(WHEELS):
        signs = plain.copy()
        signs[at] = -1.0
        text = f"the {wheel.replace('_', ' ')} counter runs backwards; correct its sign or its wiring"
        yield Fault(f"reversed_{wheel}", text), same, signs
    yield Fault("reversed_both", "all four counters run backwards; correct their signs"), same, -plain
    exchanged = [[pair] for pair in combinations(range(4), 2)] + [[(0, 1), (2, 3)], [(0, 2), (1, 3)], [(0, 3), (1, 2)]]
    for pairs in exchanged:
        order = list(same)
        for one, other in pairs:
            order[one], order[other] = other, one
        names = ", ".join(f"counts_{WHEELS[one]} and counts_{WHEELS[other]}" for one, other in pairs)
        yield Fault("swapped_wheels", f"wheels are exchanged; exchange {names}"), order, plain


def _left(model: Model, values: FloatArray) -> tuple[float, float]:
    """Return which part of the way and of the turns a reading leaves, and by how much it turns the sensor."""
    segments = model.segments
    seen = segments.seen.all(axis=1)
    measured = segments.measured[seen]
    moved = measured - model.predict(values).residuals[seen]
    if not len(measured):
        return 0.0, 0.0
    way, told = measured[:, 0] + 1j * measured[:, 1], moved[:, 0] + 1j * moved[:, 1]
    turned = float(np.angle(np.vdot(told, way)))
    rest_of_way = np.abs(way - told * np.exp(1j * turned))
    short = float(np.mean(np.square(rest_of_way)) / max(float(np.mean(np.square(np.abs(way)))), 1e-12))
    rest, turn = measured[:, 2] - moved[:, 2], float(np.mean(np.square(measured[:, 2])))
    return short + float(np.mean(np.square(rest))) / (turn + LEAST_TURN_RAD**2), abs(turned)
