"""Read a campaign folder: settings, run table, logs, and what follows from them; a file becomes a campaign on the way.

What follows: counts and distances of the logs, loads of the payload, turns by a gyro, and closed loops.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calib.campaign import run_table
from calib.campaign.logs import log_files, read_logs
from calib.campaign.model import REFERENCE_POSE, SIMULATED_POSE, Border, Campaign, Logs, RunTable
from calib.campaign.readers import READERS, is_bag_folder, read_table
from calib.campaign.settings import WHEEL_LOADS
from calib.campaign.settings_file import read_settings
from calib.campaign.wheels import SPEEDS, WHEEL_COLUMNS, counted_source, on_one_axle, with_counts
from calib.errors import BadFileError, BadInputError, CalibError
from calib.io import inside, settle, sha256_file
from calib.types import FloatArray, IntArray, Progress, silent
from calib.vehicle import Vehicle, wheel_loads_N

SETTINGS: Final = "campaign.toml"
#: counts between a total and its log: not read at the same instant
_SAME_COUNTS: Final = 50.0
_COUNTS: Final = ("counts_left", "counts_right")
GYRO: Final = "gyro_z_radps"
#: turn by the gyro, and its standard uncertainty without the scale
GYRO_TURN: Final = "gyro_theta_rad"
GYRO_SIGMA: Final = "gyro_sigma_rad"
#: a vehicle turns before the first count and rocks after the last
SETTLING_S: Final = 0.1
#: label of a run that ends on its start mark
CLOSED: Final = "closed"
#: a shorter standstill has too few samples for a bias
STANDSTILL_S: Final = 0.5
#: a closed loop further off whole turns is doubtful
WHOLE_TURN_RAD: Final = 0.8
#: radii off by 1 % turn a corridor of 40 m by less
SENSE_RAD: Final = 1.0
#: what ends at 0 or 360 degrees scatters about it by less
ABOUT_ZERO_RAD: Final = 0.1
#: readings that tell a held reference, the part that stands alike, and its usual over its smallest step
_FEWEST_HELD, _MOSTLY_HELD, _MANY_DIGITS = 10, 0.8, 4.0
#: a first pose so far from zero, in stated uncertainties, is not in the start frame
MAP_START_SIGMAS: Final = 8.0
MAP_START_M, MAP_START_RAD = 0.01, 0.02


def read_campaign(folder: Path, *, logs: bool = True, lenient: bool = False, progress: Progress = silent) -> Campaign:
    """Read a campaign.

    `folder`: holds ``campaign.toml``, ``runs.csv`` (or ``.xlsx``, ``.parquet``) and the logs that the table names, or
    ``logs/<run_id>.csv``; `lenient`: keep faults of single runs as notes of level ``wrong``. Missing wheel loads are
    computed from the payload (Eqs 1 and 2), counts and distance taken from the logs. Raises BadFileError.
    """
    folder = Path(folder)
    if not folder.is_dir():
        remedy = "give the folder that holds campaign.toml"
        raise BadFileError(folder, "a file" if folder.exists() else "no such folder", "a campaign folder", remedy)
    settle(folder)
    border = Border(lenient=lenient)
    path = inside(folder, SETTINGS, named_in=folder)
    try:
        settings = read_settings(path, SETTINGS)
    except BadFileError as error:
        raise error.below(folder) from error
    hashes = {SETTINGS: sha256_file(path)}
    border.notes.extend(settings.notes)

    shown, path = _runs_path(folder)
    try:
        raw = read_table(path, shown)
        border.notes.extend(raw.notes)
        _say_look_alikes(folder, shown, border)
        runs = run_table(raw, shown, border)
        hashes[shown] = sha256_file(path)
        files = log_files(folder, runs, shown, border) if logs else []
        found_logs, of_logs = read_logs(files, len(runs), settings.encoder, border, progress=progress)
    except BadFileError as error:
        raise error.below(folder) from error
    if found_logs.columns.keys() & set(SPEEDS):
        found_logs = with_counts(found_logs, settings.encoder, settings.vehicle, border)
    found_logs = without_held_poses(found_logs, border)
    campaign = replace(settings, root=folder, runs=runs, logs=found_logs, hashes=hashes | of_logs)
    campaign = with_references(completed(campaign, shown, border), shown, border)
    return replace(campaign, notes=tuple(border.notes))


def without_held_poses(logs: Logs, border: Border) -> Logs:
    """Return logs in which poses that a slower reference holds between its readings are empty but for the first.

    Held ones stand for as many samples at any speed while the wheels roll, and go on by many of their digits; rounded
    ones by one. What stands for twice as long is left: a lost reference.
    """
    emptied, held_s = np.zeros(int(logs.offsets[-1]), dtype=np.bool_), list[float]()
    for run, log in logs.each(2, "t_s", *REFERENCE_POSE[:2]):
        counts = np.stack([np.zeros(len(log["t_s"])), *(log[name] for name in log if name.startswith("counts_"))])
        steps = np.abs(np.diff([log[name] for name in REFERENCE_POSE if name in log]))
        rolls, stands = (np.diff(counts) != 0.0).any(axis=0), (steps == 0.0).all(axis=0)
        fresh = 1 + np.flatnonzero(rolls & ~stands)
        lengths, jumps = np.diff(fresh), steps[:2][steps[:2] > 0.0]
        if len(lengths) < _FEWEST_HELD or (usual := float(np.median(lengths))) < 2.0:
            continue
        if np.mean(np.abs(lengths - usual) <= 1.0) > _MOSTLY_HELD and np.median(jumps) > _MANY_DIGITS * jumps.min():
            held, row = rolls & stands, np.arange(len(stands)) + 1
            since = row - np.maximum.accumulate(np.where(held, 0, row))
            emptied[logs.offsets[run] + row] = held & (since < 2.0 * usual)
            held_s.append(usual * float(np.median(np.diff(log["t_s"]))))
    if not held_s:
        return logs
    text = f"""in {len(held_s)} logs poses stand for {np.median(held_s):.2g} s while the wheels roll: those of a slower
        reference, held between its readings; the first of each counts"""
    border.say(f"logs, columns {', '.join(REFERENCE_POSE)}", text, "held_poses")
    poses = {name: np.where(emptied, np.nan, logs.columns[name]) for name in REFERENCE_POSE if name in logs.columns}
    return replace(logs, columns={**logs.columns, **poses})


def loads_from_payload(vehicle: Vehicle, runs: RunTable) -> tuple[FloatArray, FloatArray]:
    """Return left and right wheel load of each run from its payload, shape (n_runs,) each, in N.

    NaN without payload or place. A payload of 0 needs no place; without ``payload_y_m`` it is on the centre line.
    """
    mass, x, y = (runs.number(name) for name in ("payload_kg", "payload_x_m", "payload_y_m"))
    none = mass == 0
    centred = none | ("payload_y_m" not in runs.numbers)
    _, left, right = wheel_loads_N(vehicle, mass, np.where(none, 0.0, x), np.where(centred, 0.0, y))
    return left, right


def _runs_path(folder: Path) -> tuple[str, Path]:
    for name in (f"runs{suffix}" for suffix in READERS):
        if (folder / name).exists() or (folder / name).is_symlink():
            return name, inside(folder, name, named_in=folder)
    remedy = "add it, or make the campaign out of lab files with 'calib ingest'"
    raise BadFileError(folder, "no run table", "runs.csv, one row a run", remedy)


def _say_look_alikes(folder: Path, shown: str, border: Border) -> None:
    tables = {f"runs{suffix}" for suffix in READERS}
    for name in sorted(entry.name for entry in folder.iterdir()):
        meant = shown if name.casefold() in tables else SETTINGS if name.casefold() == SETTINGS else ""
        if meant and name not in (shown, SETTINGS):
            text = f"found beside {meant}, which is read; this is not; remove one of them"
            border.say(name, text, "look_alike", level="suspicious")


def completed(campaign: Campaign, shown: str, border: Border) -> Campaign:
    """Return a campaign with what its run table lacks, from logs and payload, overflows of totals undone."""
    runs, logs = campaign.runs, campaign.logs
    numbers = dict(runs.numbers)

    def fill(name: str, values: FloatArray, how: str, code: str) -> None:
        column = numbers.get(name, np.full(len(runs), np.nan))
        if (empty := np.isnan(column) & ~np.isnan(values)).any():
            numbers[name] = np.where(empty, values, column)
            border.say(f"{shown}, column {name}", f"{int(empty.sum())} run(s) {how}", code)

    unused = [name for name in SIMULATED_POSE if name in logs.columns and name not in numbers]
    if unused:
        text = f"not used: a gap is judged against these columns of {shown}, at each run's end; write them there"
        border.say(f"logs, columns {', '.join(unused)}", text, "sim_in_logs", level="suspicious")
    for name in _COUNTS:
        fill(name, log_totals(logs, name), f"filled from the log's {name}", "filled")
    fill("distance_m", _sample(logs, "range_m", logs.offsets[1:] - 1), "filled from the log's range_m", "filled")
    campaign = replace(campaign, runs=replace(runs, numbers=numbers))
    for name in _COUNTS:
        if name in numbers:
            numbers[name] = _unwrapped(campaign, name, shown, border)
    if "payload_kg" in numbers:
        how = "computed from the payload by the static wheel loads"
        for name, load in zip(WHEEL_LOADS, loads_from_payload(campaign.vehicle, runs), strict=True):
            fill(name, load, how, "computed_load")
    return replace(campaign, runs=replace(runs, numbers=numbers))


def _unwrapped(campaign: Campaign, name: str, shown: str, border: Border) -> FloatArray:
    runs, encoder = campaign.runs, campaign.encoder
    total, logged = runs.number(name), log_totals(campaign.logs, name)
    driven = runs.number("distance_m") / (2 * np.pi * campaign.vehicle.wheel_radius_m) * encoder.per_rev(name)
    for bits in (encoder.wrap_bits,) if encoder.wrap_bits else (16, 32):
        full = 2.0**bits
        by_distance = np.isnan(logged) & bool(encoder.wrap_bits)
        turns = np.rint((np.where(by_distance, driven, logged) - total) / full)
        off = np.abs(total + turns * full - np.where(by_distance, driven, logged))
        most = np.where(by_distance, np.minimum(0.05 * np.abs(driven), full / 4), _SAME_COUNTS)
        turns = np.where(np.isfinite(turns) & (off <= most) & (np.abs(total) < full), turns, 0.0)
        whole = total + turns * full
        for run in np.flatnonzero(turns):
            text = f"""{total[run]:.0f} is the remainder of {abs(turns[run]):.0f} overflow(s) of a {bits}-bit counter;
                {whole[run]:.0f} is used"""
            where = f"{shown}, row {runs.line[run]}, column {name}"
            border.say(where, text, "wrapped_total", run_id=str(runs.run_id[run]))
        if turns.any():
            return whole
    return total


def log_totals(logs: Logs, name: str) -> FloatArray:
    """Return last minus first of a log column for each run, shape (n_runs,); NaN without it."""
    return _sample(logs, name, logs.offsets[1:] - 1) - _sample(logs, name, logs.offsets[:-1])


def _sample(logs: Logs, name: str, at: IntArray) -> FloatArray:
    values = np.full(len(logs.lengths), np.nan)
    if name in logs.columns and logs.present.any():
        values[logs.present] = logs.columns[name][at[logs.present]]
    return values


def with_references(campaign: Campaign, shown: str, border: Border) -> Campaign:
    """Return the campaign with turns by a gyro, signed headings, and end poses of closed loops, in its run table."""
    campaign = _with_signed_headings(campaign, shown, border)
    if GYRO in campaign.logs.columns:
        campaign = _with_gyro(campaign, shown, border)
    if (campaign.runs.label("loop") == CLOSED).any():
        campaign = _with_closed_loops(campaign, shown, border)
    return campaign


def _with_signed_headings(campaign: Campaign, shown: str, border: Border) -> Campaign:
    # wheels that turn both ways do not end at 0 to 360 degrees alone
    runs, wheels = campaign.runs, _turn_by_wheels(campaign)
    heading = runs.number("ref_theta_rad")
    of_wheels = wheels[known := np.isfinite(heading)]
    turns_both_ways = (of_wheels > SENSE_RAD).any() and (of_wheels < -SENSE_RAD).any()
    of_one_turn = (np.abs(heading[known] - np.pi) <= np.pi + ABOUT_ZERO_RAD).all()
    if campaign.reference.frame == "map" or not (turns_both_ways and of_one_turn):
        return campaign
    text = "headings of 0 to 360 degrees, though the wheels turn both ways: read as -180 to 180 degrees"
    border.say(f"{shown}, column ref_theta_rad", text, "headings_of_one_turn")
    signed = np.where(heading > np.pi, heading - 2.0 * np.pi, heading)
    return replace(campaign, runs=replace(runs, numbers={**runs.numbers, "ref_theta_rad": signed}))


def _with_gyro(campaign: Campaign, shown: str, border: Border) -> Campaign:
    runs, logs = campaign.runs, campaign.logs
    turn, sigma = runs.number(GYRO_TURN).copy(), runs.number(GYRO_SIGMA).copy()
    present = np.flatnonzero(logs.present).tolist()
    known = {run: rates for run in present if len(rates := rates_at_rest(campaign, run))}
    measured = [run for run in present if np.isfinite(logs.of(run).get(GYRO, np.nan)).all()]
    without = len(measured) - len(known.keys() & set(measured))
    if measured and not known:
        text = f"""found no standstill of {STANDSTILL_S:g} s in any log, so that the gyro's bias is unknown and the gyro
            not used; expected the vehicle at rest at the start or end of a run"""
        border.say(f"logs, column {GYRO}", text, "gyro_bias", level="suspicious")
        return campaign
    sessions = runs.label("session")
    # the bias wanders: its scatter counts where a run has no standstill
    wander = float(np.std([rates.mean() for rates in known.values()], ddof=1)) if len(known) > 1 else 0.0
    for run in measured:
        alike = [one for other, one in known.items() if sessions[other] == sessions[run]] or list(known.values())
        rests, drift = ([known[run]], 0.0) if run in known else (alike, wander)
        if np.isnan(turn[run]):
            turn[run], sigma[run] = _turn(logs.of(run), rests, drift)
    text = f"{len(measured)} run(s) integrated from the log's {GYRO}, less the bias at rest"
    if without:
        text += f"; {without} without a standstill of their own, less that of their session"
    border.say(f"{shown}, column {GYRO_TURN}", text, "gyro")
    return replace(campaign, runs=replace(runs, numbers={**runs.numbers, GYRO_TURN: turn, GYRO_SIGMA: sigma}))


def rates_at_rest(campaign: Campaign, run: int) -> FloatArray:
    """Return what a run's gyro reads at a standstill of `STANDSTILL_S`, shape (n,), else none."""
    log = campaign.logs.of(run)
    wheels = [log[name] for name in WHEEL_COLUMNS[counted_source(campaign)] if name in log]
    if GYRO not in log or not wheels:
        return np.zeros(0)
    t_s, rate = log["t_s"], log[GYRO]
    moves = np.any([np.diff(wheel) != 0.0 for wheel in wheels], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate(([True], moves, [True]))))
    at_rest = np.zeros(len(t_s), dtype=np.bool_)
    for first, last in edges.reshape(-1, 2):
        begin, end = t_s[first] + SETTLING_S, t_s[last] - SETTLING_S
        if end - begin >= STANDSTILL_S:
            at_rest |= (t_s >= begin) & (t_s <= end)
    values = rate[at_rest & np.isfinite(rate)]
    return values if len(values) >= 3 else values[:0]


