"""Some 150 faults of a campaign that change its answer: columns, cells, labels, poses, logs and settings."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd

from tests.blunders.changes import (
    Fault,
    both,
    cells,
    exchanged,
    moved,
    of_session,
    renamed,
    shifted,
    summary,
    texts,
    turned,
    weighed,
)


def faults() -> Iterator[Fault]:
    """Yield all faults."""
    in_newtons = weighed("_N", 1.0)
    for unit, factor in {
        "_kg": 1 / 9.81,
        "_g": 1e3 / 9.81,
        "_t": 1e-3 / 9.81,
        "_lb": 1 / 4.448,
        "_lbf": 1 / 4.448,
    }.items():
        yield Fault(f"loads weighed{unit}", weighed(unit, factor), beside=in_newtons)
    for unit, factor in {"_kN": 1e-3, "_daN": 0.1, "_kgf": 1 / 9.80665, " [N]": 1.0, " (kg)": 1 / 9.81}.items():
        yield Fault(f"loads weighed{unit}", weighed(unit, factor), beside=in_newtons)
    for left, right in (("load_left", "load_right"), ("load_l_N", "load_r_N"), ("left_load_N", "right_load_N")):
        yield Fault(f"loads in {left}", both(in_newtons, renamed({"load_left_N": left, "load_right_N": right})))
    yield Fault(
        "loads in weighed_load_left_N",
        both(in_newtons, renamed({f"load_{s}_N": f"weighed_load_{s}_N" for s in ("left", "right")})),
    )
    yield Fault(
        "loads in LoadLeft", both(in_newtons, renamed({"load_left_N": "LoadLeft", "load_right_N": "LoadRight"}))
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
        ("reference_load_N = 300.0", "reference_load_N = 450.0"),
        ("reference_load_N = 300.0", "reference_load_N = 30.6"),
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
