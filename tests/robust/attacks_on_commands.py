"""Attacks on commands: their options, fleets, simulators of the user's, variables and limits of the environment."""

from __future__ import annotations

import os
import resource
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz.inputs import options
from tests.robust.attack import Attack, Spoil, write
from tests.robust.ending import SOUND, worded

VALUES = ("nan", "inf", "-inf", "-1", "0", "1e308", "１０", "", "ten", "9" * 400, "1,2,3,4,5", ",,", "--", "1e-320")
PATHS = ("", ".", "..", "/proc", "out", "C", "C/runs.csv", "/dev/null", "/dev/full", "/proc/self/mem", "out/a/../b",
         "no/where", "out/" + "n" * 300, "out/new\nline", "out/ü Ω/文", "out/ ", "loop", "C/runs.csv/x", "-", "~",
         "out/\udcff")  # fmt: skip
#: options that say what is read
READ = {"--law", "--model", "--mapping", "--from", "--candidates", "--seeds", "--journeys", "--simulator", "--campaign",
        "--vehicle", "--truth"}  # fmt: skip
#: what takes long however it ends is given fewer values
SLOW = {"challenge own", "challenge make", "diagnose", "report", "fleet run", "simulate study", "plan", "geometry"}
#: one figure in place of forty
DRAWN_ALONE = {"effects": ["track_width"]}


def choices() -> Iterator[Attack]:
    """Yield values of every kind for every option of every command."""

    def loop() -> None:
        Path("loop").symlink_to("loop")

    for number, command in enumerate(SOUND):
        for turn, (option, is_flag, is_output) in enumerate(sorted(options(command))):
            if is_flag:
                continue
            pool = PATHS if is_output or option in READ else VALUES
            step = 5 if command in SLOW else 2
            for at in range((number + turn) % step, len(pool), step):
                words = worded(command) + DRAWN_ALONE.get(command, [])
                if option in words:
                    place = words.index(option)
                    words[place : place + 2] = []
                value = pool[at]
                yield Attack(f"{command} {option} {value[:20]!r}", (*words, option, value), loop)


def fleets() -> Iterator[Attack]:
    """Yield folders of vehicles that hold something else, and result folders that are none."""
    both = ("fleet run fleet --into out/f", "fleet run fleet --into out/f --what check")
    spoilt: dict[str, Spoil] = {
        "no vehicle": lambda: shutil.rmtree("fleet/v1"),
        "a file": lambda: Path("fleet/v2").touch(),
        "a loop of links": lambda: Path("fleet/v2").symlink_to("v2"),
        "a link outside": lambda: Path("fleet/v2").symlink_to(Path("C").resolve()),
        "an id with a line end": lambda: _moved("fleet/v1", "fleet/v\n1"),
        "an id of no UTF-8": lambda: _moved("fleet/v1", "fleet/v\udcff"),
        "an id that is a formula": lambda: _moved("fleet/v1", "fleet/=1+1"),
        "labels empty": write("fleet/vehicles.csv", b""),
        "labels without vehicle": write("fleet/vehicles.csv", b"hall\nA\n"),
        "labels twice": write("fleet/vehicles.csv", b"vehicle,hall\nv1,A\nv1,B\n"),
        "labels of bytes": write("fleet/vehicles.csv", b"vehicle,hall\nv1,\xff\xfe\n"),
        "labels as a folder": lambda: Path("fleet/vehicles.csv").mkdir(),
        "labels as a FIFO": lambda: os.mkfifo("fleet/vehicles.csv"),
        "sums as a folder": lambda: Path("out/f/sums.jsonl").mkdir(parents=True),
        "sums as a FIFO": lambda: (Path("out/f").mkdir(), os.mkfifo("out/f/sums.jsonl"))[1],
        "sums of bytes": write("out/f/sums.jsonl", b'\xff\xfe{}\n[1]\nnull\n{"name": 1}\n'),
        "sums of depth": write("out/f/sums.jsonl", b"[" * 100_000),
        "checks of bytes": write("out/f/check.jsonl", b'\xff\n{"seal": 3}\n'),
        "results as a file": write("out/f", b""),
        "a dataset of no file": write("fleet/campaign.toml", b"format = 'calib-campaign/1'\n"),
        "settings as a folder": lambda: (
            Path("fleet/v1/campaign.toml").unlink(),
            Path("fleet/v1/campaign.toml").mkdir(),
        )[1],
    }
    for name, spoil in spoilt.items():
        for command in both:
            yield Attack(f"fleet: {name}", tuple(command.split()), spoil)
    for into in ("fleet", "fleet/v1", "fleet/v1/logs", "", "/dev/null", "/proc/1", "C/runs.csv"):
        yield Attack(f"fleet run --into {into!r}", ("fleet", "run", "fleet", "--into", into))
    for scheduler in ("tcp://127.0.0.1:1", "tcp://x:99999", "http://x:1", "tcp://[::1]:1", "\n", "tcp://127.0.0.1:0"):
        words = ("fleet", "run", "fleet", "--into", "out/f", "--scheduler", scheduler)
        yield Attack(f"scheduler {scheduler!r}", words)


