"""Data that changes the answer: ``python -m tests.blunders.silent`` tries each fault on two campaigns.

Of each campaign (a corridor, and one of several routes) and each fault the answer of ``check``, ``fit`` and
``diagnose`` is held against that of the campaign as it is: *named* where the command says something new, refuses or
ends with another exit status; *unchanged* where it says nothing new and its answer is the same within a tenth of its
interval; *silent* where it says nothing and answers something else.
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from calib.cli.main import run

SAMPLES: Final = Path(__file__).resolve().parents[2] / "sample_runs"
CAMPAIGNS: Final = ("corridor", "yard")
COMMANDS: Final = ("check", "fit", "diagnose")
#: a change of less than this share of the interval is no other answer
SAME_SHARE: Final = 0.1

Change = Callable[[pd.DataFrame], pd.DataFrame]


@dataclass(frozen=True, slots=True)
class Fault:
    """What is done to a campaign: to its run table, to logs of some runs, to its settings."""

    name: str
    table: Change | None = None
    log: Change | None = None
    #: which runs' logs; all by default
    runs: tuple[int, ...] = ()
    settings: tuple[str, str] | None = None
    #: what the answer is held against, where the fault is another spelling of it: a change of the sound table
    beside: Change | None = None


def cells(column: str, change: Callable[[float], object], rows: slice = slice(None)) -> Change:
    """Return a change of some cells of a column; empty cells stay empty, and a table without the column as it is."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        if column not in table:
            return table
        table = table.copy()
        old = table[column].tolist()
        new = [cell if cell == "" else str(change(float(cell))) for cell in old]
        table[column] = [new[n] if n in range(*rows.indices(len(old))) else cell for n, cell in enumerate(old)]
        return table

    return changed


def texts(column: str, change: Callable[[str], str], step: int = 2) -> Change:
    """Return a change of the text of every so many rows."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        table = table.copy()
        table[column] = [change(cell) if n % step else cell for n, cell in enumerate(table[column])]
        return table

    return changed


def both(*changes: Change) -> Change:
    """Return changes one after the other."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        for change in changes:
            table = change(table)
        return table

    return changed


def renamed(names: dict[str, str]) -> Change:
    """Return a change of column names."""
    return lambda table: table.rename(columns=names)


def weighed(unit: str, per_newton: float) -> Change:
    """Return loads as weighed (other than computed ones), in a unit of a scale."""
    left, right = (
        both(
            cells(f"load_{side}_N", lambda v, f=factor: v * f * per_newton),
            renamed({f"load_{side}_N": f"load_{side}{unit}"}),
        )
        for side, factor in (("left", 1.15), ("right", 0.9))
    )
    return both(left, right)


