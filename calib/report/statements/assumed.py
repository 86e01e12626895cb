"""What nobody stated: values that a program filled in, and that results lean on."""

from __future__ import annotations

from collections.abc import Mapping

from calib.campaign.checks.assumed import WEIGHTY
from calib.report.blocks import Notice, Text


def assumed_text(assumed: Mapping[str, str]) -> Text:
    """Return the keys of ``campaign.toml`` that nobody stated, with the values that stand in."""
    if not assumed:
        return Text("Every setting that these results rest on is stated by the campaign; none is assumed.")
    return Text(
        f"Assumed, since nobody stated them: {_listed(assumed)}. What follows from these values is not measured."
    )


def assumed_notice(assumed: Mapping[str, str]) -> tuple[Notice, ...]:
    """Return a notice for the first page where every result scales with an assumed value, else nothing."""
    weighty = {key: value for key, value in assumed.items() if key in WEIGHTY}
    if not weighty:
        return ()
    text = f"{_listed(weighty)}. Every radius or path scales with these: state the vehicle's own in campaign.toml."
    return (Notice("note", "Assumed, since nobody stated it", text),)


def _listed(assumed: Mapping[str, str]) -> str:
    return ", ".join(f"{key} = {value}" if value else key for key, value in assumed.items())
