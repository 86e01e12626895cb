"""Where inside the run the gap opens: a zone, a joint, the turns, the stops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calib.arrays import FloatArray, IntArray, StrArray
from calib.campaign.model import Campaign
from calib.gap.data.channels import Channel
from calib.gap.data.observations import Observations
from calib.gap.effects.shapes import MOVING_MPS
from calib.gap.where.result import PlaceLine

__all__ = ["find_places"]

FALSE_FINDING: Final = 0.05
BOOTSTRAPS: Final = 300
GRID_M: Final = 0.25
MOST_BINS: Final = 120
#: a longer zone looks like a scale of the whole run
LONGEST_SHARE: Final = 0.4
FEWEST_RUNS: Final = 4
FEWEST_WINDOWS: Final = 20
WINDOW_M: Final = 1.0
TURNING_PER_M: Final = 0.1
LEAST_TURN_RAD: Final = 0.3
CHANNELS: Final = (Channel.ALONG, Channel.HEADING)


@dataclass(frozen=True, slots=True, eq=False)
class _Trace:
    """Gap along one run: reference minus odometry, accumulated piece by piece in the vehicle's own frame.

    Parameters
    ----------
    way_m, turn_rad : array of float, shape (n,)
        Way driven and heading, by odometry.
    x_m, y_m : array of float, shape (n,)
        Place, by odometry, in the run's own frame.
    along_m, heading_rad : array of float, shape (n,)
        The accumulated gap; the second is NaN where only a rangefinder was logged.
    standing : array of bool, shape (n,)
        Whether the vehicle stood still at the sample.
    """

    run_id: str
    kind: str
    back: bool
    way_m: FloatArray
    turn_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    along_m: FloatArray
    heading_rad: FloatArray
    stops: FloatArray


def find_places(
    campaign: Campaign, observations: Observations, rng: np.random.Generator
) -> tuple[tuple[PlaceLine, ...], tuple[str, ...]]:
    """Say where inside the runs the gap opens.

    A run's calibration, that is an offset and a slope of the gap along the way, is left out first. The rest is searched
    for a stretch over which it grows, on the same route by all of its runs (corridor runs out and back by their place
    on the floor), and compared between turns and straights, stops and none. All p values are multiplied by the number
    of places looked at; the chance of any false place is 5 %.

    Parameters
    ----------
    campaign : Campaign
        Runs with logs.
    observations : Observations
        The same runs; its model drives the odometry.
    rng : numpy.random.Generator
        For the bootstrap.

    Returns
    -------
    places : tuple of PlaceLine
        Those that stand, smallest p first.
    notes : tuple of str
        What cannot be asked of these runs.
    """
    traces = _traces(campaign.included(), observations)
    if not traces:
        return (), ("no log has a continuous reference or range_m: where inside a run the gap opens cannot be said",)
    notes: list[str] = []
    groups: dict[str, list[_Trace]] = {}
    for trace in traces:
        groups.setdefault(trace.kind, []).append(trace)
    n_tests = 0
    candidates: list[PlaceLine] = []
    for kind, group in groups.items():
        if len(group) < FEWEST_RUNS:
            notes.append(
                f"{kind or 'a route'}: fewer than {FEWEST_RUNS} runs with a trace; no place along it is sought"
            )
            continue
        for channel in CHANNELS:
            for signed in (False, True) if _both_ways(group) and channel is Channel.HEADING else (False,):
                stretch = _scan(kind, group, channel, rng, signed=signed)
                if stretch is not None:
                    candidates.append(stretch[0])
                    n_tests += stretch[1]
    compared = _compare(_windows(traces))
    n_tests += len(compared)
    corrected = [
        replace(place, p_value=float(min(1.0, place.p_value * max(n_tests, 1)))) for place in (*candidates, *compared)
    ]
    places = sorted((place for place in corrected if place.p_value <= FALSE_FINDING), key=lambda place: place.p_value)
    return tuple(places), tuple(notes)


def _traces(campaign: Campaign, observations: Observations) -> list[_Trace]:
    """Return the gap along every run that has a continuous reference or a logged range."""
    first = {str(name): unit for unit, name in reversed(list(enumerate(observations.labels["run_id"])))}
    encoder, runs = campaign.encoder, campaign.runs
    kinds, directions = runs.label("kind"), runs.label("direction")
    made = []
    for run, name in enumerate(runs.run_id):
        unit = first.get(str(name))
        log = campaign.logs.of(run)
        if unit is None or not {"t_s", "counts_left", "counts_right"} <= log.keys():
            continue
        pose = {"ref_x_m", "ref_y_m", "ref_theta_rad"} <= log.keys()
        if not pose and "range_m" not in log:
            continue
        needed = ("t_s", "counts_left", "counts_right") + (
            ("ref_x_m", "ref_y_m", "ref_theta_rad") if pose else ("range_m",)
        )
        good = np.all([np.isfinite(log[column]) for column in needed], axis=0)
        if good.sum() < 10:
            continue
        left = log["counts_left"][good] * (2 * np.pi / encoder.counts_per_rev_left) * observations.radius_left_m[unit]
        right = (
            log["counts_right"][good] * (2 * np.pi / encoder.counts_per_rev_right) * observations.radius_right_m[unit]
        )
        ds = 0.5 * (np.diff(left) + np.diff(right))
        turn = (np.diff(right) - np.diff(left)) / observations.model.track_m
        heading = np.concatenate(([0.0], np.cumsum(turn)))
        middle = heading[:-1] + 0.5 * turn
        chord = ds * np.sinc(0.5 * turn / np.pi)
        x = np.concatenate(([0.0], np.cumsum(chord * np.cos(middle))))
        y = np.concatenate(([0.0], np.cumsum(chord * np.sin(middle))))
        if pose:
            ref_heading = np.unwrap(log["ref_theta_rad"][good])
            ref_middle = 0.5 * (ref_heading[1:] + ref_heading[:-1])
            step = np.diff(log["ref_x_m"][good]) * np.cos(ref_middle) + np.diff(log["ref_y_m"][good]) * np.sin(
                ref_middle
            )
            along = np.cumsum(step - chord)
            heading_gap = (ref_heading - ref_heading[0]) - heading
        else:
            along = np.abs(log["range_m"][good] - log["range_m"][good][0])[1:] - np.abs(x[1:])
            heading_gap = np.full(len(x), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            speed = np.abs(ds) / np.diff(log["t_s"][good])
        made.append(
            _Trace(
                run_id=str(name),
                kind=str(kinds[run]),
                back=str(kinds[run]).startswith("corridor") and str(directions[run]) == "back",
                way_m=np.concatenate(([0.0], np.cumsum(np.abs(ds)))),
                turn_rad=heading,
                x_m=x,
                y_m=y,
                along_m=np.concatenate(([0.0], along)),
                heading_rad=heading_gap,
                stops=_stops(np.nan_to_num(speed)),
            )
        )
    return made


def _stops(speed: FloatArray) -> FloatArray:
    """Return how many stops on the way have been made at each sample, shape (n_steps + 1,); the ends do not count."""
    moving = speed > MOVING_MPS
    if not moving.any():
        return np.zeros(len(speed) + 1)
    first, last = int(np.argmax(moving)), len(moving) - int(np.argmax(moving[::-1]))
    begins = np.zeros(len(speed) + 1)
    stopped = ~moving
    stopped[:first] = stopped[last:] = False
    begins[1:] = stopped & np.concatenate(([False], ~stopped[:-1]))
    return np.cumsum(begins)


def _both_ways(group: list[_Trace]) -> bool:
    return len({trace.back for trace in group}) == 2


def _scan(
    kind: str, group: list[_Trace], channel: Channel, rng: np.random.Generator, *, signed: bool
) -> tuple[PlaceLine, int] | None:
    """Search a route for the stretch over which a channel's gap grows, and count the stretches searched.

    Its p is that of the best stretch alone.
    """
    from scipy.special import stdtr

    values = [trace.along_m if channel is Channel.ALONG else trace.heading_rad for trace in group]
    group = [trace for trace, value in zip(group, values, strict=True) if np.isfinite(value).all()]
    values = [value for value in values if np.isfinite(value).all()]
    if len(group) < FEWEST_RUNS:
        return None
    way = [float(trace.way_m[-1]) for trace in group]
    length = float(np.median(way))
    keep = [number for number, own_way in enumerate(way) if own_way > 0.95 * length]
    if len(keep) < FEWEST_RUNS or length < 8 * GRID_M:
        return None
    spacing = max(GRID_M, length / MOST_BINS)
    grid = np.arange(0.0, 0.95 * length + 1e-9, spacing)
    on_floor = any(group[number].back for number in keep)
    if on_floor:
        grid = grid[grid >= 0.05 * length]
    gaps = np.stack([_on_grid(group[number], values[number], grid, length, on_floor) for number in keep])
    if signed:
        gaps *= np.where([group[number].back for number in keep], -1.0, 1.0)[:, None]
    starts, ends = _stretches(len(grid))
    ramp = np.clip((grid[None, :] - grid[starts][:, None]) / (grid[ends] - grid[starts])[:, None], 0.0, 1.0)
    # what goes with the turns is no matter of a place: it is asked of the turns
    turned = np.stack([_on_grid(group[number], group[number].turn_rad, grid, length, on_floor) for number in keep])
    turned = turned.mean(axis=0)
    trend = [np.ones_like(grid), grid - grid.mean()]
    if np.ptp(turned) > LEAST_TURN_RAD:
        trend.append(turned)
        bend = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(turned)))))
        if not np.allclose(bend, np.abs(turned - turned[0]), atol=0.1):
            trend.append(bend)
    basis, _ = np.linalg.qr(np.stack(trend, axis=1))
    ramp = ramp - (ramp @ basis) @ basis.T
    gaps = gaps - (gaps @ basis) @ basis.T
    norm = (ramp**2).sum(axis=1)
    ok = norm > 1e-3 * len(grid)
    ramp, norm, starts, ends = ramp[ok], norm[ok], starts[ok], ends[ok]
    sizes = gaps @ ramp.T / norm  # a run, a stretch
    n = len(keep)
    gain = sizes.mean(axis=0) ** 2 * norm
    best = int(np.argmax(gain))
    own = sizes[:, best]
    error = float(np.std(own, ddof=1) / np.sqrt(n))
    t = abs(float(own.mean())) / max(error, 1e-12)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), BOOTSTRAPS) / n
    picked = np.argmax((draws @ sizes) ** 2 * norm, axis=1)
    half = 0.5 * spacing
    place = (float(grid[starts[best]]), float(grid[ends[best]]))
    ends_ci = [
        (float(np.quantile(grid[index[picked]], 0.025) - half), float(np.quantile(grid[index[picked]], 0.975) + half))
        for index in (starts, ends)
    ]
    spread = float(np.quantile((draws @ own), 0.975) - np.quantile((draws @ own), 0.025)) / 2
    example = group[keep[0]]
    floor = [_floor_of(example, end, length, on_floor) for end in place]
    line = PlaceLine(
        where="joint" if place[1] - place[0] <= 2 * spacing else "zone",
        channel=channel,
        route=kind,
        coordinate="x on the floor" if on_floor else "way from the start",
        place=place,
        place_ci95=(ends_ci[0], ends_ci[1]),
        by_direction=signed,
        floor=(floor[0], floor[1]),
        size=float(own.mean()),
        ci95=(float(own.mean()) - spread, float(own.mean()) + spread),
        unit=channel.unit,
        p_value=float(2.0 * stdtr(n - 1.0, -t)),
        n_runs=n,
    )
    return line, len(starts)


def _on_grid(trace: _Trace, value: FloatArray, grid: FloatArray, length: float, on_floor: bool) -> FloatArray:
    """Return a run's accumulated gap on the grid, shape (n_grid,); of a run back, accumulated from its far end."""
    if on_floor and trace.back:
        # gained between two places on the floor, whichever way they are passed
        return -np.interp(length - grid, trace.way_m, value)
    return np.interp(grid, trace.way_m, value)