def summary(of: Callable[[pd.DataFrame], pd.Series], label: str) -> Change:
    """Return a further row that sums up the others."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        numbers = table.apply(pd.to_numeric, errors="coerce")
        row = {name: "" if np.isnan(value) else str(value) for name, value in of(numbers).items()}
        row |= {"run_id": label, "kind": table["kind"].iloc[0], "session": table["session"].iloc[0]}
        return pd.concat([table, pd.DataFrame([row])], ignore_index=True).fillna("")

    return changed


def shifted(values: pd.DataFrame, columns: tuple[str, ...], by: float, kind: type = np.float64) -> pd.DataFrame:
    """Return a table with columns moved, in a precision."""
    for name in columns:
        if name in values:
            values = cells(name, lambda v: float(kind(v + by)))(values.astype(str))
    return values


def faults() -> Iterator[Fault]:
    """Yield all faults."""
    for unit, factor in {
        "_kg": 1 / 9.81,
        "_g": 1e3 / 9.81,
        "_t": 1e-3 / 9.81,
        "_lb": 1 / 4.448,
        "_lbf": 1 / 4.448,
    }.items():
        yield Fault(f"loads weighed{unit}", weighed(unit, factor), beside=weighed("_N", 1.0))
    for unit, factor in {"_kN": 1e-3, "_daN": 0.1, "_kgf": 1 / 9.80665, " [N]": 1.0, " (kg)": 1 / 9.81}.items():
        yield Fault(f"loads weighed{unit}", weighed(unit, factor), beside=weighed("_N", 1.0))
    for left, right in (("load_left", "load_right"), ("load_l_N", "load_r_N"), ("left_load_N", "right_load_N")):
        yield Fault(f"loads in {left}", both(weighed("_N", 1.0), renamed({"load_left_N": left, "load_right_N": right})))
    yield Fault(
        "loads in weighed_load_left_N",
        both(weighed("_N", 1.0), renamed({f"load_{s}_N": f"weighed_load_{s}_N" for s in ("left", "right")})),
    )
    yield Fault(
        "loads in LoadLeft", both(weighed("_N", 1.0), renamed({"load_left_N": "LoadLeft", "load_right_N": "LoadRight"}))
    )
    for column in ("temperature_C", "speed_mps", "minutes_under_load"):
        yield Fault(f"one {column} empty", both(lambda t, c=column: t.assign(**{c: ["", *t[c][1:]]}) if c in t else t))
        for value in (999.0, -999.0, 1e6):
            yield Fault(f"one {column} {value:g}", cells(column, lambda _, v=value: v, slice(3, 4)))
    yield Fault("temperature in kelvin", cells("temperature_C", lambda v: v + 273.15))
    yield Fault(
        "temperature_F",
        both(cells("temperature_C", lambda v: 1.8 * v + 32), renamed({"temperature_C": "temperature_F"})),
    )
    yield Fault("temperature without unit", renamed({"temperature_C": "temperature"}))
    yield Fault("temp_C", renamed({"temperature_C": "temp_C"}))
    for turns in (1, -1):
        for row in (2, 4):
            yield Fault(
                f"heading of row {row} off by {turns} turn",
                cells("ref_theta_rad", lambda v, k=turns: v + 2 * np.pi * k, slice(row, row + 1)),
            )
    yield Fault("headings in degrees", cells("ref_theta_rad", np.degrees))
    for label, change in {
        "upper case": str.upper,
        "title": str.title,
        "blank behind": lambda s: f"{s} ",
        "full width": lambda s: "".join(chr(ord(c) + 0xFEE0) if "!" <= c <= "~" else c for c in s),
    }.items():
        yield Fault(f"sessions in {label}", texts("session", change))
    yield Fault(
        "sessions 1 and 1.0",
        both(
            lambda t: t.assign(session=[str(list(dict.fromkeys(t["session"])).index(s)) for s in t["session"]]),
            texts("session", lambda s: f"{s}.0"),
        ),
    )
    yield Fault("sessions blank", lambda t: t.assign(session=""))
    for label, of in {
        "mean": pd.DataFrame.mean,
        "sum": pd.DataFrame.sum,
        "r999": pd.DataFrame.mean,
        "Mittelwert": pd.DataFrame.mean,
        "average": pd.DataFrame.median,
    }.items():
        yield Fault(f"a row {label}", summary(partial(of, numeric_only=True), label))
    for counts in (3, 7, -7, 200):
        change = both(*(cells(f"counts_{side}", lambda v, c=counts: int(v + c)) for side in ("left", "right")))
        yield Fault(f"counts of the table {counts:+d}", change)
    for new in (4097, 4095, 4178, 4014, 2048, 8192, 1000):
        yield Fault(f"counts_per_rev = {new}", settings=("counts_per_rev = 4096", f"counts_per_rev = {new}"))
    for old, new in (
        ("track_m = 0.7\n", "track_m = 700\n"),
        ("wheel_radius_m = 0.1\n", "wheel_radius_m = 0.103\n"),
        ("mass_kg = 100.0", "mass_kg = 0.1"),
    ):
        yield Fault(f"{new.strip()}", settings=(old, new))
    for unit, factor in {"milliseconds": 1e3, "microseconds": 1e6}.items():
        for runs in ((), tuple(range(12)), (5,)):
            yield Fault(
                f"t_s in {unit} in {len(runs) or 'all'} logs",
                log=lambda t, f=factor: t.assign(t_s=t["t_s"].astype(float) * f),
                runs=runs,
            )
    yield Fault("one log backwards", log=lambda t: t.iloc[::-1], runs=(4,))
    yield Fault(
        "one log of another run",
        log=lambda t: t.assign(counts_left=t["counts_right"], counts_right=t["counts_left"]),
        runs=(4,),
    )
    for kind, by in ((np.float32, 5.5e6), (np.float32, 4e5)):
        yield Fault(
            f"positions in single precision at {by:g} m",
            lambda t, k=kind, b=by: shifted(shifted(t, ("ref_x_m", "ref_y_m"), b, k), ("ref_x_m", "ref_y_m"), -b),
        )
    for column, factor, rows in (
        ("distance_m", 1000.0, slice(2, 3)),
        ("distance_m", 0.001, slice(2, 3)),
        ("distance_m", 3.281, slice(None)),
        ("distance_m", 1000.0, slice(None)),
        ("counts_left", 2.0, slice(3, 4)),
        ("counts_left", -1.0, slice(3, 4)),
        ("payload_kg", 1000.0, slice(2, 3)),
        ("payload_kg", 2.2046, slice(None)),
        ("speed_mps", 3.6, slice(None)),
        ("ref_x_m", 1000.0, slice(None)),
        ("ref_y_m", -1.0, slice(None)),
    ):
        where = "one cell" if rows != slice(None) else "all"
        yield Fault(f"{column} times {factor:g}, {where}", cells(column, lambda v, f=factor: v * f, rows))
    yield Fault("a run twice", lambda t: pd.concat([t, t.iloc[[3]]]))
    yield Fault("a run twice under another name", lambda t: pd.concat([t, t.iloc[[3]].assign(run_id="r777")]))
    yield Fault("fullwidth digits", texts("counts_left", lambda s: "".join(chr(ord(c) + 0xFEE0) for c in s), 7))
    yield Fault("decimal commas", texts("load_left_N", lambda s: s.replace(".", ","), 2))
    yield Fault(
        "wheels exchanged in the table", renamed({"counts_left": "counts_right", "counts_right": "counts_left"})
    )
    yield from mistakes_of_tables()
    yield from mistakes_of_poses_and_logs()


def of_session(column: str, change: Callable[[float], float], number: int = 1) -> Change:
    """Return a change of the cells of one session."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        if column not in table:
            return table
        session = list(dict.fromkeys(table["session"]))[number]
        new = [
            str(change(float(cell))) if label == session and cell != "" else cell
            for cell, label in zip(table[column], table["session"], strict=True)
        ]
        return table.assign(**{column: new})

    return changed


