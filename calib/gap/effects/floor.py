"""Places on the floor, its slope, and differences between the directions of travel."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np

from calib.gap import Perturbation
from calib.gap.effects import Effect, Family, Form, Parameter, always, on_both, varies
from calib.gap.observations import STRAIGHT_RAD, Channel, Observations
from calib.gap.observations.routes import ROUTE_LENGTH_SHARE, lane_names
from calib.gap.predict import GUIDED_TURN_RAD, Path, predict
from calib.types import BoolArray, FloatArray, IntArray

#: a manoeuvre is shorter
LEAST_BACKWARD_M: Final = 0.5


def common_frame(observations: Observations) -> bool:
    """Return whether a place on the floor is the same place in every run: in a map, or from one mark, out and back.

    A window of a recording has a place in a map only.
    """
    return observations.common_frame and (not observations.windowed or bool(np.isfinite(observations.start_pose).all()))


def far_end_m(observations: Observations) -> FloatArray:
    """Return where on x each observation starts: 0, or for straight runs back the corridor's length, shape (n_obs,).

    The length is the median measured one of the runs out of about the same length (else of those back).
    """
    distance, along = observations.measured[:, Channel.DISTANCE], np.abs(observations.measured[:, Channel.ALONG])
    length = np.where(np.isfinite(distance), distance, np.where(np.isfinite(along), along, observations.length_m))
    straight = np.abs(observations.total(observations.turn_rad)) < GUIDED_TURN_RAD
    back, out = straight & (observations.heading_sign < 0), straight & (observations.labels["direction"] == "out")
    start = np.zeros(len(observations))
    for route in np.unique(observations.kind[back]):
        mine = back & (observations.kind == route)
        with np.errstate(divide="ignore", invalid="ignore"):
            alike = np.abs(np.log(length / np.median(length[mine]))) < ROUTE_LENGTH_SHARE
        start[mine] = np.median(length[out & alike if (out & alike).any() else mine])
    return start


def lanes(observations: Observations) -> IntArray:
    """Return the lane of each observation: 0, or a number for each ending of the kind of route (``_b``, ``_2``)."""
    # the empty name sorts first: without one, the first ending is 1 all the same
    _, number = np.unique(np.append(lane_names(observations.labels["kind"]), ""), return_inverse=True)
    return np.asarray(number[:-1], dtype=np.int64)


def map_heading_rad(path: Path) -> FloatArray:
    """Return the heading on the floor at the middle of each step, shape (n_steps,)."""
    observations = path.s
    start, assumed = observations.start_pose[:, 2], np.where(observations.heading_sign < 0.0, np.pi, 0.0)
    return path.steps.mid_rad + np.where(np.isfinite(start), start, assumed)[observations.unit]


def floor_place(path: Path, far_end_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the place on the floor at the middle of each step in m, each shape (n_steps,).

    In a map observations start where they were seen; else runs out at the origin along x, runs back the other way, in a
    corridor from its far end (`far_end_m`).
    """
    s, steps = path.s, path.steps
    assumed = np.stack([far_end_m, np.zeros(len(s)), np.where(s.heading_sign < 0.0, np.pi, 0.0)], axis=1)
    known = np.isfinite(s.start_pose).all(axis=1, keepdims=True)
    x, y, heading = np.where(known, s.start_pose, assumed)[s.unit].T
    c, sn = np.cos(heading), np.sin(heading)
    return x + c * steps.x_m - sn * steps.y_m, y + sn * steps.x_m + c * steps.y_m


CELL_M: Final = 2.0
#: strips at most, and half as many cells
MAX_STRIPS: Final = 40
MIN_RUNS_IN_CELL: Final = 3
#: cosines of headings further apart are both ways
BOTH_WAYS_COSINE: Final = 1.0 + 1e-6
#: of cells, numbered (lane, column, row) in one integer
_GRID_WIDTH: Final = 2**16
#: lane number of a strip across all lanes
_STRIP_LANE: Final = -1