def _stretches(n: int) -> tuple[IntArray, IntArray]:
    """Return start and end (grid indices) of every stretch that is searched."""
    longest = max(2, int(LONGEST_SHARE * n))
    lengths = np.unique(
        np.concatenate([np.arange(1, min(9, longest)), np.geomspace(8, max(longest, 9), 8).astype(int)])
    )
    starts, ends = np.meshgrid(np.arange(n), lengths, indexing="ij")
    ends = starts + ends
    ok = (ends < n - 1) & (starts > 0)
    return starts[ok], ends[ok]


def _floor_of(trace: _Trace, way: float, length: float, on_floor: bool) -> tuple[float, float]:
    at = length - way if on_floor and trace.back else way
    x, y = float(np.interp(at, trace.way_m, trace.x_m)), float(np.interp(at, trace.way_m, trace.y_m))
    return (length - x, -y) if trace.back else (x, y)


def _windows(traces: list[_Trace]) -> dict[str, FloatArray | StrArray]:
    """Cut the runs into windows; return what each gained in gap, way, turn and stops, each shape (n_windows,)."""
    parts: dict[str, list[FloatArray]] = {name: [] for name in ("along", "heading", "way", "turn", "bend", "stops")}
    names: list[str] = []
    for trace in traces:
        count = max(int(trace.way_m[-1] / WINDOW_M), 1)
        edges = np.unique(np.searchsorted(trace.way_m, np.linspace(0, trace.way_m[-1], count + 1)))
        edges = np.minimum(edges, len(trace.way_m) - 1)
        for name, values in (
            ("along", trace.along_m),
            ("heading", trace.heading_rad),
            ("way", trace.way_m),
            ("turn", trace.turn_rad),
            ("stops", trace.stops),
        ):
            parts[name].append(np.diff(values[edges]))
        parts["bend"].append(np.abs(parts["turn"][-1]))
        names += [trace.run_id] * (len(edges) - 1)
    made: dict[str, FloatArray | StrArray] = {name: np.concatenate(found) for name, found in parts.items()}
    made["run_id"] = np.array(names, dtype=np.str_)
    return made


