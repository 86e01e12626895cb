# ruff: noqa: T201  (a script shows what it does)
"""Write the atlas of effects, a page and a picture for each, on the routes of the yard: ``python docs/atlas.py``.

The yard's runs are laid out anew without noise, with everything measured (front wheel, laser, end poses, some of them
while the vehicle rolls), so that every effect has something to show itself in. ``--check`` writes nothing and ends with
status 1 where a page is out of date.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.gap.effects import Effect
from calib.gap.effects.library import REGISTRY, EffectSignature, signature_of
from calib.gap.observations.from_campaign import observations_of
from calib.gap.plan.planned_runs import Dimensions, Measured, PlannedRun, drive
from calib.gap.predict import Path as DrivenPath
from calib.gap.predict import predict
from calib.reporting.figures import render
from calib.reporting.figures.gap import signature_figure

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "effects"
CORRIDOR_M = 20.0


def yard() -> Campaign:
    """Return the yard's runs without noise and with all that can be measured."""
    campaign = read_campaign(ROOT / "sample_runs" / "yard", logs=False)
    runs = campaign.runs
    number = {name: runs.number(name) for name in ("payload_kg", "payload_x_m", "payload_y_m", "speed_mps")}
    warm = runs.number("temperature_C")
    planned = [
        PlannedRun(
            kind=str(runs.label("kind")[k]),
            direction=str(runs.label("direction")[k]),
            session=str(runs.label("session")[k]),
            payload_kg=float(np.nan_to_num(number["payload_kg"][k])),
            payload_x_m=float(np.nan_to_num(number["payload_x_m"][k])),
            payload_y_m=float(np.nan_to_num(number["payload_y_m"][k])),
            speed_mps=float(number["speed_mps"][k]),
            temperature_C=float(warm[k]),
            minutes_under_load=float(np.nan_to_num(runs.number("minutes_under_load")[k])),
            read_rolling=k % 5 == 0,
            stops=k % 3,
        )
        for k in range(len(runs))
    ]
    return drive(replace(campaign, extra={}), planned, Measured(front=True), Dimensions(CORRIDOR_M))


def page_of(effect: Effect, signature: EffectSignature | None) -> str:
    """Return the page of an effect."""
    told = (type(effect).__doc__ or "").strip().split("\n\n")[0].replace("\n    ", "\n")
    lines = [f"# {effect.id}", "", f"{effect.title[0].upper()}{effect.title[1:]}. {told}", ""]
    lines += ["| | |", "|---|---|", f"| family | {effect.family}: {effect.family.words} |"]
    lines += [f"| shows where there are | {effect.needs} |"] if effect.needs else []
    lines += [f"| told from its like by | {effect.separates} |"] if effect.separates else []
    lines += [f"| beyond a plausible size, suspect | {effect.implausible} |", ""]
    if signature is None:
        why = "is found before the search, by trial" if effect.found_before_search else "shows on other runs only"
        return "\n".join([*lines, f"It has no form on the runs of the yard: it {why}.", ""])
    lines += ["| parameter | unit | typical | largest plausible |", "|---|---|---|---|"]
    lines += [f"| {p.name} | {p.unit} | {p.typical:.3g} | {p.largest:.3g} |" for p in signature.form.parameters]
    form = f" (form: {signature.form.label})" if signature.form.label else ""
    caption = (
        f"Signature on the routes of the yard{form}. Left: one run of each kind as the model has it, in grey, and with "
        "the effect enlarged, in colour. Right: what it changes in each channel at its typical size, a dot a run."
    )
    return "\n".join([*lines, "", f"![{caption}]({effect.id}.png)", "", f"*{caption}*", ""])


def index_of(effects: list[Effect]) -> str:
    """Return the page that lists the effects by family."""
    lines = [
        "# Atlas of effects",
        "",
        "What may open a gap between simulated and measured motion, by family. Sizes are orders of magnitude from the",
        "field's literature and from arithmetic; any further numeric column of `runs.csv` is a candidate of its own.",
        "",
        "| effect | what it is | family | told from its like by |",
        "|---|---|---|---|",
    ]
    lines += [f"| [{e.id}]({e.id}.md) | {e.title} | {e.family} | {e.separates} |" for e in effects]
    return "\n".join([*lines, ""])


def pages(effects: list[Effect], nominal: DrivenPath) -> dict[Path, bytes]:
    """Return the pages of the atlas."""
    files = {FOLDER / "index.md": index_of(effects).encode()}
    for effect in effects:
        files[FOLDER / f"{effect.id}.md"] = page_of(effect, signature_of(effect, nominal)).encode()
    return files


def pictures(effects: list[Effect], nominal: DrivenPath) -> dict[Path, bytes]:
    """Return the pictures of the atlas."""
    signatures = [signature_of(effect, nominal) for effect in effects]
    return {
        FOLDER / f"{effect.id}.png": render(signature_figure(signature, nominal), "png")
        for effect, signature in zip(effects, signatures, strict=True)
        if signature is not None
    }


def main() -> int:
    """Write the atlas, or say what is out of date."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 where a page would change")
    given = parser.parse_args()
    nominal = predict(observations_of(yard()))
    effects = [kind() for kind in REGISTRY.values()]
    files = pages(effects, nominal)
    if given.check:
        # pictures hang on the last digits of a machine's arithmetic: the words are what is checked
        stale = [path for path, data in files.items() if not _same(path, data)]
        print(f"out of date: {', '.join(path.name for path in stale)}" if stale else "the atlas is up to date")
        return int(bool(stale))
    FOLDER.mkdir(parents=True, exist_ok=True)
    files |= pictures(effects, nominal)
    for path, data in files.items():
        path.write_bytes(data)
    print(f"wrote {len(files)} files to docs/effects")
    return 0


def _same(path: Path, data: bytes) -> bool:
    return path.is_file() and path.read_bytes() == data


if __name__ == "__main__":
    sys.exit(main())