def moved(column: str, by: int = 1) -> Change:
    """Return a change that moves a column by so many rows."""
    return lambda table: table.assign(**{column: np.roll(table[column].to_numpy(), by)}) if column in table else table


def exchanged(first: str, second: str, rows: slice = slice(None)) -> Change:
    """Return an exchange of two columns in some rows."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        one, other = table[first].to_list(), table[second].to_list()
        one[rows], other[rows] = other[rows], one[rows]
        return table.assign(**{first: one, second: other})

    return changed


def turned(angle_rad: float) -> Change:
    """Return end poses turned about the origin."""

    def changed(table: pd.DataFrame) -> pd.DataFrame:
        x, y, theta = (pd.to_numeric(table[f"ref_{name}"]) for name in ("x_m", "y_m", "theta_rad"))
        cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
        new = {"ref_x_m": cosine * x - sine * y, "ref_y_m": sine * x + cosine * y, "ref_theta_rad": theta + angle_rad}
        return table.assign(**{name: values.map(str) for name, values in new.items()})

    return changed


def mistakes_of_tables() -> Iterator[Fault]:
    """Yield mistakes in single columns of the run table."""
    for name, change in {
        "distances 50 mm longer": cells("distance_m", lambda v: v + 0.05),
        "distances 1 % longer": cells("distance_m", lambda v: v * 1.01),
        "distances 2 % longer": cells("distance_m", lambda v: v * 1.02),
        "distances 1 % longer in one session": of_session("distance_m", lambda v: v * 1.01),
        "distances in decimetres": cells("distance_m", lambda v: round(v, 1)),
        "distances in whole metres": cells("distance_m", lambda v: float(round(v))),
        "distances of the next run": moved("distance_m", -1),
        "distances sorted": lambda t: t.assign(distance_m=sorted(t["distance_m"], key=lambda c: float(c or 0))),
        "distances there and back": cells("distance_m", lambda v: 2 * v),
        "counts exchanged in six runs": exchanged("counts_left", "counts_right", slice(6, 12)),
        "left counts 1 % more in one session": of_session("counts_left", lambda v: round(1.01 * v)),
        "left counts of another run": moved("counts_left"),
        "counts rounded to thousands": cells("counts_left", lambda v: 1000 * round(v / 1000)),
        "a digit of counts twice": cells("counts_left", lambda v: int(str(int(v)) + "0"), slice(5, 6)),
        "payloads in pounds in one session": of_session("payload_kg", lambda v: 2.2046 * v),
        "payloads of the next run": moved("payload_kg", -1),
        "payload on the other side": cells("payload_y_m", lambda v: -v),
        "payload behind": cells("payload_x_m", lambda v: -v),
        "payload in centimetres": cells("payload_x_m", lambda v: 100 * v),
        "loads exchanged": exchanged("load_left_N", "load_right_N"),
        "loads exchanged in six runs": exchanged("load_left_N", "load_right_N", slice(12, 18)),
        "loads of the next run": both(moved("load_left_N", -1), moved("load_right_N", -1)),
        "loads 10 % more": both(*(cells(f"load_{side}_N", lambda v: 1.1 * v) for side in ("left", "right"))),
        "loads with the tare": both(*(cells(f"load_{side}_N", lambda v: v + 150) for side in ("left", "right"))),
        "left load with the tare": cells("load_left_N", lambda v: v + 150),
        "a digit of a load lost": cells("load_left_N", lambda v: v / 10, slice(5, 6)),
        "sessions of the next run": moved("session", -1),
        "one session for all": lambda t: t.assign(session="s1"),
        "a session a run": lambda t: t.assign(session=[f"s{n}" for n in range(len(t))]),
        "directions exchanged": lambda t: t.assign(
            direction=t["direction"].map({"out": "back", "back": "out"}).fillna("")
        ),
        "all out": lambda t: t.assign(direction=["out" if d else "" for d in t["direction"]]),
        "temperatures in tenths": cells("temperature_C", lambda v: 10 * v),
        "temperature of one session in Fahrenheit": of_session("temperature_C", lambda v: 1.8 * v + 32),
        "minutes in seconds": cells("minutes_under_load", lambda v: 60 * v),
        "speeds in km/h in one session": of_session("speed_mps", lambda v: 3.6 * v),
        "rows reversed": lambda t: t.iloc[::-1],
    }.items():
        yield Fault(name, change)


def mistakes_of_poses_and_logs() -> Iterator[Fault]:
    """Yield mistakes in end poses, logs and settings."""
    for name, change in {
        "x and y exchanged": exchanged("ref_x_m", "ref_y_m"),
        "poses turned by 0.05 rad": turned(0.05),
        "poses turned by a right angle": turned(np.pi / 2),
        "x 1 % longer": cells("ref_x_m", lambda v: 1.01 * v),
        "headings of the other sign": cells("ref_theta_rad", lambda v: -v),
        "headings 0.02 rad more": cells("ref_theta_rad", lambda v: v + 0.02),
        "headings 0.02 rad more in one session": of_session("ref_theta_rad", lambda v: v + 0.02),
        "poses of the next run": both(*(moved(f"ref_{part}", -1) for part in ("x_m", "y_m", "theta_rad"))),
        "sensor 0.3 m ahead": lambda t: t.assign(
            ref_x_m=(pd.to_numeric(t["ref_x_m"]) + 0.3 * (np.cos(pd.to_numeric(t["ref_theta_rad"])) - 1)).map(str),
            ref_y_m=(pd.to_numeric(t["ref_y_m"]) + 0.3 * np.sin(pd.to_numeric(t["ref_theta_rad"]))).map(str),
        ),
        "logs of the next run": moved("log", -1),
        "two logs exchanged": lambda t: t.assign(log=[t["log"][{3: 4, 4: 3}.get(n, n)] for n in range(len(t))]),
    }.items():
        yield Fault(name, change)
    whole = ("counts_left", "counts_right")
    for name, change in {
        "logs cut by 2 %": lambda t: t.iloc[: int(0.98 * len(t))],
        "logs without every third row": lambda t: t[np.arange(len(t)) % 3 > 0],
        "logged counts doubled": lambda t: t.assign(**{c: (2 * t[c].astype(float)).map(str) for c in whole if c in t}),
        "logged wheels exchanged": lambda t: t.rename(columns=dict(zip(whole, whole[::-1], strict=True))),
    }.items():
        yield Fault(name, log=change)
    for old, new in (
        ("track_m = 0.7\n", "track_m = 0.71\n"),
        ("track_m = 0.7\n", "track_m = 0.75\n"),
        ("wheel_radius_m = 0.1\n", "wheel_radius_m = 0.101\n"),
        ("wheelbase_m = 1.0", "wheelbase_m = 1.5"),
        ("cog_x_m = 0.388", "cog_x_m = 0.6"),
        ("mass_kg = 100.0", "mass_kg = 150.0"),
        ("slope_left_m_per_N = ", "slope_left_m_per_N = 0.00001 # "),
        ("sigma_m = 0.001", "sigma_m = 0.03 # "),
        ("sigma_xy_m = 0.002", "sigma_xy_m = 0.05"),
        ("sigma_xy_m = 0.002", "sigma_xy_m = 0.0001"),
        ("sigma_theta_rad = 0.000", "sigma_theta_rad = 0.04 # "),
        ("[reference]\n", "[reference]\nsensor_x_m = 0.3\n"),
        ("[reference]\n", "[reference]\nsensor_yaw_rad = 0.03\n"),
        ("[reference]\n", '[reference]\nframe = "map"\n'),
        ("counts_per_rev = 4096", "counts_per_rev_left = 4096\ncounts_per_rev_right = 4000"),
        ("counts_per_rev = 4096", "counts_per_rev = 4096\nwrap_bits = 12"),
        ("[vehicle]\n", '[vehicle]\ndrive = "differential"\n'),
    ):
        yield Fault(new.replace("\n", " ").strip(), settings=(old, new))


def spoiled(fault: Fault, campaign: str, into: Path) -> Path:
    """Return the folder of a campaign with a fault."""
    folder = into / campaign
    shutil.copytree(SAMPLES / campaign, folder)
    runs = folder / "runs.csv"
    table = pd.read_csv(runs, dtype=str, keep_default_na=False)
    if fault.table is not None:
        fault.table(table).to_csv(runs, index=False)
    for number, path in enumerate(sorted((folder / "logs").glob("*.csv")) if fault.log is not None else ()):
        if fault.log is not None and (not fault.runs or number in fault.runs):
            fault.log(pd.read_csv(path, dtype=str)).to_csv(path, index=False)
    if fault.settings is not None:
        settings = folder / "campaign.toml"
        text = settings.read_text(encoding="utf-8")
        settings.write_text(text.replace(*fault.settings), encoding="utf-8")
    return folder


def ask(command: str, folder: Path) -> tuple[int, dict[str, Any], str]:
    """Return exit status, JSON and errors of a command."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([command, str(folder), "--json", "-"])
    try:
        document = json.loads(out.getvalue())
    except json.JSONDecodeError:
        document = {}
    return status, document, err.getvalue()