def _compare(windows: dict[str, FloatArray | StrArray]) -> list[PlaceLine]:
    """Ask whether the gap opens in turns, or at stops; errors are clustered by run where there are enough runs."""
    from scipy.special import stdtr

    lines = []
    runs, cluster = np.unique(windows["run_id"], return_inverse=True)
    way, bend = np.asarray(windows["way"], np.float64), np.asarray(windows["bend"], np.float64)
    turn, stops = np.asarray(windows["turn"], np.float64), np.asarray(windows["stops"], np.float64)
    for channel in CHANNELS:
        gap = np.asarray(windows[channel.label], np.float64)
        on = np.isfinite(gap) & (way > 1e-6)
        turning = on & (bend > TURNING_PER_M * way)
        straight = on & ~turning
        asked = []
        if turning.sum() >= FEWEST_WINDOWS // 2 and straight.sum() >= FEWEST_WINDOWS // 2:
            asked.append(("turns", turn, "per rad of signed turn"))
            asked.append(("turns", bend, "per rad of turn either way"))
        if (stops[on] > 0).sum() >= 5 and (stops[on] == 0).sum() >= 5:
            asked.append(("stops", stops, "per stop"))
        for where, values, what in asked:
            design = np.stack([way[on], values[on]], axis=1)
            gram = np.linalg.inv(design.T @ design + 1e-12 * np.eye(2))
            beta = gram @ (design.T @ gap[on])
            left = gap[on] - design @ beta
            score = design * left[:, None]
            if len(runs) >= 8:
                summed = np.zeros((len(runs), 2))
                np.add.at(summed, cluster[on], score)
                dof = float(len(runs) - 2)
                middle = summed.T @ summed * (len(runs) / dof)
            else:
                dof = float(on.sum() - 2)
                middle = design.T @ design * float(left @ left) / dof
            error = float(np.sqrt((gram @ middle @ gram)[1, 1]))
            t = abs(float(beta[1])) / max(error, 1e-15)
            lines.append(
                PlaceLine(
                    where=where,
                    channel=channel,
                    what=what,
                    size=float(beta[1]),
                    ci95=(float(beta[1] - 2 * error), float(beta[1] + 2 * error)),
                    unit=f"{channel.unit}/rad" if where == "turns" else channel.unit,
                    p_value=float(2.0 * stdtr(dof, -t)),
                    n_runs=len(np.unique(cluster[on])),
                )
            )
    return lines
