"""Contents of a campaign, and what is wrong or suspicious about it.

Wrong is a factor beyond wear, load or a poor nominal value: blunders in units and settings.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final, get_type_hints

import numpy as np

from calib.campaign import checks
from calib.campaign.checks import SIDES, counts, measurements, paths, poses, settings
from calib.campaign.model import Campaign, Note
from calib.campaign.read import log_totals
from calib.types import FloatArray, Progress, grouped, silent, split_suffix, stepped
from calib.vehicle import Usual


def implausible(campaign: Campaign) -> Iterator[Note]:
    """Yield implausible values as notes of level ``wrong``; none of excluded rows."""
    notes, campaign = _with_counts_of_runs(campaign.included())
    yield from notes
    of_columns = measurements.implausible_distances, measurements.implausible_loads, _columns, poses.implausible_poses
    of_logs = paths.implausible_paths, counts.interrupted_counts, swapped_sessions, settings.implausible_senses
    for check in (_settings, _model, *of_columns, *of_logs):
        yield from check(campaign)


def swapped_sessions(campaign: Campaign) -> Iterator[Note]:
    """Yield the whose turning runs all turn otherwise than their reference, as notes."""
    return (note for note in counts.turn_direction(campaign) if note.level == "wrong")


def _with_counts_of_runs(campaign: Campaign) -> tuple[list[Note], Campaign]:
    totals = checks.both_sides(campaign, "counts_{}")
    step = np.diff(totals, prepend=0.0)
    counted = dict(zip(("counts_left", "counts_right"), np.where(step < 0, totals, step), strict=True))
    of_steps = replace(campaign, runs=replace(campaign.runs, numbers={**campaign.runs.numbers, **counted}))
    ratios = np.array([[checks.raw_radius_ratio(one, side) for side in SIDES] for one in (campaign, of_steps)])
    known = np.abs(np.log(np.abs(ratios))) < np.log(measurements.MOST_RATIO)
    if len(campaign.runs) < checks.LEAST_RUNS or known[0].mean() > 0.5 or known[1].mean() < checks.MOST_OF_THE_RUNS:
        return [], campaign
    text = """the counts are totals that grow from run to run; expected what each run counted, as their steps are; write
        the difference from the run before, at a counter's start the count itself"""
    return [checks.implausible_column("counts_left, counts_right", text)], of_steps


def _settings(campaign: Campaign) -> Iterator[Note]:
    for section in ("vehicle", "rangefinder", "reference"):
        part = getattr(campaign, section)
        for name, hint in get_type_hints(type(part), include_extras=True).items():
            value, unit = getattr(part, name), split_suffix(name)[1]
            for usual in getattr(hint, "__metadata__", ()):
                if isinstance(usual, Usual) and not usual.low <= value <= usual.high:
                    reason = _unit_hint(value, usual, str(unit))
                    text = f"found {value:g} {unit}; expected {usual.low:g} to {usual.high:g} {unit}; {reason}"
                    yield checks.implausible_setting(f"{section}.{name}", text)
    vehicle = campaign.vehicle
    if not 0.5 < vehicle.track_m / vehicle.wheel_radius_m < 200:
        text = f"""found a track of {vehicle.track_m:g} m with wheels of {vehicle.wheel_radius_m:g} m radius; expected
            0.5 to 200 radii; check the units of both"""
        yield checks.implausible_setting("vehicle.track_m", text)
    for side in SIDES:
        if not 1 <= (counts := campaign.encoder.per_rev(side)) <= 1e9:
            text = f"found {counts:g}; expected counts of one turn of the wheel, 1 to 1e9; correct it"
            yield checks.implausible_setting(f"encoder.counts_per_rev_{side}", text)


def _unit_hint(value: float, usual: Usual, unit: str) -> str:
    if unit == "rad":
        return "is it in degrees?" if usual.low <= math.radians(value) <= usual.high else "check the unit"
    for factor, text in ((1e-3, "thousandths"), (1e-2, "hundredths"), (1e3, "thousands")):
        if usual.low <= value * factor <= usual.high:
            return f"is it in {text} of {unit}?"
    return "check the unit"


def _against_vehicle(campaign: Campaign) -> Iterator[tuple[str, float, float]]:
    names = {"radius_left_m": "wheel_radius_m", "radius_right_m": "wheel_radius_m", "track_m": "track_m"}
    for name, of_vehicle in names.items():
        yield f"model.{name}", getattr(campaign.model, name), getattr(campaign.vehicle, of_vehicle)