def _moved(source: str, target: str) -> None:
    shutil.move(source, target)


SIMULATORS = {
    "none": '["no-such-program", "{campaign}", "{parameters}", "{out}"]',
    "one that fails": '["false", "{campaign}", "{parameters}", "{out}"]',
    "one that writes nothing": '["true", "{campaign}", "{parameters}", "{out}"]',
    "an empty command": "[]",
    "a folder": '["/", "{campaign}", "{parameters}", "{out}"]',
    "one that writes no table": '["sh", "-c", "head -c 3000 /dev/urandom > $2", "{campaign}", "{parameters}", "{out}"]',
    "one that never ends": '["sh", "-c", "sleep 600", "{campaign}", "{parameters}", "{out}"]',
    "one that floods": '["sh", "-c", "yes | head -c 50000000; exit 3", "{campaign}", "{parameters}", "{out}"]',
    "one with NaN": '["sh", "-c", "printf \'run_id,sim_distance_m\\\\nr000,nan\\\\n\' > $2", '
    '"{campaign}", "{parameters}", "{out}"]',
    "one that removes its parameters": '["sh", "-c", "rm $1", "{campaign}", "{parameters}", "{out}"]',
    "one that is no text": '["sh", "-c", "printf \'\\\\377\\\\376\' >&2; exit 1", '
    '"{campaign}", "{parameters}", "{out}"]',
    "braces": '["sh", "-c", "echo {nothing} {0} {} > $2", "{campaign}", "{parameters}", "{out}"]',
}


def simulators() -> Iterator[Attack]:
    """Yield simulators of the user's that fail in every way."""
    for name, command in SIMULATORS.items():
        text = (
            f'command = {command}\ntimeout_s = 2\n[[parameter]]\nname = "r"\nnominal = 0.1\nstep = 0.001\n'
            'largest = 0.01\nunit = "m"\n'
        )
        words = ("diagnose", "C", "--simulator", "sim.toml", "--json", "out/j.json")
        yield Attack(f"simulator: {name}", words, write("sim.toml", text))


def surroundings() -> Iterator[Attack]:
    """Yield variables of the environment and limits of the process, on a quick and on a drawing command."""
    variables = {
        "SOURCE_DATE_EPOCH": ("", "x", "-1", "1e9", "9" * 30, "253402300800"),
        "COLUMNS": ("0", "-5", "1", "x", "9" * 30),
        "HOME": ("", "/nowhere", "/dev/null"),
        "TMPDIR": ("/nowhere", "/dev/null"),
        "TZ": ("x/y/z", ":", "\udcff"),
        "LC_ALL": ("C", "xx_YY"),
        "PYTHONWARNINGS": ("error",),
        "OMP_NUM_THREADS": ("x", "-1", "100000"),
        "MPLCONFIGDIR": ("/dev/null", "/proc/1"),
        "MPLBACKEND": ("nonsense",),
        "TERM": ("dumb", ""),
        "FORCE_COLOR": ("1",),
        "XDG_CACHE_HOME": ("/dev/null", "\n"),
    }
    commands = ("check C", "fit C --figures out/figures", "report result --into out/r.pdf")
    for number, (name, values) in enumerate(variables.items()):
        for turn, value in enumerate(values):

            def hinder(name: str = name, value: str = value) -> None:
                os.environ[name] = value

            command = commands[(number + turn) % len(commands)]
            yield Attack(f"{name}={value[:12]!r}: {command}", tuple(command.split()), hinder=hinder)
    for kind, most in (("NOFILE", 12), ("NOFILE", 30), ("FSIZE", 100), ("STACK", 200_000), ("NPROC", 1)):

        def limit(kind: str = kind, most: int = most) -> None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(getattr(resource, f"RLIMIT_{kind}"), (most, most))

        for command in ("check C", "fit C --json out/j.json", "ingest runs.xlsx --into out/new"):
            yield Attack(f"limit {kind} {most}: {command}", tuple(command.split()), hinder=limit)
    for command in SOUND:
        yield Attack(f"closed output: {command}", tuple(worded(command)), closed=True)