def _turn(log: dict[str, FloatArray], rests: list[FloatArray], more_radps: float) -> tuple[float, float]:
    t_s, sample_std_radps = log["t_s"], rests[0].std(ddof=1)
    rate = log[GYRO] - np.mean([rates.mean() for rates in rests])
    off_radps = np.hypot(sample_std_radps / np.sqrt(len(rests[0])), more_radps)
    noise = sample_std_radps * np.linalg.norm(np.diff(t_s))
    return float(np.trapezoid(rate, t_s)), float(np.hypot(noise, off_radps * (t_s[-1] - t_s[0])))


def _with_closed_loops(campaign: Campaign, shown: str, border: Border) -> Campaign:
    runs = campaign.runs
    if campaign.reference.frame == "map":
        text = 'found closed loops with [reference] frame = "map"; expected "start", in which they end at 0; not used'
        border.say(f"{shown}, column loop", text, "closed_loop", level="suspicious")
        return campaign
    closed, wheels = runs.label("loop") == CLOSED, _turn_by_wheels(campaign)
    whole = 2.0 * np.pi * np.rint(wheels / (2.0 * np.pi))
    ends = {"ref_x_m": np.zeros(len(runs)), "ref_y_m": np.zeros(len(runs)), "ref_theta_rad": whole}
    empty = closed & np.isfinite(wheels) & np.isnan([runs.number(name) for name in ends]).all(axis=0)
    for run in np.flatnonzero(empty & (np.abs(wheels - whole) > WHOLE_TURN_RAD)):
        text = f"""the wheels turn the closed loop by {wheels[run]:.3g} rad, which is no whole turn; expected the
            vehicle to end on the mark where it began, heading as it did; check the run"""
        where = f"{shown}, row {runs.line[run]}, column loop"
        border.say(where, text, "closed_loop", level="suspicious", run_id=str(runs.run_id[run]))
    filled = {name: np.where(empty, value, runs.number(name)) for name, value in ends.items()}
    text = f"{int(empty.sum())} closed loop(s) end at x = y = 0 and whole turns"
    border.say(f"{shown}, column loop", text, "closed_loop")
    return replace(campaign, runs=replace(runs, numbers={**runs.numbers, **filled}))


