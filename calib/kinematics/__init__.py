"""From a campaign to arrays: wheel travel and reference poses."""

from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from calib.campaign.checks import pasted_rows
from calib.campaign.checks import turned_rad as nominal_turns_rad
from calib.campaign.model import REFERENCE_POSE, Campaign
from calib.campaign.read import GYRO_TURN, poses_are_in_a_map
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.wheels import STEERED, WHEEL_COLUMNS, counts_per_rev, smoothed_speed_mps
from calib.errors import RefusedError
from calib.kinematics.drives import Steps, moved_between
from calib.types import BoolArray, FloatArray, IntArray, StrArray, since_start, unwrapped

#: why a run with positions alone may not be used
POSITION_ALONE: Final = (
    'its reference has positions alone, not from the start pose: nothing says its heading there; state frame = "start" '
    "and begin each run at (0, 0) with x ahead, or measure ref_theta_rad"
)
#: unequal wheels turn a vehicle by less in a run that was driven straight
TURNS_CLEARLY_RAD: Final = 1.2
#: a run in its own start frame begins nearer to its origin than this
AT_START_M: Final = 0.1
#: kinds of runs led along a line, as are those whose median turns less than one arc, and the nominal turn believed
LED: Final = ("corridor", "straight", "line")
LED_RAD: Final = 1.2
#: turn up to which a run of end counts alone is taken for one arc
ONE_ARC_RAD: Final = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Wheels and reference of a campaign's runs."""

    #: shape (n_runs,)
    run_id: StrArray
    session: StrArray
    kind: StrArray
    #: samples of run i stand at ``offsets[i]:offsets[i + 1]``, shape (n_runs + 1,)
    offsets: IntArray
    #: time since the run's start, shape (n_samples,)
    t_s: FloatArray
    steps: Steps
    #: pose by the reference, heading not wrapped; NaN where it has none, shape (3, n_samples)
    reference: FloatArray
    #: end pose by the reference relative to the start; NaN where not measured; x alone of a straight run, shape
    #: (n_runs, 3)
    end_pose: FloatArray
    #: runs whose turn a gyro measured, shape (n_runs,)
    by_gyro: BoolArray
    #: unused runs: id and reason
    left_out: tuple[tuple[str, str], ...] = ()
    #: what each run adds to the common delay; None: nothing, shape (n_runs,)
    own_delay_s: FloatArray | None = None
    #: columns of speeds that the wheels' angles were integrated from; empty of counts
    speeds: tuple[str, ...] = ()
    #: how much the reference's clock is fast, relative
    clock_rate: float = 0.0
    #: runs of positions alone in a map: only the course tells a heading; None: none, shape (n_runs,)
    by_course: BoolArray | None = None

    def __len__(self) -> int:
        return len(self.run_id)

    @property
    def labels(self) -> StrArray:
        """Label of each run's recording, shape (n_runs,): its session where there are several, else itself."""
        return self.session if len(np.unique(self.session)) > 1 else self.run_id

    @property
    def routes(self) -> StrArray:
        """Kind of each run, and the sense of its turn, shape (n_runs,)."""
        turn = self.end_pose[:, 2]
        return np.char.add(self.kind, np.select([turn > 1.0, turn < -1.0], [" ccw", " cw"], ""))

    @property
    def group(self) -> IntArray:
        """Number of each run's recording, shape (n_runs,)."""
        return np.unique(self.labels, return_inverse=True)[1]

    @property
    def run(self) -> IntArray:
        """Number of the run of each sample, shape (n_samples,)."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets)).astype(np.int64)

    @property
    def delay_added_s(self) -> FloatArray:
        """What each run adds to the common delay, shape (n_runs,)."""
        return np.zeros(len(self)) if self.own_delay_s is None else self.own_delay_s

    @property
    def travel_rad(self) -> FloatArray:
        """Angle that the wheels turned on average since the run's start, without sign, shape (n_samples,)."""
        return since_start(np.abs(self.steps.turned_rad).mean(axis=0), self.offsets)

    @property
    def continuous(self) -> bool:
        """Whether the reference follows the path in at least half of the runs."""
        poses = np.add.reduceat(np.isfinite(self.reference).any(axis=0), self.offsets[:-1], dtype=np.int64)
        return bool(np.mean(poses >= MANY_POSES) >= 0.5)

    @property
    def lengths_alone(self) -> bool:
        """Whether nothing but the lengths of straight runs was measured."""
        return not (np.isfinite(self.end_pose[:, 1:]).any() or np.isfinite(self.reference[1:]).any())

    def with_whole_turns(self, turn_rad: FloatArray) -> "tuple[Recording, list[str]]":
        """Return the recording with whole turns added to end headings, and the few runs that were off.

        Headings within half a turn get the turns of the wheels, `turn_rad` (shape (n_samples,)), or of a reference
        followed along the path; a run where that is lost is not named.
        """
        end_pose, (turn_rad, lost) = self.end_pose.copy(), self._turns_followed(turn_rad)
        heading = end_pose[:, 2]
        known = np.isfinite(heading)
        wrapped = (np.abs(heading[known]) <= np.pi + 1e-6).all() and (np.abs(turn_rad[known]) > 1.5 * np.pi).any()
        clear = known & (np.abs(turn_rad) > TURNS_CLEARLY_RAD) & (~wrapped | (np.abs(turn_rad) < np.pi))
        if clear.sum() > 2:
            # an effective track may be twice the nominal one
            turn_rad = turn_rad * np.median(heading[clear] / turn_rad[clear])
        if wrapped:
            heading += 2.0 * np.pi * np.rint((turn_rad - heading) / (2.0 * np.pi))
        turns = np.nan_to_num((turn_rad - heading) / (2.0 * np.pi))
        off = (np.rint(turns) != 0.0) & (np.abs(turns - np.rint(turns)) < WHOLE_TURN)
        off &= np.abs(turn_rad) < MOST_TURNS_RAD
        off &= off.mean() <= FEW_OFF
        heading[off] += 2.0 * np.pi * np.rint(turns[off])
        return replace(self, end_pose=end_pose), self.run_id[off & ~lost].tolist()

    def _turns_followed(self, turn_rad: FloatArray) -> tuple[FloatArray, BoolArray]:
        turned, lost = np.add.reduceat(turn_rad, self.offsets[:-1]), np.zeros(len(self), np.bool_)
        total = np.cumsum(turn_rad)
        for run, (first, last) in enumerate(pairwise(self.offsets.tolist())):
            known = first + np.flatnonzero(np.isfinite(self.reference[2, first:last]))
            if len(known) < MANY_POSES:
                continue
            lost[run] = np.abs(np.diff(total[[first, *known, last - 1]])).max() >= FOLLOWED_RAD
            if not lost[run]:
                turned[run] = self.reference[2, known[-1]] - self.reference[2, known[0]]
        return turned, lost

    def refuse_constant_heading(self, turn_rad: FloatArray) -> None:
        """Raise RefusedError where every heading is the same, although the wheels turn by `turn_rad`, (n_samples,)."""
        headings = np.concatenate([self.reference[2], self.end_pose[:, 2]])
        headings = headings[np.isfinite(headings)]
        turned = float(np.max(np.abs(np.add.reduceat(turn_rad, self.offsets[:-1])), initial=0.0))
        if len(headings) > 1 and np.ptp(headings) == 0.0 and turned > TURNS_CLEARLY_RAD:
            name = "gyro_z_radps" if self.by_gyro.all() else "ref_theta_rad"
            raise RefusedError(
                f"{name}: found {headings[0] + 0.0:.6g} throughout, although the wheels turn by up to "
                f"{turned:.3g} rad; expected the measured heading; leave the column empty where it was not measured"
            )

    def select(self, runs: IntArray) -> "Recording":
        """Return some runs, by their numbers, shape (n,)."""
        samples = np.concatenate([np.arange(*self.offsets[[run, run + 1]]) for run in runs])

        def part(values: Any) -> Any:
            if not isinstance(values, np.ndarray):
                return values
            return values[..., samples] if values.shape[-1] == len(self.t_s) else values[runs]

        steps = Steps(*(part(getattr(self.steps, column.name)) for column in fields(Steps)))
        own = {column.name: part(getattr(self, column.name)) for column in fields(self)}
        own |= {"steps": steps, "offsets": np.concatenate([[0], np.cumsum(np.diff(self.offsets)[runs])])}
        return Recording(**own)

    def with_reference(self, reference: FloatArray) -> "Recording":
        """Return the recording with another reference, shape (3, n_samples), and its ends."""
        known = np.isfinite(reference).all(axis=0) & np.isfinite(self.reference).all(axis=0)
        at, begin = np.arange(len(self.t_s)), self.offsets[:-1]
        first = np.minimum.reduceat(np.where(known, at, len(at) - 1), begin)
        last = np.maximum.reduceat(np.where(known, at, 0), begin)
        after, before = (moved_between(np.nan_to_num(part), first, last) for part in (reference, self.reference))
        ends = np.where((last > first)[:, None], self.end_pose + (after - before), self.end_pose)
        return replace(self, reference=reference, end_pose=ends)

    def with_turned(self, turned_rad: FloatArray) -> "Recording":
        """Return the recording with other wheel turns (sides swapped, say)."""
        return replace(self, steps=replace(self.steps, turned_rad=turned_rad))

    def with_steering(self, steer_rad: FloatArray) -> "Recording":
        """Return the recording with other steering angles."""
        return replace(self, steps=replace(self.steps, steer_rad=steer_rad))


