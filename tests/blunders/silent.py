"""Data that changes the answer: ``python -m tests.blunders.silent`` tries each fault on two campaigns.

Of each campaign (a corridor, and one of several routes) and each fault the answer of ``check``, ``fit`` and
``diagnose`` is held against that of the campaign as it is: *named* where the command says something new, refuses or
ends with another exit status; *unchanged* where it says nothing new and its answer is the same within a tenth of its
interval; *silent* where it says nothing and answers something else. A diagnosis begins with the notes that a fit
has, so that it is computed only where those say nothing new, or with ``--whole``.
"""

from __future__ import annotations

import argparse
import fnmatch
import io
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from calib.cli.main import run
from tests.blunders.changes import Change, Fault
from tests.blunders.faults import faults

SAMPLES: Final = Path(__file__).resolve().parents[2] / "sample_runs"
CAMPAIGNS: Final = ("corridor", "yard")
COMMANDS: Final = ("check", "fit", "diagnose")
OUTCOMES: Final = ("named", "named as by fit", "unchanged", "silent")
#: where the findings are that fit and diagnosis share: a note begins with the file
PLACES: Final = ("runs", "logs", "campaign.toml")
#: how many runs a method was applied to names no fault
METHODS: Final = ("Turn of", "Path of")
#: a change of less than this share of the interval is no other answer
SAME_SHARE: Final = 0.1


@dataclass(frozen=True, slots=True)
class Reply:
    """What a command answered: exit status, JSON (empty where it refused), standard error."""

    status: int
    document: dict[str, Any]
    error: str


def spoiled(fault: Fault, campaign: str, into: Path) -> Path:
    """Return the folder of a campaign with a fault; a KeyError where the fault needs a column that is not there."""
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


def ask(command: str, folder: Path) -> Reply:
    """Return the answer of a command, in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([command, str(folder), "--json", "-"])
    try:
        document = json.loads(out.getvalue())
    except json.JSONDecodeError:
        document = {}
    return Reply(status, document, err.getvalue())


def said(command: str, document: dict[str, Any]) -> set[str]:
    """Return what a command says of its data, and what a diagnosis says to suspect in place of a cause."""
    if command == "check":
        return {note["text"] for level in ("wrong", "suspicious", "info") for note in document.get(level, ())}
    left_out = {str(one) for one in document.get("left_out", ())}
    checks = [check for wheel in document.get("wheels", {}).values() for check in wheel.get("checks", ())]
    remarks = {str(cause["remark"]) for cause in document.get("causes", ()) if cause["remark"]}
    notes = {str(note) for note in document.get("notes", ()) if not str(note).startswith(METHODS)}
    return notes | left_out | remarks | {check["name"] for check in checks if not check["passed"]}


def findings(document: dict[str, Any]) -> set[str]:
    """Return the notes on the data, with which a fit and a diagnosis begin."""
    return {str(note) for note in document.get("notes", ()) if str(note).startswith(PLACES)}


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
def reply_of_sound(campaign: str, command: str, beside: Change | None) -> Reply:
    """Return what a command says of a campaign as it is, or with another spelling of what the fault spells."""
    with tempfile.TemporaryDirectory() as temporary:
        return ask(command, spoiled(Fault("", beside), campaign, Path(temporary)))


def outcome(fault: Fault, campaign: str, commands: Sequence[str] = COMMANDS, *, whole: bool = True) -> dict[str, str]:
    """Return what each command made of a fault: named, unchanged or silent; nothing where it does not apply.

    `whole`: compute the diagnosis even where its notes are those of the fit, which name the fault.
    """
    results: dict[str, str] = {}
    noted_by_fit = False
    with tempfile.TemporaryDirectory() as temporary:
        try:
            folder = spoiled(fault, campaign, Path(temporary))
        except KeyError:
            return {}
        for command in commands:
            if command == "diagnose" and noted_by_fit and not whole:
                results[command] = "named as by fit"
                continue
            reply = ask(command, folder)
            before = reply_of_sound(campaign, command, fault.beside)
            if command == "fit":
                noted_by_fit = bool(findings(reply.document) - findings(before.document))
            if reply.status != before.status or said(command, reply.document) - said(command, before.document):
                results[command] = "named"
                continue
            pairs = list(zip(answer(command, reply.document), answer(command, before.document), strict=False))
            same = all(abs(a - b) <= SAME_SHARE * width + 1e-12 for (a, _), (b, width) in pairs)
            results[command] = "unchanged" if same else "silent"
    return results


def inputs(shard: str = "1/1", only: str = "*") -> list[tuple[str, Fault]]:
    """Return the i-th of n parts (``i/n``) of all campaigns and faults whose ``campaign: fault`` matches a glob."""
    part, parts = (int(number) for number in shard.split("/"))
    if not 1 <= part <= parts:
        raise ValueError(f"--shard {shard}: expected i/n with i from 1 to n")
    listed = list(faults())
    chosen = [(c, fault) for c in CAMPAIGNS for fault in listed if fnmatch.fnmatchcase(f"{c}: {fault.name}", only)]
    return chosen[part - 1 :: parts]


def main() -> None:
    """Print what each command made of the inputs, and how many were named, unchanged and silent."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--all", action="store_true", help="list every fault, not the silent ones alone")
    parser.add_argument("--whole", action="store_true", help="diagnose where the fit's notes name the fault, too")
    parser.add_argument("--shard", default="1/1", metavar="I/N", help="only the I-th of N parts")
    parser.add_argument("--only", default="*", metavar="GLOB", help="only inputs 'campaign: fault' that match")
    given = parser.parse_args()
    totals: Counter[tuple[str, str]] = Counter()
    tried, started = 0, time.process_time()
    for campaign, fault in inputs(given.shard, given.only):
        results = outcome(fault, campaign, whole=given.whole)
        totals.update(results.items())
        tried += bool(results)
        if given.all or "silent" in results.values():
            listed = ", ".join(f"{command} {result}" for command, result in results.items())
            sys.stdout.write(f"{campaign:9} {fault.name:50} {listed or 'does not apply'}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{tried} inputs, {time.process_time() - started:.0f} s of processor time\n")
    for command in COMMANDS:
        counts = ", ".join(f"{result} {totals[command, result]}" for result in OUTCOMES if totals[command, result])
        sys.stdout.write(f"{command:9} {counts}\n")


if __name__ == "__main__":
    main()