def poses_are_in_a_map(campaign: Campaign) -> bool:
    """Return whether the logs' poses stand in one frame: so stated, or runs do not begin at zero."""
    reference, logs = campaign.reference, campaign.logs
    if reference.frame is not None:
        return reference.frame == "map"
    x, y, heading = (logs.columns.get(name) for name in REFERENCE_POSE)
    if x is None or y is None:
        return False
    far = max(MAP_START_M, MAP_START_SIGMAS * reference.sigma_xy_m)
    bent = max(MAP_START_RAD, MAP_START_SIGMAS * reference.sigma_theta_rad)
    # a reference may begin on the way only
    first = logs.offsets[:-1][np.diff(logs.offsets) > 0]
    turned = np.zeros(len(first)) if heading is None else np.nan_to_num(np.abs(heading[first]))
    away = np.hypot(x[first], y[first])
    return bool((np.isfinite(away) & ((away > far) | (turned > bent))).any())


def _turn_by_wheels(campaign: Campaign) -> FloatArray:
    try:
        axle = on_one_axle(campaign)
    except CalibError:
        return np.full(len(campaign.runs), np.nan)
    model = axle.model
    left, right = (axle.runs.number(name) / axle.encoder.per_rev(name) for name in _COUNTS)
    return 2.0 * np.pi * (right * model.radius_right_m - left * model.radius_left_m) / model.track_m