class FloorZone(Effect):
    """Within a cell of the floor: a relative change of the way, a turn per metre, the same or by the heading driven."""

    id = "floor_zone"
    title = "a zone of the floor that shortens the way or turns the vehicle"
    implausible = "a step or joint that the vehicle should not be driven over"
    family = Family.FLOOR
    needs = "logs, the poses in one frame"
    separates = "runs that cross the place beside runs that do not"
    not_transferable = "what lies at a place of the floor is mended there; a vehicle's correction acts everywhere"
    by_place = True

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for each strip and cell of about 2 m that some runs cross and others not, or otherwise."""
        if not common_frame(observations) or np.count_nonzero(observations.from_log) < MIN_RUNS_IN_CELL:
            return []
        lane, far_end = lanes(observations), far_end_m(observations)
        places: WeakKeyDictionary[Path, tuple[FloatArray, FloatArray, FloatArray]] = WeakKeyDictionary()

        def located(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
            return *floor_place(path, path.s.here(far_end)), np.cos(map_heading_rad(path))

        def place(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
            if path not in places:
                places[path] = located(path)
                places[path][0][~path.s.from_log[path.s.unit]] = np.inf
            return places[path]

        x, y, cosine = predict(observations).of_parts(lambda part: np.stack(located(part), axis=1)).T
        cells = _cells(observations, lane[observations.unit], x, y, cosine)
        along = Parameter("along", "1", typical=1e-3, largest=2e-2)
        turns = tuple(Parameter(name, "rad/m", typical=1e-3, largest=2e-2) for name in ("turn", "turn_by_heading"))

        def form(number: int, x: float, y: float, both_ways: bool) -> Form:
            strip = number == _STRIP_LANE

            def perturbations(path: Path) -> list[Perturbation]:
                at_x, at_y, cosine = place(path)
                inside = np.flatnonzero(np.abs(at_x - x) < 0.5 * CELL_M)
                if not strip:
                    inside = inside[np.abs(at_y[inside] - y) < 0.5 * CELL_M]
                    inside = inside[path.s.here(lane)[path.s.unit[inside]] == number]
                share, way, by_heading = np.zeros((3, len(at_x)))
                share[inside], way[inside] = 1.0, np.abs(path.s.path_m[inside])
                by_heading[inside] = way[inside] * cosine[inside]
                pulls = (way, by_heading) if both_ways else (way,)
                return [on_both(share), *(Perturbation(heading_rad=pull) for pull in pulls)]

            where = ", whole width" if strip else f", y {y:g} m" + (f", lane {number + 1}" if lane.max() > 0 else "")
            parameters = (along, *turns) if both_ways else (along, turns[0])
            settings = {"x_m": x, "y_m": y, "lane": float(number), "size_m": CELL_M}
            label, tries = f"x {x:g} m{where}", len(cells)
            return Form(self.id, label, parameters, perturbations, settings, tries, by_parts=True)

        return [form(*cell) for cell in cells]


def _cells(
    observations: Observations, lane: IntArray, x: FloatArray, y: FloatArray, cosine: FloatArray
) -> list[tuple[int, float, float, bool]]:
    flat, one_lane = np.zeros_like(y), np.full_like(lane, _STRIP_LANE)
    aside = bool((lane != lane[0]).any()) or bool((np.abs(y) > 0.5 * CELL_M).any())
    grids = [(one_lane, flat), (lane, y)] if aside else [(one_lane, flat)]
    kept: list[tuple[int, float, float, bool]] = []
    for of_lane, across in grids:
        most = MAX_STRIPS if across is flat else MAX_STRIPS // 2
        zones = _grid(observations, of_lane, x, across, cosine, 0.5)
        if 2 * len(zones) <= most:
            # a zone that lies across the edge of two cells fills one of the second grid
            zones += _grid(observations, of_lane, x, across, cosine, 1.0)
        zones.sort(key=lambda zone: -zone[0])
        kept += sorted(cell for _, cell in zones[:most])
    return kept


def _grid(
    observations: Observations, lane: IntArray, x: FloatArray, y: FloatArray, cosine: FloatArray, shift: float
) -> list[tuple[float, tuple[int, float, float, bool]]]:
    way = np.where(observations.from_log[observations.unit], np.abs(observations.path_m), 0.0)
    column = np.floor(x / CELL_M + 0.5 - shift).astype(np.int64)
    row = np.floor(y / CELL_M + 0.5).astype(np.int64)
    code = lane + 1
    for place in (column, row):
        code = code * _GRID_WIDTH + np.clip(place, -_GRID_WIDTH // 4, _GRID_WIDTH // 4) + _GRID_WIDTH // 2
    _, firsts, cell = np.unique(code, return_index=True, return_inverse=True)
    shape = (len(observations), len(firsts))
    flat = observations.unit * shape[1] + cell
    in_cell, heading = (np.bincount(flat, part, shape[0] * shape[1]).reshape(shape) for part in (way, way * cosine))
    visits = in_cell > 0.25 * CELL_M
    lateral = bool(observations.usable[:, Channel.LATERAL].any())
    zones = []
    for number in np.flatnonzero(visits.sum(axis=0) >= MIN_RUNS_IN_CELL):
        seen, ways = visits[:, number], in_cell[observations.from_log, number]
        both_ways = bool(np.ptp(heading[seen, number] / in_cell[seen, number]) > BOTH_WAYS_COSINE)
        spread, mean = float(np.std(ways)), float(np.mean(ways))
        if spread < 0.05 * mean and not (both_ways and lateral):
            continue
        first = firsts[number]
        centre = (float(column[first] + shift) * CELL_M, float(row[first]) * CELL_M)
        zones.append((spread + (mean if both_ways else 0.0), (int(lane[first]), *centre, both_ways)))
    return zones


MAX_LANES: Final = 8
#: a run that turns by more in all is no lane
MAX_LANE_TURN_RAD: Final = 2.5


class FloorUndulation(Effect):
    """On one lane the way is shorter than what the wheels roll by <z'^2> / 2, never longer."""

    id = "floor_undulation"
    title = "an uneven floor on one lane"
    implausible = "both effective radii on that lane, or a path that weaves"
    family = Family.FLOOR
    needs = "two lanes"
    separates = "the same runs on another lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        lane = observations.number("lane")
        groups: list[tuple[str, BoolArray]] = []
        if varies(lane, 0.0, observations):
            groups = [(f"lane {value:g}", lane == value) for value in np.unique(lane)]
        elif common_frame(observations):
            # only routes that run straight along the hall are lanes
            kind, turn = observations.labels["kind"], observations.turn_rad
            swings = observations.total(np.abs(turn)) > MAX_LANE_TURN_RAD
            bent = swings | (np.abs(observations.total(turn)) > STRAIGHT_RAD)
            names = [name for name in np.unique(kind) if not bent[kind == name].any()]
            groups = [(f"route {name}", kind == name) for name in names]
        if not 1 < len(groups) <= MAX_LANES:
            return []
        parameter = Parameter("excess", "1", typical=2.5e-4, largest=2e-3, sign=1)

        shorter = [(label, on_both(np.where(mine, -1.0, 0.0))) for label, mine in groups]
        return self.offer([(label, (parameter,), always(less)) for label, less in shorter])


