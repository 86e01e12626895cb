"""Damaged files of every format and nonsense for every option of every command, by number."""

from __future__ import annotations

import functools
import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import typer

from calib.cli import COMMANDS, function_of
from calib.cli.main import ALSO, OUTPUTS, Guarded
from tests.fuzz.answer import Outcome, outcome
from tests.fuzz.damage import WORDS, damaged, resealed
from tests.fuzz.quantities import quantity_case

Case = Callable[[Path, random.Random], list[str]]

#: sound file -> commands that read it; ``@`` stands for the damaged file, ``%`` for the folder of the sound ones
FILES: dict[str, tuple[str, ...]] = {
    "result/fit.json": ("export @ --to json", "export @ --to c", "export @ --to csv", "export @ --to ros2 --load 400"),
    "coefficients.json": (
        "export @ --to json", "export @ --to c", "export @ --to csv", "export @ --to ros2 --load 400",
        "fit %/C --model @", "loads --vehicle @ --payload 20", "simulate replay %/C --law @",
        "simulate journey square_cw --law @ --load 400,400 --draws 100",
    ),
    "mapping.toml": ("ingest %/C/runs.csv --into %/spoilt/out --mapping @", "check %/runs.xlsx --mapping @"),
    "route.toml": ("simulate route @ --real 0.1,0.099",),
    "plan.toml": ("plan --from @",),
    "seeds.toml": ("challenge make --seeds @ --into %/spoilt/out --cases 1 --workers 1",),
    "runs.xlsx": ("ingest @ --into %/spoilt/out", "ingest @ --describe"),
    "runs.parquet": ("ingest @ --into %/spoilt/out", "ingest @ --describe"),
    "path.tum": ("ingest @ --describe", "simulate route @ --real 0.1,0.099"),
    "log.mat": ("ingest @ --describe", "ingest %/C/runs.csv @ --into %/spoilt/out"),
    "log.tdms": ("ingest @ --describe", "check @"),
    "drive.bag": ("ingest @ --describe", "check @"),
    "drive.mcap": ("ingest @ --describe", "check @"),
    "drive.db3": ("ingest @ --describe",),
}  # fmt: skip
#: what reads a campaign quickly
OF_CAMPAIGNS = ("check @", "check @ --json -", "fit @", "fit @ --runs", "deviation @", "export @ --to csv",
                "simulate replay @", "check @ --strict")  # fmt: skip
#: what takes a second or so, and how often it is taken
SLOWLY, OF_ALL = ("geometry @", "diagnose @", "seeds.toml"), 0.01
#: commands of which one in so many inputs succeeds and takes long: they are given no sound path
NO_SOUND_PATH = {"report", "diagnose", "plan", "challenge own", "challenge run", "fleet run", "simulate study"}


def _words(command: str, file: Path, base: Path) -> list[str]:
    return [str(file) if word == "@" else word.replace("%", str(base)) for word in command.split()]


def campaign_case(base: Path, rng: random.Random) -> list[str]:
    """Return a command on a campaign with one damaged file."""
    work = base / "spoilt"
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(base / "C", work, copy_function=os.link)
    target = work / rng.choice(("campaign.toml", "campaign.toml", "runs.csv", "runs.csv", "logs/r000.csv"))
    data = target.read_bytes()
    target.unlink()
    target.write_bytes(damaged(data, rng))
    return _words(rng.choice(SLOWLY[:2] if rng.random() < OF_ALL else OF_CAMPAIGNS), work, base)


def file_case(base: Path, rng: random.Random) -> list[str]:
    """Return a command on a damaged file of any other format."""
    work = base / "spoilt"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    slow = rng.random() < OF_ALL
    source = rng.choice([name for name in FILES if (name in SLOWLY) == slow and (base / name).exists()])
    data = (base / source).read_bytes()
    if source.endswith(".json") and rng.random() < 0.7:
        data = resealed(data, rng) or damaged(data, rng)
    else:
        data = damaged(data, rng)
    target = work / Path(source).name
    target.write_bytes(data)
    return _words(rng.choice(FILES[source]), target, base)


@functools.cache
def options(command: str) -> tuple[tuple[str, bool, bool], ...]:
    """Return every option of a command: its name, whether it is a flag, whether it says where something is written."""
    application = typer.Typer(add_completion=False)
    application.command(command, cls=Guarded)(function_of(command))
    outputs = OUTPUTS | ALSO.get(command.rsplit(maxsplit=1)[-1], frozenset())
    return tuple(
        (parameter.opts[-1], bool(getattr(parameter, "is_flag", False)), parameter.name in outputs)
        for parameter in typer.main.get_command(application).params
        if parameter.opts[-1].startswith("--")
    )


def option_case(base: Path, rng: random.Random) -> list[str]:
    """Return any command with nonsense for some of its options."""
    command = rng.choice(list(COMMANDS))
    arguments = command.split()
    sound = [str(base / "C"), str(base / "result"), str(base / "coefficients.json")]
    odd = [rng.choice(WORDS), str(base / rng.choice(["absent", "mapping.toml", "\x1b[2J", "n" * 300]))]
    arguments.append(rng.choice(odd if command in NO_SOUND_PATH else sound + odd))
    for _ in range(rng.randint(1, 3)):
        name, is_flag, is_output = rng.choice(options(command))
        # what is written stays among the inputs
        places = ["-", str(base / "out" / ("n" * 300)), str(base / "C" / "runs.csv"), str(base / "C")]
        arguments += [name] if is_flag else [name, rng.choice(places if is_output else WORDS)]
    if command == "export" and "--to" not in arguments:
        arguments += ["--to", "json"]
    return arguments


CASES: tuple[Case, ...] = (campaign_case, campaign_case, file_case, file_case, option_case)


#: what the inputs are made for: all formats and options, or numbers that become counts, sizes and ranges
AIMS: dict[str, tuple[Case, ...]] = {"all": CASES, "quantities": (quantity_case,)}


def outcomes(base: Path, count: int, seed: int, first: int = 0, aim: str = "all") -> Iterator[tuple[int, Outcome, str]]:
    """Yield number, outcome and fault of `count` inputs; each number is one input, no matter what came before."""
    for number in range(first, first + count):
        rng = random.Random(seed * 1_000_003 + number)
        arguments = rng.choice(AIMS[aim])(base, rng)
        answered = outcome(arguments)
        # what an option made a command write over on purpose is corrected, too, so that each input begins alike
        harm = _harm(base, arguments) if str(base / "C") in " ".join(arguments) else ""
        yield number, answered, answered.fault or harm


def _harm(base: Path, arguments: list[str]) -> str:
    """Return what a command did to the sound campaign, and mend it for the next one."""
    kept, campaign = base / "kept", base / "C"
    changed = [
        path.name for path in kept.rglob("*") if path.is_file() and not _alike(path, campaign / path.relative_to(kept))
    ]
    if not changed:
        return ""
    shutil.rmtree(campaign, ignore_errors=True)
    shutil.copytree(kept, campaign)
    return f"an input was changed: {changed}" if str(campaign) in arguments[:3] else ""


def _alike(path: Path, other: Path) -> bool:
    return other.is_file() and path.stat().st_size == other.stat().st_size