def read_or_ingest(path: Path, *, mapping: Path | None, lenient: bool = False, progress: Progress = silent) -> Campaign:
    """Read a campaign folder, or a campaign made of a recording or table as by `ingest`.

    ``root`` is None where it was made. Raises BadInputError for a campaign folder with a mapping, or a file that cannot
    be used.
    """
    is_campaign = path.is_dir() and not is_bag_folder(path) and ((path / SETTINGS).exists() or mapping is None)
    if is_campaign and mapping is not None:
        expected = "a mapping only with a recording"
        raise BadInputError(f"{path}: found a campaign and a mapping; expected {expected}; leave it out")
    if is_campaign or not path.exists():
        return read_campaign(path, lenient=lenient, progress=progress)
    from calib.campaign.ingest.build import ingest

    with tempfile.TemporaryDirectory(prefix="calib-") as place:
        folder = Path(place) / (path.stem or "campaign")
        ingested = ingest([path], folder, mapping=mapping, progress=progress)
        campaign = read_campaign(folder, lenient=lenient, progress=progress)
    known = {(note.code, note.text) for note in campaign.notes}
    notes = (*(note for note in ingested.notes if (note.code, note.text) not in known), *campaign.notes)
    return replace(campaign, root=None, notes=notes)


def looks_ahead(distance_m: FloatArray, x_m: FloatArray, y_m: FloatArray) -> bool:
    """Return whether distances (n_runs,) are along the start heading, by end poses, NaN where unknown.

    Else, and where no end pose tells, they are chords to the end point.
    """
    known = np.isfinite(distance_m + x_m + y_m)
    if not known.any():
        return False
    along, chord = np.abs(x_m[known]), np.hypot(x_m[known], y_m[known])
    off_along, off_chord = off = np.abs(distance_m[known] - np.stack([along, chord]))
    # runs that tell them apart count most, none as a blunder
    off_along, off_chord = np.square(np.minimum(off, 3.0 * np.median(off.max(axis=0)))).sum(axis=1)
    return bool(off_along <= off_chord)
