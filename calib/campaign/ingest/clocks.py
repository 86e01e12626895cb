"""What the clocks of a recording's streams show, and how far other streams lag behind the wheels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from calib.arrays import FloatArray
from calib.campaign.faults import Border
from calib.campaign.ingest.lag import Lag, estimate_lag
from calib.campaign.ingest.mapping import Line
from calib.campaign.readers.recording import Recording, Stream
from calib.campaign.readers.times import NS_PER_S
from calib.campaign.wraps import detect_wrap_bits, unwrap

_POSE: Final = ("ref_x_m", "ref_y_m")
#: units of a wheel's column that tell how far it turned
_PATHS: Final = frozenset({"counts", "turns", "rad", "deg"})


def say_clocks(recording: Recording, base: Stream, shown: str, border: Border) -> None:
    """Say what the streams' clocks show: span, rate, gaps, and offsets between streams."""
    for stream in recording.streams:
        report = stream.report()
        if report is None:
            continue
        text = f"{report.n_samples} samples over {report.span_s:.6g} s at {report.rate_Hz:.4g} Hz ({stream.clock})"
        level = "info"
        if report.n_gaps:
            text += f"; {report.n_gaps} gap(s), the longest {report.longest_gap_s:.3g} s"
        if stream is not base and base.time_ns is not None and stream.time_ns is not None:
            text += f"; starts {(report.start_ns - int(base.time_ns[0])) / NS_PER_S:+.6g} s from the wheels"
            if stream.behind_arrival_s is not None and base.behind_arrival_s is not None:
                apart = stream.behind_arrival_s - base.behind_arrival_s
                text += f", stamps {apart:+.4g} s older at arrival than theirs"
            if report.end_ns < int(base.time_ns[0]) or report.start_ns > int(base.time_ns[-1]):
                text += "; the spans do not meet: the clocks differ"
                level = "suspicious"
        border.say(f"{shown}, {stream.name}", text, "clock", level=level)


def estimate_lags(
    recording: Recording, lines: Mapping[str, Line], base: Stream, shown: str, border: Border
) -> dict[str, Lag]:
    """Estimate how far the reference and the rangefinder lag behind the wheels, and say so; see `say_clocks`."""
    wheels = [
        base.columns[line.column]
        for name, line in lines.items()
        if name.startswith("counts_") and line.column in base.columns and (line.unit or "counts") in _PATHS
    ]
    if not wheels or base.time_ns is None:
        return {}
    origin = int(base.time_ns[0])
    time = (base.time_ns - origin) / NS_PER_S
    travelled = np.mean([_run_on(path) for path in wheels], axis=0)
    driven = np.cumsum(np.abs(np.diff(travelled, prepend=travelled[:1])))
    lags: dict[str, Lag] = {}
    for name, (stream, path) in _others(recording, lines, base).items():
        if stream.time_ns is None or len(path) < 20:
            continue
        lag = estimate_lag(time, driven, (stream.time_ns - origin) / NS_PER_S, path)
        if lag is None:
            continue
        lags[name] = lag
        low, high = lag.ci95_s
        border.say(
            f"{shown}, {stream.name}",
            f"the {name} lags {1e3 * lag.lag_s:+.1f} ms behind the wheels "
            f"(95 %: {1e3 * low:+.1f} .. {1e3 * high:+.1f}, by their speeds)",
            "lag",
        )
    return lags


def _run_on(counts: FloatArray) -> FloatArray:
    whole = np.asarray([0, len(counts)])
    bits = detect_wrap_bits(counts, whole)
    return counts if bits is None else unwrap(counts, whole, bits)[0]


def _others(recording: Recording, lines: Mapping[str, Line], base: Stream) -> dict[str, tuple[Stream, FloatArray]]:
    """Return path driven by other streams: the reference's, the rangefinder's."""
    out: dict[str, tuple[Stream, FloatArray]] = {}
    if all(name in lines for name in _POSE):
        stream = recording.stream_of(lines["ref_x_m"].column)
        if stream is not None and stream.name != base.name and lines["ref_y_m"].column in stream.columns:
            x, y = (stream.columns[lines[name].column] for name in _POSE)
            out["reference"] = stream, _smoothed_path(stream, np.column_stack([x, y]))
    if "range_m" in lines:
        stream = recording.stream_of(lines["range_m"].column)
        if stream is not None and stream.name != base.name:
            out["range_m"] = stream, _smoothed_path(stream, stream.columns[lines["range_m"].column][:, None])
    return out


def _smoothed_path(stream: Stream, places: FloatArray) -> FloatArray:
    """Return the path through places at a spacing that noise does not lengthen much, at every sample."""
    report = stream.report()
    stride = max(1, round(0.1 * report.rate_Hz)) if report else 1
    known = np.isfinite(places).all(axis=1)
    index = np.flatnonzero(known)[::stride]
    steps = np.linalg.norm(np.diff(places[index], axis=0), axis=1)
    total = np.concatenate(([0.0], np.cumsum(steps)))
    every: FloatArray = np.interp(np.arange(len(places)), index, total)
    return every
