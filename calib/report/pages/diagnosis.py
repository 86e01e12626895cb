"""The diagnosis of the sim-to-real gap: verdict, where, which, what cannot be told apart, how far, what next."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

import numpy as np

from calib.report.blocks import Block, Column, Items, Notice, Picture, Section, Table, Text
from calib.report.figures import gap as gap_figures
from calib.report.gap_causes import MOST, apart_blocks, cause_blocks, effect_name, finite, percent
from calib.report.gap_findings import GapFindings
from calib.report.gap_lines import place_line, run_line
from calib.report.numbers import MISSING, fixed, left, probability, prose, readable, two_digits
from calib.report.source import Source

__all__ = ["gap_section", "section"]

_VERDICTS: Final[Mapping[str, tuple[str, str]]] = {
    "no_gap": ("good", "No gap beyond the noise"),
    "explained": ("good", "The gap is explained"),
    "partly_explained": ("note", "The gap is explained in part"),
    "ambiguous": ("note", "These runs cannot tell the causes apart"),
    "unknown": ("bad", "The cause of the gap is unknown"),
}


def section(source: Source) -> Section | None:
    """Return the findings of the diagnosis, or None where none was asked for."""
    return None if source.gap is None else gap_section(source.gap)


def gap_section(gap: GapFindings) -> Section:
    """Return what a report says of the findings of a diagnosis."""
    verdict = gap.verdict
    level, title = _VERDICTS.get(str(verdict.get("verdict")), ("note", str(verdict.get("verdict"))))
    blocks: list[Block] = [
        Text(
            "The gap is measured minus simulated motion, run by run. The floor is what repeats of the same run "
            "scatter; no model gets below it."
        ),
        Notice(level, title, _sentence(verdict)),
        *_where(gap),
        *cause_blocks(verdict),
        *apart_blocks(verdict),
        *_closure(gap),
        *_next_runs(verdict),
    ]
    notes = [prose(str(note)) for note in verdict.get("notes") or ()]
    if notes:
        blocks.append(Items(tuple(notes)))
    return Section("Diagnosis of the gap", tuple(blocks))


def _sentence(verdict: Mapping[str, Any]) -> str:
    """Return the verdict's own sentence, or one made of its parts."""
    said = str(verdict.get("sentence") or "")
    if said:
        return prose(said)
    causes = [str(cause.get("title") or effect_name(cause.get("effect"))) for cause in verdict.get("causes") or ()]
    groups = [" or ".join(effect_name(effect) for effect in group) for group in verdict.get("indistinguishable") or ()]
    kind = verdict.get("verdict")
    if kind == "no_gap":
        return "Measured and simulated motion differ by no more than repeats do."
    if kind == "ambiguous" and groups:
        return f"These runs cannot tell apart: {'; '.join(groups)}."
    if kind in {"explained", "partly_explained"} and causes:
        rest = "." if kind == "explained" else "; a rest of unknown cause remains."
        return f"Cause: {' and '.join(causes)}{rest}"
    return "No effect of the library explains the gap."


def _length(value_m: float) -> str:
    factor, unit = readable("m", value_m)
    return f"{two_digits(factor * value_m)} {unit}"


def _where(gap: GapFindings) -> list[Block]:
    blocks: list[Block] = []
    where = gap.verdict.get("where") or {}
    if gap.offset_m is not None and gap.paths_m:
        largest = float(np.nanmax(np.hypot(*gap.offset_m.T), initial=0.0))
        blocks.append(
            Picture(
                "gap-map",
                "The gap on the floor plan: paths driven, and arrows from the simulated to the measured end of each "
                "run.",
                f"Floor plan of {len(gap.paths_m)} runs with the gap at their ends, at most {_length(largest)}",
                partial(gap_figures.gap_map, gap.paths_m, gap.offset_m, gap.group),
            )
        )
    channels = [(name, found) for name, found in (where.get("channels") or {}).items() if found]
    if channels:
        units = dict(gap.channels)
        rows = []
        for name, found in channels:
            rms, floor = finite(found.get("rms")), finite(found.get("floor"))
            unit = units.get(name, "rad" if name in {"heading", "steering"} else "m")
            factor, shown = readable(unit, rms or 0.0)
            ratio = rms / floor if rms is not None and floor else None
            cells = (two_digits(None if value is None else factor * value) for value in (rms, floor))
            rows.append((effect_name(name), shown, *cells, fixed(ratio, 1)))
        blocks.append(
            Table(
                "The gap by channel, root mean square, against its floor.",
                (left("Channel"), left("Unit"), Column("Gap"), Column("Floor"), Column("Ratio")),
                tuple(rows),
            )
        )
    picture = _by_covariate(gap)
    if picture is not None:
        blocks.append(picture)
    covariates = [row for row in where.get("covariates") or () if isinstance(row, Mapping)]
    if covariates:
        blocks.append(
            Table(
                "What the gap depends on: share of its variance, and p corrected for the number of tests.",
                (left("Dependence"), Column("Share"), Column("p")),
                tuple(
                    (effect_name(row.get("name")), percent(row.get("share")), probability(finite(row.get("p_value"))))
                    for row in covariates[:MOST]
                ),
            )
        )
    for key, title, line in (("runs", "Runs", run_line), ("places", "Places", place_line)):
        said = [prose(line(item)) for item in (where.get(key) or ())][:MOST]
        if said:
            blocks += [Text(f"{title} where the gap stands out:"), Items(tuple(said))]
    return blocks