#: share of runs that can be off by whole turns; more are another convention
FEW_OFF: Final = 0.25
#: how near to a whole turn nominal wheels tell a few turns
WHOLE_TURN: Final = 0.1
#: total turn up to which a vehicle 5 % off tells a missing turn from its own error
MOST_TURNS_RAD: Final = 10.0 * np.pi
#: a heading that turns by less between two samples, twice what the wheels say, is followed
FOLLOWED_RAD: Final = 1.0
#: poses of a run that make a reference continuous
MANY_POSES: Final = 20


def recording_of(campaign: Campaign, source: str, *, planned: bool = False) -> Recording:
    """Return wheels and reference of the runs that are not excluded, straight ones also with end counts alone.

    `source`: one of `WHEEL_COLUMNS`; `planned`: repeats are alike, none a copy. Raises RefusedError where no run has
    both wheels and a reference.
    """
    campaign = campaign.included()
    per_rev = np.array(counts_per_rev(campaign.encoder, source))
    in_map = poses_are_in_a_map(campaign)
    away = in_map and campaign.reference.frame is None and _begins_away(campaign)
    pasted = () if planned else pasted_rows(campaign)
    copied = {note.run_id: "a copy of another run, which counts once" for note in pasted}
    outcomes = [
        copied.get(run_id) or _piece(campaign, row, source, per_rev, in_map, away)
        for row, run_id in enumerate(campaign.runs.run_id)
    ]
    if campaign.model.slope_left_m_per_N or campaign.model.slope_right_m_per_N:
        carried = [not isinstance(piece, str) and piece.loads is not None for piece in outcomes]
        if any(carried):
            why = "no wheel loads, though other runs have them; state them"
            outcomes = [p if known or isinstance(p, str) else why for p, known in zip(outcomes, carried, strict=True)]
    named = zip(campaign.runs.run_id.tolist(), outcomes, strict=True)
    left_out = tuple((run_id, reason) for run_id, reason in named if isinstance(reason, str))
    pieces = [piece for piece in outcomes if not isinstance(piece, str)]
    if not pieces:
        reason = f"; the first, {left_out[0][0]}: {left_out[0][1]}" if left_out else ""
        ends = any(np.isfinite(campaign.runs.number(name)).any() for name in ("ref_x_m", "ref_theta_rad"))
        lacking = "log the runs" if ends else "measure where runs end (ref_x_m, ref_y_m, ref_theta_rad)"
        raise RefusedError(
            f"geometry of {campaign.name!r}: found no run with wheels and a reference pose{reason}; expected logs with "
            f"{', '.join(WHEEL_COLUMNS[source])} and end poses or ref_ columns; {lacking}"
        )
    runs = campaign.runs.select(np.array([not isinstance(piece, str) for piece in outcomes]))

    def joined(name: str) -> FloatArray | None:
        parts = [getattr(piece, name) for piece in pieces]
        return None if any(part is None for part in parts) else np.concatenate(parts, axis=-1)

    return Recording(
        run_id=runs.run_id,
        session=runs.label("session"),
        kind=runs.label("kind"),
        offsets=np.cumsum([0, *(len(piece.t_s) for piece in pieces)]),
        t_s=np.concatenate([piece.t_s for piece in pieces]),
        steps=Steps(
            turned_rad=np.concatenate([piece.turned for piece in pieces], axis=1),
            steer_rad=joined("steer"),
            load_offset_N=joined("loads"),
            speed_mps=joined("speed") if source == "shaft" else None,
        ),
        reference=np.concatenate([piece.reference for piece in pieces], axis=1),
        end_pose=np.stack([piece.end_pose for piece in pieces]),
        by_gyro=np.array([piece.by_gyro for piece in pieces]),
        by_course=np.array([piece.by_course for piece in pieces]),
        left_out=left_out,
        speeds=campaign.logs.speeds,
    )


