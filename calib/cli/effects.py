"""`calib effects`: the library of causes, what each needs and leaves, and effects that users add."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib.cli import terminal
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.gap.effects.library import Entry
    from calib.gap.predict import Path as DrivenPath


DEMONSTRATION = "demonstration runs (corridor both ways, squares, curves)"


def run(
    effect: Annotated[
        str | None, typer.Argument(metavar="ID", help="An effect, of which all is said; without it a list.")
    ] = None,
    campaign: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMPAIGN", help="Judge on this campaign's runs; its columns and declared effects are listed, too."
        ),
    ] = None,
    figures: terminal.Figures = None,
) -> None:
    """List the effects that may cause a gap, or say of one what it needs, what separates it, and what it leaves.

    Effects of installed packages (entry points of the group calib.effects) are listed with the package; those that
    campaign.toml declares, and further columns of the run table, with --campaign.

    Example: calib effects track_width --figures pictures
    """
    with terminal.waiting("looking"):
        nominal, entries, runs = _catalogued(effect, campaign)
    drawable = [_file_name(entry) for entry in entries if entry.signature is not None]
    terminal.refuse_outputs(*terminal.figure_files(figures, drawable))
    from calib.reporting.topics.effects import effect_content, effects_content

    terminal.show(effects_content(entries, runs) if effect is None else effect_content(entries[0], runs))
    if figures is not None:
        from calib.reporting.figures.effects import signature_figure

        shown = {_file_name(one): one.signature for one in entries if one.signature is not None}
        terminal.draw(lambda: {name: signature_figure(one, nominal) for name, one in shown.items()}, figures)
    terminal.then("effects EFFECT" if effect else "effects", c=campaign or "CAMPAIGN")
    terminal.emit_json({"runs": runs, "effects": [entry.to_dict() for entry in entries]})


def _catalogued(effect: str | None, campaign: Path | None) -> tuple[DrivenPath, list[Entry], str]:
    """Return the runs, the effects asked for, and the runs' name."""
    from calib.campaign.read import read_campaign
    from calib.gap.effects.library import catalogue, every_effect
    from calib.gap.observations.from_campaign import observations_of
    from calib.gap.plan.plan_file import demonstration
    from calib.gap.predict import predict

    read = demonstration() if campaign is None else read_campaign(campaign)
    declared = read.extra.get("effects", ())
    nominal = predict(observations_of(read))
    if effect is not None:
        known = every_effect(nominal.s, declared=declared)
        if effect not in known:
            near = terminal.nearest(effect, known)
            raise BadInputError(
                f"found the effect {effect!r}; expected one that 'calib effects' lists{near or '; choose one of it'}"
            )
    runs = DEMONSTRATION if campaign is None else f"the runs of {read.name}"
    return nominal, catalogue(nominal, declared, () if effect is None else (effect,)), runs


def _file_name(entry: Entry) -> str:
    return f"signature-{entry.effect.id}".replace(":", "-")
