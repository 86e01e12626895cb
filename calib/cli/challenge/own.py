"""`calib challenge own`: known effects planted on a lab's own data, and what of them is found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli.challenge.options import Workers
from calib.cli.options import Force, JsonTarget
from calib.cli.terminal import emit_json, note, progress, show
from calib.cli.threads import one_blas_thread

if TYPE_CHECKING:
    from calib.challenge.own.result import Own
    from calib.report.blocks import Block

EPILOG = "Example: calib challenge own sample_runs/yard --effects track_width,temperature_radius --planted 3"


def run(
    folder: Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="Folder with campaign.toml, runs.csv, logs.")],
    effects: Annotated[
        str | None, typer.Option(metavar="A,B", help="Effects to plant; all that the runs can show by default.")
    ] = None,
    sizes: Annotated[
        str, typer.Option(metavar="LIST", help="10s: a signal of 10; 2x: twice the typical size; 0.01: in its unit.")
    ] = "5s,10s,25s",
    planted: Annotated[int, typer.Option(metavar="N", min=1, help="How often each.")] = 5,
    workers: Workers = 2,
    seconds: Annotated[float, typer.Option(metavar="S", min=1.0, help="Begin no diagnosis after so long.")] = 900.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of everything that is drawn.")] = 0,
    json: JsonTarget = None,
    force: Force = False,
) -> int:
    """Plant known effects on this campaign's own noise and route, and say what its data would find.

    Exit status 1 where false alarms, or wrong names, are surely more than one in twenty.
    """
    one_blas_thread()
    from calib.campaign.read import read_campaign
    from calib.challenge.own.plants import parse_sizes
    from calib.challenge.own.run import Asked, challenge_own

    names = tuple(name.strip() for name in (effects or "").split(",") if name.strip())
    asked = Asked(names, parse_sizes(sizes), planted, workers, seconds, seed)
    campaign = read_campaign(folder)
    with progress("planting") as tick:
        own = challenge_own(campaign, asked, tick=lambda done, total: tick(done, total, "diagnoses"))
    if own.done < own.asked:
        note(f"the time of {seconds:g} s was enough for {own.done} of {own.asked} diagnoses; more with --seconds")
    show(own_content(own), target=json)
    emit_json(own.to_dict(), json, force=force)
    return 0 if own.trusted else 1


def own_content(own: Own) -> list[Block]:
    """Return what was found, as blocks."""
    from calib.challenge.intervals import clopper_pearson
    from calib.report.blocks import Column, Items, Table
    from calib.report.numbers import left

    head = (left("Planted", wide=True), Column("Size"), left("Unit"), Column("Signal"), Column("Times"), Column("Seen"))
    effects, outside = (
        tuple(
            (f.effect, f"{f.size:.3g}", f.unit, f"{f.signal:.1f}", str(f.planted), str(f.seen), *rest(f), str(f.wrong))
            for f in own.found
            if f.outside == which
        )
        for which, rest in (
            (False, lambda f: (str(f.first), str(f.in_group))),
            (True, lambda f: (str(f.left_open),)),
        )
    )
    columns = (*head, Column("First"), Column("In group"), Column("Wrong"))
    low, high = (f"{bound:.0%}" for bound in clopper_pearson(own.raised, len(own.empty)))
    sentences = [
        f"False alarms where nothing was planted: {own.raised} of {len(own.empty)} (95 %: {low} to {high}).",
        f"Something else named: {own.wrong} of {own.planted} planted.",
        f"The noise is what the diagnosis leaves of {own.units} units, {own.units_with_repeats} of them with repeats; "
        f"the campaign's own verdict was {own.own_verdict}.",
    ]
    if own.done < own.asked:
        sentences.append(f"Diagnosed {own.done} of {own.asked}: the time was up.")
    blocks: list[Block] = [Table(f"Planted on {own.campaign}'s own noise and route.", columns, effects)]
    if outside:
        open_columns = (*head, Column("Left open"), Column("Fix recommended"))
        blocks.append(Table("Causes that no library holds.", open_columns, outside))
    return [*blocks, Items((*sentences, *(f"Not planted: {name}: {why}." for name, why in own.left_out.items())))]