def model_against_vehicle(campaign: Campaign) -> Iterator[Note]:
    """Compare what the simulator believes with the nominal vehicle."""
    for key, believed, nominal in _against_vehicle(campaign):
        if abs(believed / nominal - 1) > 0.2:
            text = f"found {believed:g} where the vehicle has {nominal:g}; check the unit, and whether it is a diameter"
            yield checks.setting_note(key, text, "model_differs")


def _model(campaign: Campaign) -> Iterator[Note]:
    model = campaign.model
    for key, believed, nominal in _against_vehicle(campaign):
        if measurements.implausible_ratio(believed / nominal):
            text = f"""found {believed:g} where the vehicle has {nominal:g}, {believed / nominal:.3g} times; expected
                the same within a third; check the unit, and whether a diameter was given"""
            yield checks.implausible_setting(key, text)
    for side in SIDES:
        change = getattr(model, f"slope_{side}_m_per_N") * model.reference_load_N / campaign.vehicle.wheel_radius_m
        if abs(change) > 0.25:
            text = f"""found a slope that changes the radius by {100 * change:.3g} % at the reference load; expected
                less than 25 %; check the unit (mm/kN, um/N?)"""
            yield checks.implausible_setting(f"model.slope_{side}_m_per_N", text)
    loads = checks.both_sides(campaign, "load_{}_N")
    loads = loads[loads > 0]
    of_nominal = math.isclose(model.reference_load_N, campaign.vehicle.unladen_load_N, rel_tol=1e-5)
    unstated = of_nominal and not checks.stated(campaign, "vehicle.mass_kg")
    if len(loads) and not unstated and not 0.1 * loads.min() <= model.reference_load_N <= 10 * loads.max():
        text = f"""found {model.reference_load_N:g} N for wheel loads of {loads.min():g} to {loads.max():g} N; expected
            a load near these; check the unit (kN or kg?)"""
        yield checks.implausible_setting("model.reference_load_N", text)


#: column -> plausible values, and a question about others; 1e-9: above zero
_COLUMNS: Final[dict[str, tuple[Usual, str]]] = {
    "temperature_C": (Usual(-50.0, 60.0), "is it in Fahrenheit or kelvin?"),
    "minutes_under_load": (Usual(0.0, math.inf), "count from when the payload was put on"),
    "speed_mps": (Usual(-20.0, 20.0), "is it in mm/s?"),
    "amplitude_m": (Usual(-5.0, 5.0), "is it in millimetres?"),
    "distance_m": (Usual(1e-9, math.inf), "check the sign, or flag the run as excluded"),
    "load_left_N": (Usual(1e-9, math.inf), "check payload and place, or the sign: below zero the wheel lifts off"),
    "load_right_N": (Usual(1e-9, math.inf), "check payload and place, or the sign: below zero the wheel lifts off"),
}


def _columns(campaign: Campaign) -> Iterator[Note]:
    for name, (usual, hint) in _COLUMNS.items():
        values = campaign.runs.number(name)
        if len(outside := values[(values < usual.low) | (values > usual.high)]):
            fault = f"found {np.median(outside):.4g} {split_suffix(name)[1]} in {len(outside)} run(s)"
            most = f"above {usual.low:.0f}" if usual.high == math.inf else f"{usual.low:g} to {usual.high:g}"
            yield checks.implausible_column(name, f"{fault}; expected {most}; {hint}")
    amplitude, wavelength = campaign.runs.number("amplitude_m"), campaign.runs.number("wavelength_m")
    if (steep := np.abs(amplitude) > 0.5 * wavelength).any():
        text = f"""found a weave of {amplitude[steep][0]:g} m on {wavelength[steep][0]:g} m in {int(steep.sum())}
            run(s); expected an amplitude far below the wavelength; is it in millimetres?"""
        yield checks.implausible_column("amplitude_m, wavelength_m", text)


Span = tuple[float, float]
_SPANS = ("load_left_N", "load_right_N", "distance_m", "speed_mps", "temperature_C", "counts_left", "counts_right")


Check = Callable[[Campaign], Iterator[Note]]