class _Run(NamedTuple):
    t_s: FloatArray
    turned: FloatArray
    reference: FloatArray
    end_pose: FloatArray
    loads: FloatArray | None
    steer: FloatArray | None = None
    speed: FloatArray | None = None
    by_gyro: bool = False
    by_course: bool = False


def _piece(campaign: Campaign, row: int, source: str, per_rev: FloatArray, in_map: bool, away: bool) -> _Run | str:
    log = campaign.logs.of(row)
    names = WHEEL_COLUMNS[source]
    runs = campaign.runs
    end = np.array([runs.number(name)[row] for name in REFERENCE_POSE])
    if not all(name in log for name in names):
        return _end_counts(campaign, row, source, per_rev, np.full(3, np.nan) if in_map else end)
    steer = log.get("steer_rad") if source in STEERED else None
    if source in STEERED and steer is None:
        return "its log has no steer_rad"
    counts = np.stack([log[name] for name in names])
    keep = np.asarray(np.isfinite(counts if steer is None else np.vstack([counts, steer])).all(axis=0))
    if keep.sum() < 2:
        return "its log has fewer than two samples with counts"
    counts = counts[:, keep]
    turned = 2.0 * np.pi * np.diff(counts, axis=1, prepend=counts[:, :1]) / per_rev[:, None]
    reference = np.stack([log.get(name, np.full(len(keep), np.nan)) for name in REFERENCE_POSE])
    reference[2] = unwrapped(reference[2])
    reference = reference[:, keep]
    by_course = _position_alone_in_a_map(campaign, reference, away)
    if by_course and np.isfinite(reference[:2]).all(axis=0).sum() < MANY_POSES:
        return POSITION_ALONE
    followed = bool(np.isfinite(reference).all(axis=0).any())
    # of an end pose in a map only the log says where the run began
    if np.isnan(end).all() or (followed and (in_map or np.isnan(end).any())):
        end = _last_pose(reference)
    if by_course:
        end = np.full(3, np.nan)
    elif np.isnan(end[:2]).all() and not np.isfinite(reference[:2]).any():
        # a measured heading stays beside a length
        end = np.where(np.isnan(end), _straight_end(campaign, row, source, turned.sum(axis=1)), end)
    gyro = float(runs.number(GYRO_TURN)[row])
    if by_gyro := bool(np.isnan(end[2]) and np.isfinite(gyro)):
        end = np.array([end[0], end[1], gyro])
    if not np.isfinite(reference).any() and np.isnan(end[[0, 2]]).all():
        return "nothing says where it ended: no ref_ columns, and no distance_m of a straight run"
    if steer is not None:
        steer = steer[keep]
        steer = np.concatenate([steer[:1], 0.5 * (steer[1:] + steer[:-1])])
    t_s = log["t_s"][keep]
    speed = smoothed_speed_mps(np.cumsum(turned[0]) * campaign.vehicle.wheel_radius_m, t_s)
    return _Run(
        t_s - t_s[0], turned, reference, end, _loads(campaign, row, log, keep), steer, speed, by_gyro, by_course
    )