def _by_covariate(gap: GapFindings) -> Picture | None:
    if gap.before is None or not gap.covariates or not gap.channels:
        return None
    varied = {
        name: values
        for name, values in gap.covariates.items()
        if np.isfinite(values).sum() >= 3 and float(np.nanmax(values)) > float(np.nanmin(values))
    }
    # the channel that stands furthest above its floor
    ratios = []
    for k in range(len(gap.channels)):
        values = gap.before[:, k]
        found = values[np.isfinite(values)]
        floor = 1.0 if gap.floor is None else _rms(gap.floor[:, k])
        ratios.append(_rms(found) / floor if len(found) >= 3 and floor > 0 else -1.0)
    if not varied or max(ratios) <= 0:
        return None
    worst = int(np.argmax(ratios))
    channel, unit = gap.channels[worst]
    title = effect_name(channel)
    # what the channel depends on most comes first: only so many panels are drawn
    lines = [row for row in (gap.verdict.get("where") or {}).get("covariates") or () if isinstance(row, Mapping)]
    lines.sort(key=lambda row: not row.get("significant"))
    rank = {str(row.get("name")): number for number, row in reversed(list(enumerate(lines)))}
    varied = dict(sorted(varied.items(), key=lambda one: rank.get(one[0], len(rank))))
    floor_value = None if gap.floor is None else _rms(gap.floor[:, worst])
    return Picture(
        "gap-by-covariate",
        f"The {title} gap against what varied between the runs; squares are means with their standard errors, the grey "
        "band is the floor.",
        f"Gap of the channel {title} against {', '.join(effect_name(name) for name in list(varied)[:6])}",
        partial(
            gap_figures.gap_by_covariate,
            gap.before[:, worst],
            effect_name(channel),
            unit,
            varied,
            floor=floor_value,
            group=gap.group,
        ),
    )


def _rms(values: Any) -> float:
    found = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(found**2))) if len(found) else 0.0


def _closure(gap: GapFindings) -> list[Block]:
    blocks: list[Block] = []
    found = gap.verdict.get("closure") or {}
    before, after, floor = (finite(found.get(f"{name}_rms_m")) for name in ("before", "after", "floor"))
    if before is not None and after is not None:
        text = (
            f"On held-out runs (by {effect_name(found.get('held_out') or 'run')}) the gap is "
            f"{_length(before)} with the model alone and {_length(after)} with the cause added"
        )
        text += "." if floor is None else f"; the floor is {_length(floor)}."
        fraction, ends = finite(found.get("fraction")), found.get("ci95")
        if fraction is not None:
            text += f" With every run and channel weighed by its noise, that closes {percent(fraction)} of the gap"
            text += " above the floor"
            text += f" (95 % interval {percent(ends[0])} to {percent(ends[1])})." if ends else "."
        text += (
            " The fix is recommended."
            if gap.verdict.get("recommended")
            else " No fix is recommended on the strength of these runs."
        )
        blocks.append(Text(text))
    beside = gap.verdict.get("headline")
    if beside:
        blocks.append(Text(prose(str(beside["sentence"]))))
    if gap.before is not None and gap.after is not None and gap.floor is not None and np.isfinite(gap.before).any():
        blocks.append(
            Picture(
                "gap-before-after",
                "The gap of every run before and after, channel by channel, on runs that the fit has not seen; bars "
                "are root mean squares, the grey band is the floor.",
                "Gap before and after by channel: "
                + "; ".join(
                    f"{effect_name(name)} {_rms(gap.before[:, k]):.3g} to {_rms(gap.after[:, k]):.3g} {unit}"
                    for k, (name, unit) in enumerate(gap.channels)
                    if np.isfinite(gap.before[:, k]).any()
                ),
                partial(
                    gap_figures.before_after,
                    [(effect_name(name), unit) for name, unit in gap.channels],
                    gap.before,
                    gap.after,
                    gap.floor,
                ),
            )
        )
    return blocks


def _next_runs(verdict: Mapping[str, Any]) -> list[Block]:
    runs = [run for run in verdict.get("next_runs") or () if isinstance(run, Mapping)]
    if not runs:
        return []
    rows = []
    for number, run in enumerate(runs[:MOST], start=1):
        payload, speed = finite(run.get("payload_kg")), finite(run.get("speed_mps"))
        rows.append(
            (
                str(number),
                " ".join(effect_name(run[key]) for key in ("kind", "direction") if run.get(key)),
                MISSING if payload is None else f"{payload:g}",
                MISSING if speed is None else f"{speed:g}",
                prose(str(run.get("why", ""))),
            )
        )
    columns = (
        Column("No."),
        left("Route"),
        Column("Payload", "kg"),
        Column("Speed", "m/s"),
        left("What it tells", wide=True),
    )
    return [Table("Runs to drive next, best first.", columns, tuple(rows))]