_IN_ORDER: Final[tuple[Check, ...]] = (
    checks.assumed_values, measurements.missing_values, measurements.distance_span,
    measurements.distance_against_log, poses.distance_against_pose,
    counts.reversed_wheels, counts.dead_counters, counts.count_scale, counts.counts_against_log,
    settings.late_logs, settings.counts_per_revolution, settings.log_clock, settings.heading_turns,
    settings.turns_of_kinds, settings.odd_runs, settings.unused_slopes, settings.pose_resolution,
    settings.rounded_values, settings.copied_distances, settings.shifted_sessions,
    counts.swapped_wheels, counts.turn_direction, counts.clock, counts.count_jumps,
    counts.log_speed, counts.steered_by_itself, paths.lost_reference, paths.mirrored_path,
    settings.far_from_line, checks.pasted_rows, measurements.wheel_loads, settings.logged_loads,
    measurements.loads_against_payload, measurements.reference_load, poses.mirrored_ends, poses.turned_frame,
    poses.bearing_of_ends, poses.stated_uncertainties, poses.track_against_bows, poses.gyro_against_reference,
    checks.load_and_session,
    checks.columns_as_one, checks.few_loads, model_against_vehicle, implausible,
)  # fmt: skip
#: name of a check -> function, in the order of the report
CHECKS: Final[dict[str, Check]] = {check.__name__: check for check in _IN_ORDER}


