"""What the simulations share: their options, and writing and showing what came out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from calib.cli.terminal import emit_json, show, wants_stdout, wrote
from calib.errors import BadInputError

if TYPE_CHECKING:
    from calib.motion.studies.run import Simulation

SPEED_MPS: Final = 0.5
DRAWS: Final = 20_000

Routes = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[ROUTE]...",
        help="corridor, straight15, paper_route (the default), square_cw, square_ccw, figure8, or a .toml or .tum "
        "file.",
    ),
]
Law = Annotated[
    Path | None,
    typer.Option("--law", "--model", metavar="PATH", help="A campaign, a result of calib fit, or a coefficient file."),
]
Track = Annotated[
    float | None, typer.Option("--track", metavar="M", help="Track that the odometry believes (0.7, or the law's).")
]
Draws = Annotated[int, typer.Option("--draws", help="Draws of the Monte Carlo.")]
Output = Annotated[Path | None, typer.Option("--output", metavar="FOLDER", help="Write figures and tables there.")]
Tum = Annotated[Path | None, typer.Option("--tum", metavar="FOLDER", help="Write trajectories there, TUM format.")]
Speed = Annotated[float, typer.Option("--speed", metavar="M/S", help="Speed that times the trajectories.")]


@dataclass(frozen=True, slots=True)
class Targets:
    """Where a simulation goes: folders of figures and of trajectories, the speed that times these, and the JSON."""

    output: Path | None
    tum: Path | None
    speed_mps: float
    json: str | None
    force: bool

    def __post_init__(self) -> None:
        if not self.speed_mps > 0.0:
            raise BadInputError(f"--speed: found {self.speed_mps!r}; expected a speed above 0 m/s")


def finish(simulation: Simulation, targets: Targets, *, seed: int, notes: Sequence[str] = ()) -> None:
    """Write what was asked for, and show the simulation."""
    from calib.report.blocks import items
    from calib.report.motion_files import simulation_trajectories, write_simulation
    from calib.report.statements.simulation import simulation_content

    written: list[Path] = []
    if targets.output is not None:
        written += write_simulation(simulation, targets.output, force=targets.force)
    if targets.tum is not None:
        written += simulation_trajectories(simulation, targets.tum, speed_mps=targets.speed_mps, force=targets.force)
    every_note = [*notes, *(simulation.law.notes if simulation.law else ())]
    files = [str(path) for path in written]
    document = simulation.document() | {"seed": seed, "notes": every_note, "files": files}
    emit_json(document, targets.json, force=targets.force)
    if not wants_stdout(targets.json):
        show([*simulation_content(simulation), *items(every_note)])
        wrote(written)
