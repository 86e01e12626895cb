"""Lines of a mapping that only the laboratory can fill in: what the vehicle is, and columns that nothing looks like."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from calib.campaign.columns import recognise
from calib.campaign.ingest.found import FileFound
from calib.campaign.model import LOG_COLUMNS

#: keys that only the laboratory knows, with what they are
_STATE: Final = {
    "vehicle": {
        "track_m": "between the contact points of the rear wheels",
        "wheelbase_m": "rear axle to front wheel",
        "wheel_radius_m": "nominal",
        "mass_kg": "without payload",
        "cog_x_m": "centre of mass ahead of the rear axle",
    },
    "encoder": {"counts_per_rev": "counts a wheel revolution, gear and quadrature included"},
    "rangefinder": {"sigma_m": "standard uncertainty of one distance"},
}
#: keys of a vehicle without encoders on its rear wheels, by what is counted instead, and what it drives on
_OTHER_WHEELS: Final = {
    "counts_rear_left": (
        'drive = "mecanum"   # four wheels are counted',
        ("#half_length_plus_half_width_m =   # half the wheelbase plus half the track",),
        (),
    ),
    "counts_front": (
        'drive = "tricycle"   # no rear wheel is counted, the front wheel is',
        ("#front_wheel_radius_m =   # nominal",),
        ("#counts_per_rev_front =   # of the front wheel, where it differs",),
    ),
}


def settings_lines(bits: int | None) -> list[str]:
    """Return the sections of vehicle and instruments, each key a remark; `bits`: the counters' width where found."""
    lines: list[str] = []
    for section, keys in _STATE.items():
        lines += [
            "",
            f"[{section}]" + ("   # state what you know; what is left out is marked as assumed" if not lines else ""),
        ]
        lines += [f"#{key} =   # {what}" for key, what in keys.items()]
        if section == "encoder" and bits:
            lines.append(f"wrap_bits = {bits}   # found in the jumps of the counters")
    return lines


def _named(proposed: Sequence[str], logs: Sequence[FileFound]) -> set[str]:
    """Return the columns that proposed lines name, and those that carry calib's names already."""
    own = {recognise(column.name, LOG_COLUMNS).name or "" for log in logs for column in log.columns}
    return own | {line.partition(" ")[0] for line in proposed}


def with_other_wheels(lines: list[str], proposed: Sequence[str], logs: Sequence[FileFound]) -> list[str]:
    """Return the lines with the keys that a vehicle without rear encoders needs."""
    named = _named(proposed, logs)
    wheels = next((name for name in _OTHER_WHEELS if name in named), None)
    if wheels is None or "counts_left" in named:
        return lines
    drive, vehicle, encoder = _OTHER_WHEELS[wheels]
    out: list[str] = []
    for line in lines:
        if wheels == "counts_rear_left" and line.startswith("#track_m"):
            out += vehicle
            continue
        out.append(line)
        if line.startswith("[vehicle]"):
            out.append(drive)
        elif line.startswith("#wheel_radius_m") and wheels == "counts_front":
            out += vehicle
        elif line.startswith("#counts_per_rev"):
            out += encoder
    return out


def missing_lines(proposed: Sequence[str], logs: Sequence[FileFound]) -> list[str]:
    """Return remarks on what a log cannot do without and no column looks like: wheels, and a clock."""
    named = _named(proposed, logs)
    lines = []
    clocked = any(stream.start_ns is not None for log in logs for stream in log.streams)
    timed = any(column.kind == "time" for log in logs for column in log.columns)
    if not clocked and not timed and "t_s" not in named:
        lines.append('#t_s = ""   # no column looks like times; every log needs them')
    if not any(name.startswith("counts_") for name in named):
        lines.append(
            '#counts_left = ""   # no column looks like a wheel: name those of the encoders (unit = "rad/s", ...'
        )
        lines.append(
            '#counts_right = ""   # where it holds no counts); for one wheel in front counts_front and steer_rad'
        )
    return lines