@dataclass(frozen=True, slots=True)
class CampaignContents:
    """What a campaign holds; spans are (smallest, largest), None where nothing was measured."""

    n_runs: int
    n_excluded: int
    sessions: dict[str, int]
    kinds: dict[str, int]
    payloads_kg: tuple[float, ...]
    load_left_N: Span | None
    load_right_N: Span | None
    distance_m: Span | None
    speed_mps: Span | None
    temperature_C: Span | None
    counts_left: Span | None
    counts_right: Span | None
    n_logs: int
    n_samples: int
    rate_Hz: Span | None
    duration_s: Span | None
    log_columns: tuple[str, ...]
    covariates: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CheckReport:
    """What was found, and the notes by level."""

    campaign: str
    simulated: bool
    found: CampaignContents
    #: faults to correct; things to look at; what was recognised and converted
    wrong: tuple[Note, ...]
    suspicious: tuple[Note, ...]
    info: tuple[Note, ...]

    @property
    def verdict(self) -> str:
        """``sound``, ``look at this`` where something is suspicious, or ``wrong``."""
        return "wrong" if self.wrong else "look at this" if self.suspicious else "sound"

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong; suspicious things alone do not count."""
        return not self.wrong


def check_campaign(campaign: Campaign, progress: Progress = silent, further: Iterable[Note] = ()) -> CheckReport:
    """Run every check; nothing is changed.

    `campaign`: read leniently, faults of single runs among its notes; of excluded runs faults alone are reported;
    `further`: found elsewhere.
    """
    excluded = {str(name) for name in campaign.runs.run_id[campaign.runs.excluded]}
    of_totals, included = _with_counts_of_runs(campaign.included())
    of_reading = (note for note in campaign.notes if note.level != "suspicious" or note.run_id not in excluded)
    notes = [*further, *of_totals, *of_reading]
    if not len(included.runs):
        text = f"all {len(excluded)} runs are flagged as excluded, so that nothing is left; clear those that are sound"
        notes.append(checks.column_note("excluded", text, "excluded_all", "wrong"))
    else:
        for check in stepped(CHECKS.values(), progress, "checks"):
            notes.extend(check(included))
    lacking = {f"looks like {name}" for name in _NEEDED if not np.isfinite(included.runs.number(name)).any()}
    notes = [replace(note, level="wrong") if note.text.partition(" and ")[0] in lacking else note for note in notes]
    # a wrong column is not repeated where its cells are wrong
    of_cells = {re.sub(", row [0-9]+", "", note.where) for note in notes if note.run_id and note.level == "wrong"}
    notes = [note for note in notes if note.run_id or note.level != "wrong" or note.where not in of_cells]
    names = ("wrong", "suspicious", "info")
    levels = {level: tuple(dict.fromkeys(note for note in notes if note.level == level)) for level in names}
    return CheckReport(campaign.name, campaign.simulated, _summarise(campaign), **levels)


#: columns that no radius can be computed without
_NEEDED: Final = ("distance_m", "counts_left", "counts_right", "load_left_N", "load_right_N")
#: notes of reading that change a result
_OF_READING: Final = frozenset({"no_unit", "look_alike", "summary_row", "session_spelling", "sim_in_logs"})
#: checks whose findings fit and diagnosis report themselves, or that change neither
_NOT_OF_RESULTS: Final = frozenset(
    {"missing_values", "load_and_session", "few_loads", "implausible", "clock", "steered_by_itself"}
)
#: most findings of one check that a result lists
_MOST_LISTED: Final = 3


def _merged(notes: Iterable[Note]) -> list[Note]:
    merged = []
    for of in grouped((note.text, note) for note in notes).values():
        names = list(dict.fromkeys(one.run_id or one.where for one in of))
        where = f"{'runs ' if of[0].run_id else ''}{checks.listed(names)}"
        merged.append(replace(of[0], where=where) if len(names) > 1 else of[0])
    return merged


def notes_for_results(campaign: Campaign, *, of_loads: bool = True) -> tuple[str, ...]:
    """Return what a fit or a diagnosis states first: findings that change the result and do not show in it.

    `of_loads`: with those on payloads, wheel loads and assumed values, which shift no run's end by a share of its
    length.
    """
    included = _with_counts_of_runs(campaign.included())[1]
    checks = [check for name, check in CHECKS.items() if name not in _NOT_OF_RESULTS]
    of_checks = (check(included) for check in (*checks, settings.odd_lengths))
    sentences = []
    for findings in ([note for note in campaign.notes if note.code in _OF_READING], *of_checks):
        notes = _merged(note for note in findings if of_loads or not ("load" in note.code or note.code == "assumed"))
        sentences += [note.sentence for note in notes[:_MOST_LISTED]]
        if n_more := len(notes[_MOST_LISTED:]):
            sentences.append(f"{n_more} more of this kind ({notes[0].code}): 'calib check' lists them.")
    return tuple(dict.fromkeys(sentences))


_OF_ALL_RADII: Final = frozenset({"count_scale", "contradicted_load", "swapped_loads", "runs, columns load and speed"})


def doubts(campaign: Campaign) -> Iterator[str]:
    """Yield findings on the radii or loads of all runs, which bias a law and show in no residual."""
    included = _with_counts_of_runs(campaign.included())[1]
    scale = ("count_scale",) if checks.stated(included, "vehicle.wheel_radius_m") else ()
    for name in (*scale, "counts_per_revolution", "loads_against_payload", "columns_as_one"):
        for note in CHECKS[name](included):
            if (note.level, note.run_id) == ("suspicious", "") and _OF_ALL_RADII & {note.code, note.where}:
                yield note.sentence


def assumed_notes(campaign: Campaign) -> tuple[str, ...]:
    """Return the assumed values that results rest on, in sentences."""
    return tuple(note.sentence for note in checks.assumed_values(campaign))


def runs_of_broken_counters(campaign: Campaign) -> tuple[str, ...]:
    """Return the runs whose counters jump, were reset or do not count."""
    included = campaign.included()
    notes = (*counts.dead_counters(included), *counts.count_jumps(included))
    return tuple(sorted({note.run_id for note in notes if note.run_id}))


def _summarise(campaign: Campaign) -> CampaignContents:
    runs, logs = campaign.runs, campaign.logs
    duration = log_totals(logs, "t_s")
    rate = (logs.lengths - 1)[duration > 0] / duration[duration > 0]
    payload = runs.number("payload_kg")
    return CampaignContents(
        n_runs=len(runs),
        n_excluded=int(runs.excluded.sum()),
        sessions=_counted(runs.label("session")),
        kinds=_counted(runs.label("kind")),
        payloads_kg=tuple(float(value) for value in np.unique(np.round(payload[np.isfinite(payload)], 3))),
        **{name: _span(runs.number(name)) for name in _SPANS},
        n_logs=int(logs.present.sum()),
        n_samples=int(logs.offsets[-1]),
        rate_Hz=_span(rate),
        duration_s=_span(duration),
        log_columns=tuple(logs.columns),
        covariates=runs.covariates,
    )


def _span(values: FloatArray) -> Span | None:
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else None


def _counted(labels: np.ndarray) -> dict[str, int]:
    return {name: count for name, count in Counter(labels.tolist()).items() if name}