class RearDrag(Effect):
    """One wheel travels a share more for its counts, in one rolling sense only, forward or backward.

    Where no run rolls backward the ``direction`` label stands for it, out against back.
    """

    id = "rear_drag"
    title = "a rear wheel that drags one way"
    implausible = "unequal radii, or a brake that does not release"
    family = Family.DIRECTION
    of_rear_wheels = True
    needs = "runs forward and backward"
    separates = "the same way forward and backward"
    shifts = ("radius_scale", "unequal_radii")

    def forms(self, observations: Observations) -> list[Form]:
        """Return a form for each wheel and sense; none where everything rolls and goes one way."""
        backward = observations.total(np.where(observations.path_m < 0.0, -observations.path_m, 0.0))
        rolls_back, applied = bool((backward > LEAST_BACKWARD_M).any()), observations.applied
        # of each sense, the observations that have it; None: steps tell
        senses: dict[str, tuple[BoolArray | None, bool]] = {}
        if rolls_back or applied:
            one_way = bool(((backward < 1e-3) | (backward > observations.length_m - 1e-3)).all())
            ahead = observations.total(observations.path_m) > 0.0 if one_way else None
            senses |= {"rolling forward": (ahead, True), "rolling backward": (ahead, False)}
        if applied or (not rolls_back and varies(observations.heading_sign, 0.0, observations)):
            out = observations.heading_sign > 0.0
            senses |= {"going out": (out, True), "going back": (out, False)}
        parameters = (Parameter("relative", "1", typical=5e-4, largest=5e-3),)

        def form(side: str, label: str, ahead: BoolArray | None, sense: bool) -> Form:
            def perturbations(path: Path) -> list[Perturbation]:
                forward = path.s.path_m >= 0.0 if ahead is None else path.s.here(ahead)
                part = np.asarray(forward == sense, dtype=np.float64)
                return [Perturbation(left=part) if side == "left" else Perturbation(right=part)]

            label, tries = f"{side} wheel, {label}", 2 * len(senses)
            return Form(self.id, label, parameters, perturbations, tries=tries, by_parts=True)

        return [form(side, label, *which) for label, which in senses.items() for side in ("left", "right")]