def said(command: str, document: dict[str, Any]) -> set[str]:
    """Return what a command says of its data, and what a diagnosis says to suspect in place of a cause."""
    if command == "check":
        return {note["text"] for level in ("wrong", "suspicious", "info") for note in document.get(level, ())}
    notes = {str(note) for note in document.get("notes", ())} | {str(one) for one in document.get("left_out", ())}
    checks = [check for wheel in document.get("wheels", {}).values() for check in wheel.get("checks", ())]
    remarks = {str(cause["remark"]) for cause in document.get("causes", ()) if cause["remark"]}
    return notes | remarks | {check["name"] for check in checks if not check["passed"]}


def answer(command: str, document: dict[str, Any]) -> list[tuple[float, float]]:
    """Return the numbers of an answer, each with its uncertainty; for a diagnosis what it names, as numbers."""
    if command == "fit":
        wheels = document.get("wheels", {}).values()
        names = {"radius_ref_m": "radius_ref_ci95_m", "slope_m_per_N": "slope_ci95_m_per_N"}
        return [(wheel[name], np.ptp(wheel[interval])) for wheel in wheels for name, interval in names.items()]
    if command == "diagnose":
        causes = sorted(document.get("causes", ()), key=lambda cause: str(cause["effect"]))
        label = float(sum(ord(letter) for letter in document.get("verdict", "") + "".join(c["effect"] for c in causes)))
        values = [(p["value"], np.ptp(p["ci95"])) for cause in causes for p in cause["parameters"].values()]
        return [(label, 0.0), *values]
    return []