def _end_counts(campaign: Campaign, row: int, source: str, per_rev: FloatArray, end: FloatArray) -> _Run | str:
    if source != "rear":
        return f"its log lacks {' or '.join(WHEEL_COLUMNS[source])}"
    runs = campaign.runs
    turned_rad = 2.0 * np.pi * np.array([runs.number(name)[row] for name in WHEEL_COLUMNS[source]]) / per_rev
    if np.isnan(turned_rad).any():
        return "it has no log and no end counts"
    if np.isnan(end[:2]).any():
        end = np.where(np.isnan(end), _straight_end(campaign, row, source, turned_rad), end)
    if np.isnan(end[0]):
        return "it has no log, and no end pose or distance_m of a straight run"
    if abs(end[2]) > ONE_ARC_RAD:
        return "it turns and has no log: its path cannot be computed from end counts"
    turned_rad = np.stack([np.zeros(2), turned_rad], axis=1)
    loads = _loads(campaign, row, {}, np.ones(2, dtype=np.bool_))
    return _Run(np.array([0.0, 1.0]), turned_rad, np.full((3, 2), np.nan), end, loads)


def _straight_end(campaign: Campaign, row: int, source: str, turned_rad: FloatArray) -> FloatArray:
    model, end, distance_m = campaign.model, np.full(3, np.nan), campaign.runs.number("distance_m")
    if source != "rear" or np.isnan(distance_m[row]):
        return end
    left, right = turned_rad * np.array([model.radius_left_m, model.radius_right_m])
    kinds = campaign.runs.label("kind")
    alike = (kinds == kinds[row]) & np.isfinite(distance_m)
    # unequal radii bend what the nominal vehicle makes of a corridor, more under load
    led = str(kinds[row]).lower().startswith(LED) or np.median(np.abs(nominal_turns_rad(campaign)[alike])) < ONE_ARC_RAD
    if abs(right - left) / model.track_m < (LED_RAD if led else ONE_ARC_RAD):
        end[0] = distance_m[row] * np.sign(left + right)
    return end


