"""A laboratory's export as users bring it: a German workbook with semicolon loggers, or plain CSV with a file a run.

``python -m tests.campaign.ingest.lab FOLDER`` writes both variants, to try the commands on.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.campaign.model import Campaign
from tests.campaign.making import campaign

N_RUNS = 24
#: numbers of runs: its log is missing; its row is there twice; its log has left and right exchanged
MISSING, TWICE, SWAPPED = 7, 15, 12
PREAMBLE = """Datenlogger DL-8, Firmware 2.1
Seriennummer: 12-345
Fahrzeug: FTF 3; Messstelle: Halle 3
Kanäle: 3, Abtastrate: 10 Hz
Bediener: M. Weber

"""


@dataclass(frozen=True)
class Lab:
    """The files of an export, and the campaign behind them."""

    table: Path
    logs: Path
    truth: Campaign


def _truth(seed: int) -> Campaign:
    truth = campaign(runs_per_load=5, rate_hz=10.0, seed=seed)
    return truth.select(np.arange(N_RUNS))


def _comma(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def _counter(truth: Campaign, run: int, side: str, bits: int | None) -> np.ndarray:
    """A counter that starts at any count and overflows."""
    counts = truth.logs.of(run)[f"counts_{side}"] + 1000 * (run + 3)
    return counts if bits is None else np.mod(counts, 2**bits)


def _rows(truth: Campaign) -> list[list[object]]:
    runs = truth.runs
    out: list[list[object]] = []
    for run in range(N_RUNS):
        out.append(
            [
                f"Lauf {run + 1}",
                f"0{4 + run // 6}.05.2026",
                f"Tag {run // 6 + 1}",
                "hin" if runs.label("direction")[run] == "out" else "zurueck",
                _comma(runs.number("payload_kg")[run], 1),
                _comma(1e3 * runs.number("payload_x_m")[run], 0),
                _comma(1e3 * runs.number("payload_y_m")[run], 0),
                _comma(runs.number("speed_mps")[run], 2),
                _comma(1e3 * runs.number("distance_m")[run], 1),
                "Reifen gewechselt" if run == 3 else "",
            ]
        )
        if run + 1 == TWICE:
            out.append(list(out[-1]))
    return out


HEADER = (
    "Lauf",
    "Datum",
    "Sitzung",
    "Fahrtrichtung",
    "Zuladung [kg]",
    "Abstand vorn [mm]",
    "Versatz [mm]",
    "Geschw. [m/s]",
    "Strecke [mm]",
    "Bemerkung",
)


def german(folder: Path, *, seed: int = 11) -> Lab:
    """Write the workbook and the loggers' files."""
    import openpyxl

    truth = _truth(seed)
    logs = folder / "logger"
    logs.mkdir(parents=True)
    book = openpyxl.Workbook()
    book.active.title = "Messungen"
    book.active.append(["Messkampagne FTF 3, Halle 3, Mai 2026"])
    book.active.append([])
    book.active.append(list(HEADER))
    for row in _rows(truth):
        book.active.append(row)
    book.create_sheet("Notizen").append(["Laser am 3. Mai geprüft"])
    table = folder / "Messkampagne.xlsx"
    book.save(table)
    for run in range(N_RUNS):
        if run + 1 == MISSING:
            continue
        sides = ("right", "left") if run + 1 == SWAPPED else ("left", "right")
        left, right = (_counter(truth, run, side, 16) for side in sides)
        start = np.datetime64("2026-05-04T08:00:00") + np.timedelta64(600 * run, "s")
        times = start.astype("datetime64[ms]") + np.rint(truth.logs.of(run)["t_s"] * 1e3).astype("timedelta64[ms]")
        way = truth.logs.of(run)["counts_left"] / truth.logs.of(run)["counts_left"][-1]
        path = 1e3 * way * truth.runs.number("distance_m")[run]
        lines = [
            f"{time}+02:00;{a:.0f};{b:.0f};{_comma(mm, 1)}"
            for time, a, b, mm in zip(times, left, right, path, strict=True)
        ]
        text = PREAMBLE + "Zeitstempel;Impulse links;Impulse rechts;Laser [mm]\n" + "\n".join(lines) + "\n"
        (logs / f"Lauf_{run + 1:02}.csv").write_bytes(text.encode("cp1252"))
    return Lab(table, logs, truth)


def plain(folder: Path, *, seed: int = 11) -> Lab:
    """Write a run table as plain CSV, and a CSV file a run under the run's name."""
    truth = _truth(seed)
    logs = folder / "runs"
    logs.mkdir(parents=True)
    runs = truth.runs
    table = folder / "runs.csv"
    header = "run,day,way,load kg,load x mm,load y mm,speed (m/s),distance mm"
    lines = [
        header.replace("load x mm", "payload_x_mm")
        .replace("load y mm", "payload_y_mm")
        .replace("load kg", "payload_kg")
    ]
    for run in range(N_RUNS):
        cells: Sequence[object] = (
            f"run{run + 1:02}",
            f"day{run // 6 + 1}",
            "there" if runs.label("direction")[run] == "out" else "return",
            f"{runs.number('payload_kg')[run]:g}",
            f"{1e3 * runs.number('payload_x_m')[run]:g}",
            f"{1e3 * runs.number('payload_y_m')[run]:g}",
            f"{runs.number('speed_mps')[run]:g}",
            f"{1e3 * runs.number('distance_m')[run]:.1f}",
        )
        lines += [",".join(map(str, cells))] * (2 if run + 1 == TWICE else 1)
        if run + 1 == MISSING:
            continue
        sides = ("right", "left") if run + 1 == SWAPPED else ("left", "right")
        left, right = (_counter(truth, run, side, 16) for side in sides)
        log = "\n".join(
            f"{1e3 * t:.0f},{a:.0f},{b:.0f}" for t, a, b in zip(truth.logs.of(run)["t_s"], left, right, strict=True)
        )
        (logs / f"run{run + 1:02}.csv").write_text("time_ms,enc_left,enc_right\n" + log + "\n")
    table.write_text("\n".join(lines) + "\n")
    return Lab(table, logs, truth)


if __name__ == "__main__":
    target = Path(sys.argv[1])
    german(target / "german")
    plain(target / "plain")