class TravelDirection(Effect):
    """dr / r = d sigma for both wheels, sigma +1 out and -1 back, or +1 rolling forward and -1 rolling backward."""

    id = "travel_direction"
    title = "a difference between directions of travel"
    implausible = "a sloping floor, or a start mark that differs"
    family = Family.DIRECTION
    needs = "runs out and back, or forward and backward"
    separates = "the vehicle turned by 180 degrees on the same lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        sigma = observations.heading_sign
        labelled = np.isin(observations.labels["direction"], ("out", "back"))
        parameter = Parameter("relative", "1", typical=1e-3, largest=5e-3)
        senses: dict[str, FloatArray] = {}
        if varies(sigma, 0.0, observations):
            senses = {"along the corridor alone": np.where(labelled, sigma, 0.0), "other routes as out": sigma}
            if labelled.all():
                senses = {"": sigma}
        offers = [(label, (parameter,), always(on_both(sense))) for label, sense in senses.items()]
        backward = observations.of_parts(lambda part: part.total(np.where(_rolls_back(part), -part.path_m, 0.0)))
        by_label = bool(senses) and np.array_equal(sigma < 0.0, backward > 0.5 * observations.length_m)
        if observations.applied or ((backward > LEAST_BACKWARD_M).any() and not by_label):
            offers.append(("rolling forward or backward", (parameter,), _by_rolling))
        return [replace(form, by_parts=form.perturbations is _by_rolling) for form in self.offer(offers)]


def _by_rolling(path: Path) -> list[Perturbation]:
    return [on_both(np.where(_rolls_back(path.s), -1.0, 1.0))]


def _rolls_back(observations: Observations) -> BoolArray:
    return np.maximum(observations.travel_left_m, observations.travel_right_m) < 0.0


_Share = Callable[[FloatArray], FloatArray]


def _to_the_right(heading_rad: FloatArray) -> FloatArray:
    return -np.sin(heading_rad)


class FloorSlope(Effect):
    """By the heading phi on the floor: radii ~ cos(phi - phi_0) with phi_0 downhill, pull or drift ~ sin(phi_0 - phi).

    Where it slopes across a corridor, pull and drift go as cos(phi): to the left going out, to the right going back.
    A vehicle that drifts moves sideways with its wheels rolling straight: its heading keeps what the wheels say.
    """

    id = "floor_slope"
    title = "a sloping floor"
    implausible = "a difference between driving out and back of another cause"
    family = Family.DIRECTION
    needs = "runs in two headings, the poses in one frame"
    separates = "the vehicle turned by 180 degrees on the same lane"
    shifts = ("radius_scale",)

    def forms(self, observations: Observations) -> list[Form]:
        """See `Effect`."""
        if not common_frame(observations):
            return []
        heading = predict(observations).of_parts(map_heading_rad)
        way = np.abs(observations.path_m)
        length = np.maximum(observations.length_m, 1e-9)
        along, across = (observations.total(way * part(heading)) / length for part in (np.cos, np.sin))
        if not (varies(along, 0.2, observations) or varies(across, 0.2, observations)):
            return []
        radii = Parameter("radii", "1", typical=2e-4, largest=2e-3)
        pull = Parameter("pull", "rad/m", typical=2e-4, largest=5e-3)
        drift = Parameter("drift", "1", typical=1e-3, largest=2e-2)
        sided = observations.applied or bool((observations.total(way * np.abs(np.sin(heading))) > 0.02 * length).any())

        def acts(one: Parameter, share: FloatArray, way: FloatArray) -> Perturbation:
            if one.name.startswith(radii.name):
                return on_both(share)
            pulls = one.name.startswith(pull.name)
            return Perturbation(heading_rad=way * share) if pulls else Perturbation(lateral_m=way * share)

        offered: list[tuple[str, dict[Parameter, _Share]]] = [
            ("along x, radii alone", {radii: np.cos}),
            ("across, pull alone", {pull: np.cos}),
            ("across, drift alone", {drift: np.cos}),
        ]
        if sided:
            radii_x, radii_y, pull_x, pull_y, drift_x, drift_y = (
                replace(one, name=f"{one.name}_{axis}") for one in (radii, pull, drift) for axis in ("x", "y")
            )
            offered += [
                ("along x, radii and pull", {radii: np.cos, pull: np.sin}),
                ("any direction, radii alone", {radii_x: np.cos, radii_y: np.sin}),
                ("any direction, pull alone", {pull_x: _to_the_right, pull_y: np.cos}),
                ("any direction, drift alone", {drift_x: _to_the_right, drift_y: np.cos}),
            ]

        def perturbations(path: Path, parts: dict[Parameter, _Share]) -> list[Perturbation]:
            heading, way = map_heading_rad(path), np.abs(path.s.path_m)
            return [acts(one, share(heading), way) for one, share in parts.items()]

        offers = [(label, tuple(parts), partial(perturbations, parts=parts)) for label, parts in offered]
        return self.offer(offers, by_parts=True)