def _loads(campaign: Campaign, row: int, log: dict[str, FloatArray], keep: BoolArray) -> FloatArray | None:
    whole = {name: np.full(len(keep), campaign.runs.number(name)[row]) for name in WHEEL_LOADS}
    loads = np.stack([log.get(name, load)[keep] for name, load in whole.items()])
    return None if np.isnan(loads).any() else loads - campaign.model.reference_load_N


def _begins_away(campaign: Campaign) -> bool:
    logs = campaign.logs
    first = logs.offsets[:-1][np.diff(logs.offsets) > 0]
    return bool((np.hypot(*(logs.columns[name][first] for name in REFERENCE_POSE[:2])) > AT_START_M).any())


def _position_alone_in_a_map(campaign: Campaign, reference: FloatArray, away: bool) -> bool:
    places, frame = reference[:2, np.isfinite(reference[:2]).all(axis=0)], campaign.reference.frame
    if not places.shape[1] or np.isfinite(reference[2]).any():
        return False
    return frame == "map" or (frame is None and (away or float(np.hypot(*places[:, 0])) > AT_START_M))


def parts_seen(reference: FloatArray) -> BoolArray:
    """Return which of x, y, theta a reference (shape (3, n)) has at all, shape (3,)."""
    return np.asarray(np.isfinite(reference).any(axis=1))


def _last_pose(reference: FloatArray) -> FloatArray:
    seen = parts_seen(reference)
    good = np.flatnonzero(np.isfinite(reference[seen]).all(axis=0))
    if len(good) < 2 or good[0] != 0 or good[-1] != reference.shape[1] - 1:
        return np.full(3, np.nan)
    moved = moved_between(np.where(seen[:, None], reference, 0.0), good[:1], good[-1:])[0]
    return np.where(seen, moved, np.nan)
