"""An English export: a workbook of three header rows, merged days and a lookup sheet; tab-separated loggers.

``python -m tests.campaign.ingest.english FOLDER`` writes it, to try the commands on.
"""

from __future__ import annotations

import datetime
import sys
from pathlib import Path

import numpy as np

from calib.campaign.model import Campaign
from tests.campaign.ingest.lab import Lab
from tests.campaign.making import PAYLOADS_KG, campaign

N_RUNS = 24
#: runs a day: the day's cell is merged over them
A_DAY = 6
#: run whose log has left and right exchanged; whose log lacks three seconds; whose log repeats stamps
SWAPPED, DROPOUT, REPEATED = 9, 5, 14
LABELS = ("empty", "P50", "P100", "P150", "P200")
GROUPS = ("Run", None, None, None, "Payload", "Path", None, None, "Conditions", None)
NAMES = ("Trial", "Date", "Start", "Way", "Label", "Route", "Dist.", "Speed", "Hall temp.", "Operator")
UNITS = ("[-]", "[d]", "[hh:mm]", None, None, None, "[mm]", "[mm/s]", "[°C]", None)
COMMENTS = "# AGV logger 3.2\n# SN 4711; firmware 12\n# channels: 4, rate 20 Hz\n"
GRAVITY_MPS2 = 9.81


def english(folder: Path, *, seed: int = 23) -> Lab:
    """Write the workbook and the loggers' files."""
    truth = campaign(runs_per_load=5, rate_hz=20.0, seed=seed).select(np.arange(N_RUNS))
    logs = folder / "loggers"
    logs.mkdir(parents=True)
    table = folder / "AGV trials.xlsx"
    _write_workbook(table, truth)
    for run in range(N_RUNS):
        _write_log(logs, truth, run)
    return Lab(table, logs, truth)


def _write_workbook(table: Path, truth: Campaign) -> None:
    import openpyxl

    runs = truth.runs
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "Trials"
    for row in (GROUPS, NAMES, UNITS):
        sheet.append(row)
    days = []
    for run in range(N_RUNS):
        if run == 2 * A_DAY:
            sheet.append(["laser realigned after lunch"])
        if not run % A_DAY:
            days.append(sheet.max_row + 1)
        sheet.append(
            [
                run + 1,
                None if run % A_DAY else datetime.date(2026, 5, 4 + run // A_DAY),
                datetime.time(8, (10 * run) % 60),
                {"out": "outbound", "back": "inbound"}[str(runs.label("direction")[run])],
                LABELS[PAYLOADS_KG.index(runs.number("payload_kg")[run])],
                "corridor",
                round(1e3 * runs.number("distance_m")[run], 1),
                1e3 * runs.number("speed_mps")[run],
                20.5 + 0.1 * (run % 4),
                "KM",
            ]
        )
    distance = 1e3 * runs.number("distance_m")
    sheet.append(["mean", None, None, None, None, None, float(distance.mean())])
    sheet.append(["sum", None, None, None, None, None, float(distance.sum())])
    sheet.append(["KM: tyres at 3.2 bar throughout"])
    for merged in ("A1:D1", "F1:H1", "I1:J1", *(f"B{row}:B{row + A_DAY - 1}" for row in days)):
        sheet.merge_cells(merged)
    lookup = book.create_sheet("Payloads")
    lookup.append(["Label", "Mass", "Wheel left", "Wheel right"])
    lookup.append([None, "[kg]", "[kg]", "[kg]"])
    for label, mass in zip(LABELS, PAYLOADS_KG, strict=True):
        run = int(np.flatnonzero(runs.number("payload_kg") == mass)[0])
        loads = (float(runs.number(f"load_{side}_N")[run]) / GRAVITY_MPS2 for side in ("left", "right"))
        lookup.append([label, mass, *loads])
    book.save(table)


def _write_log(folder: Path, truth: Campaign, run: int) -> None:
    """Write a logger's file: a row of units beneath the names, epoch milliseconds, 16-bit counters."""
    log = truth.logs.of(run)
    sides = ("right", "left") if run + 1 == SWAPPED else ("left", "right")
    left, right = (np.mod(log[f"counts_{side}"] + 1000 * (run + 3), 2**16) for side in sides)
    start = datetime.datetime(2026, 5, 4 + run // A_DAY, 8, (10 * run) % 60, tzinfo=datetime.UTC)
    stamp = int(start.timestamp() * 1000) + np.rint(1e3 * log["t_s"]).astype(np.int64)
    way = log["counts_left"] / log["counts_left"][-1] * truth.runs.number("distance_m")[run]
    rows = [
        f"{t}\t{a:.0f}\t{b:.0f}\t{1e3 * s:.1f}\t{24.1:.1f}" for t, a, b, s in zip(stamp, left, right, way, strict=True)
    ]
    if run + 1 == DROPOUT:
        del rows[400:460]
    if run + 1 == REPEATED:
        rows[300:300] = rows[299:300]
        rows[700:700] = rows[699:700]
    text = COMMENTS + "time\tQuad_L\tQuad_R\tlaser\tUbat\nms\tcnt\tcnt\tmm\tV\n" + "\n".join(rows) + "\n# end of file\n"
    (folder / f"{start:%Y%m%d_%H%M%S}_TR{run + 1}.tsv").write_text(text)


if __name__ == "__main__":
    english(Path(sys.argv[1]))
