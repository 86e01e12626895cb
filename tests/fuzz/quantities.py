"""Numbers that nobody means, in the place of one number of a command that is sound else.

What a number turns into (samples, points, draws, runs, digits) is made only where the rest of the input holds, so that
random damage to bytes seldom gets there.
"""

from __future__ import annotations

import csv
import io
import json
import os
import random
import re
import shutil
from pathlib import Path
from typing import Any

from calib.documents import checksum

NUMBERS = (
    "0", "-0.0", "-1", "1", "2", "1e-300", "1e-30", "1e-9", "1e-3", "-1e-6", "0.5", "7", "1e3", "1e6", "1e9", "1e12",
    "1e15", "1e29", "1e300", "-1e9", "-1e29", "nan", "inf", "4294967296", "9" * 30, "9223372036854775808",
)  # fmt: skip
#: sound commands; ``@NAME`` is a file that may be spoilt, ``%`` the folder of the sound ones, ``^`` a place to write
COMMANDS = (
    "plan --from @plan.toml",
    "plan --from @plan.toml",
    "simulate route @route.toml --real 0.1,0.099 --believed 0.1,0.1 --track 0.7 --real-track 0.71",
    "simulate route @route.toml --ratio 0.99,1.01 --wheel left --speed 0.5 --tum ^t",
    "simulate route @path.tum --real 0.1,0.099",
    "simulate journey square_cw --law @coefficients.json --load 400,500 --reference-load 300,300 --draws 200 --seed 3",
    "simulate journey @route.toml --law %/coefficients.json --payload 20,0.3,0.05 --track 0.7 --draws 200",
    "simulate journey figure8 --law %/coefficients.json --payload-at 2,20,0.3,0.05 --payload-at 5,0,0,0 --draws 100",
    "simulate study corrected --law @coefficients.json --load 400,500 --draws 100 --seed 1 --track 0.7",
    "simulate replay @C --law @coefficients.json",
    "loads --payload 20 --x 0.3 --y 0.05 --mass 100 --track 0.7 --wheelbase 1.0 --max-load 5000",
    "loads --vehicle @coefficients.json --sweep payload --from 0 --to 100 --steps 21 --x 0.3",
    "export @coefficients.json --to c --output ^h.h",
    "export @coefficients.json --to ros2 --load 400",
    "export @C --to csv",
    "check @C",
    "fit @C --into ^result",
    "deviation @C",
    "ingest %/C/runs.csv --into ^out --mapping @mapping.toml",
    "challenge make --seeds @seeds.toml --into ^out --cases 1 --workers 1",
    "fleet simulate --into ^f --vehicles 1 --runs 6 --months 2 --outliers 1 --drifting 1 --common 1 --seed 1",
)  # fmt: skip
#: what takes a second or more, and how often it is taken
SLOWER, OF_ALL = ("geometry @C", "diagnose @C", "plan @C --most 2"), 0.02
_NUMBER = re.compile(r"(?<![\w.+-])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")
_OPTION_NUMBER = re.compile(r"(?<=[ ,])[+-]?\d+(?:\.\d+)?(?=[ ,]|$)")


def quantity_case(base: Path, rng: random.Random) -> list[str]:
    """Return a sound command of which one or two numbers are spoilt, in its options or in a file that it reads."""
    work = base / "spoilt"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    command = rng.choice(SLOWER) if rng.random() < OF_ALL else rng.choice(COMMANDS)
    files = re.findall(r"@(\S+)", command)
    targets = [*files, *(["options"] if _OPTION_NUMBER.search(command) else [])]
    spoilt = set(rng.choices(targets, k=rng.choice((1, 1, 2))))
    for name in files:
        place = work / name
        if name == "C":
            shutil.copytree(base / "C", place, copy_function=os.link)
            if name in spoilt:
                _spoil_campaign(place, rng)
        else:
            text = (base / name).read_text(encoding="utf-8")
            place.write_text(_spoilt_text(name, text, rng) if name in spoilt else text, encoding="utf-8")
    if "options" in spoilt:
        command = _replaced(command, rng, _OPTION_NUMBER)
    words = command.replace("@", f"{work}/").replace("^", f"{work}/").replace("%", str(base))
    return words.split()


def _replaced(text: str, rng: random.Random, pattern: re.Pattern[str] = _NUMBER) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    chosen = rng.choice(found)
    return text[: chosen.start()] + rng.choice(NUMBERS) + text[chosen.end() :]


def _spoilt_text(name: str, text: str, rng: random.Random) -> str:
    if not name.endswith(".json"):
        return _replaced(text, rng)
    document = json.loads(text)
    document.pop("checksum", None)
    places = list(_places(document))
    inside, key = rng.choice(places)
    inside[key] = float(rng.choice([word for word in NUMBERS if word not in {"nan", "inf"}]))
    return json.dumps(document | {"checksum": checksum(document)})


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Return where the numbers of a document stand."""
    found: list[tuple[Any, Any]] = []
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(inner, dict | list):
            found += _places(inner)
        elif isinstance(inner, int | float) and not isinstance(inner, bool):
            found.append((value, key))
    return found


def _spoil_campaign(folder: Path, rng: random.Random) -> None:
    """Spoil a number of the settings, or a cell or a whole column of a table."""
    target = folder / rng.choice(("campaign.toml", "runs.csv", "runs.csv", "logs/r000.csv", "logs/r000.csv"))
    text = target.read_text(encoding="utf-8")
    target.unlink()
    if target.suffix == ".toml":
        target.write_text(_replaced(text, rng), encoding="utf-8")
        return
    rows = list(csv.reader(io.StringIO(text)))
    column = rng.randrange(len(rows[0]))
    factor = 10.0 ** rng.choice((-300, -15, -9, -3, 3, 6, 9, 12, 15, 25))
    for row in rows[1:] if rng.random() < 0.7 else [rng.choice(rows[1:])]:
        cell = row[column]
        row[column] = repr(float(cell) * factor) if _NUMBER.fullmatch(cell) else cell
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    target.write_text(out.getvalue(), encoding="utf-8")
