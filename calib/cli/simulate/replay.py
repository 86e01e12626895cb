"""`calib simulate replay`: a campaign's logged runs, driven again by the vehicle's own code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib.cli.options import Force, JsonTarget, Seed
from calib.cli.simulate.common import Law, Output, Tum
from calib.cli.terminal import emit_json, show, waiting, wants_stdout, wrote
from calib.files import refuse_existing

EPILOG = "Example: calib simulate replay sample_runs/corridor_crossed --law coefficients.json --output replay"


def run(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN", help="Campaign with logs and end poses.")],
    law: Law = None,
    scheme: Annotated[str, typer.Option(help="exact, mid_point, euler or end_point.")] = "exact",
    seed: Seed = 0,
    output: Output = None,
    tum: Tum = None,
    json: JsonTarget = None,
    force: Force = False,
) -> None:
    """Replay the logged runs of a campaign: end errors with constant radii and with radii that follow the load.

    The vehicle's own code runs on the same logs, and has to agree.
    """
    import numpy as np

    from calib.campaign.read import read_campaign
    from calib.coefficients.source import coefficients_of, effects_left_out
    from calib.motion.studies.replay import replay
    from calib.report.blocks import items
    from calib.report.motion_files import replay_trajectories, write_replay
    from calib.report.statements.replay import replay_content

    refuse_existing((output / "replay.json", output / "replay.csv") if output else (), force=force)
    with waiting("replaying"):
        read = read_campaign(campaign)
        source = coefficients_of(law if law is not None else campaign)
        replayed = replay(read, source.file, rng=np.random.default_rng(seed), scheme=scheme)
    notes = [*source.notes, *effects_left_out(source.file, "not simulated"), *replayed.notes]
    if law is None:
        notes.append(
            "the law was fitted to this same campaign: give --law for a judgement on runs that it has not seen"
        )
    document = {
        "campaign": read.name,
        "simulated": read.simulated,
        "scheme": scheme,
        **replayed.document(),
        "notes": notes,
    }
    written = [] if output is None else write_replay(replayed, output, document, force=force)
    if tum is not None:
        written += replay_trajectories(read, source.file, tum, force=force)
    emit_json(document | {"files": [str(path) for path in written]}, json, force=force)
    if not wants_stdout(json):
        show([*replay_content(replayed), *items(notes)])
        wrote(written)