@lru_cache
def answer_of_sound(campaign: str, command: str) -> tuple[int, dict[str, Any], str]:
    """Return what a command says of a campaign as it is."""
    with tempfile.TemporaryDirectory() as temporary:
        return ask(command, spoiled(Fault(""), campaign, Path(temporary)))


def outcome(fault: Fault, campaign: str, commands: Sequence[str] = COMMANDS) -> dict[str, str]:
    """Return what each command made of a fault: named, unchanged or silent."""
    results = {}
    with tempfile.TemporaryDirectory() as temporary:
        try:
            folder = spoiled(fault, campaign, Path(temporary) / "spoiled")
        except KeyError:
            return {}
        sound = fault.beside and spoiled(Fault("", fault.beside), campaign, Path(temporary) / "sound")
        for command in commands:
            status, document, _ = ask(command, folder)
            before_status, before, _ = ask(command, sound) if sound else answer_of_sound(campaign, command)
            if status != before_status or said(command, document) - said(command, before):
                results[command] = "named"
                continue
            pairs = list(zip(answer(command, document), answer(command, before), strict=False))
            same = all(abs(a - b) <= SAME_SHARE * width + 1e-12 for (a, _), (b, width) in pairs)
            results[command] = "unchanged" if same else "silent"
    return results


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--all", action="store_true", help="list every fault, not the silent ones alone")
    given = parser.parse_args()
    every = [(number, campaign) for campaign in CAMPAIGNS for number in range(len(list(faults())))]
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        outcomes = list(pool.map(_outcome_of, every))
    names = [fault.name for fault in faults()]
    totals: Counter[tuple[str, str]] = Counter()
    for (number, campaign), results in zip(every, outcomes, strict=True):
        totals.update(results.items())
        # check computes nothing: it is silent where a later command is
        if given.all or "silent" in results.values():
            listed = ", ".join(f"{command} {result}" for command, result in results.items())
            sys.stdout.write(f"{campaign:9} {names[number]:50} {listed or 'does not apply'}\n")
    tried = sum(bool(results) for results in outcomes)
    sys.stdout.write(f"{tried} inputs\n")
    for command in COMMANDS:
        counts = ", ".join(f"{result} {totals[command, result]}" for result in ("named", "unchanged", "silent"))
        sys.stdout.write(f"{command:9} {counts}\n")


def _outcome_of(which: tuple[int, str]) -> dict[str, str]:
    number, campaign = which
    return outcome(list(faults())[number], campaign)


if __name__ == "__main__":
    main()
