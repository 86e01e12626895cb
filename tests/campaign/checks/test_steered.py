"""Vehicles that count one wheel and steer: units and senses are told by the turns of their steering.

By the plants of `tests.blunders`, which share no code with calib. What all runs have is wrong; what one run has is
suspicious.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.check import check_campaign
from calib.campaign.read import read_campaign
from tests.blunders import plant
from tests.blunders.plant import Array, Recording, Run, write

POSE = ("ref_x_m", "ref_y_m", "ref_theta_rad")
Change = Callable[[Run], None]


def of_reference(*factors: float) -> Change:
    def change(run: Run) -> None:
        run.end = run.end * factors
        run.log |= {name: factor * run.log[name] for name, factor in zip(POSE, factors, strict=True)}

    return change


def of_column(name: str, change: Callable[[Array], Array]) -> Change:
    def changed(run: Run) -> None:
        run.log |= {column: change(values) for column, values in run.log.items() if column.startswith(name)}

    return changed


#: change of a run -> words of the note
FAULTS: dict[str, tuple[Change, str]] = {
    "headings in degrees": (of_reference(1.0, 1.0, 180.0 / np.pi), "are they in degrees?"),
    "a mirrored reference": (of_reference(1.0, -1.0, -1.0), "positive to the right?"),
    "positions in mm": (of_reference(1e3, 1e3, 1.0), "as far away as was driven"),
    "steering in degrees": (of_column("steer_rad", np.degrees), "name the column steer_deg"),
    "steering to the right": (of_column("steer_rad", np.negative), "is steer_rad"),
    "falling counts": (of_column("counts", np.negative), "do counts fall driving ahead"),
    "counts with quadrature": (of_column("counts", lambda counts: 4.0 * counts), "check wheelbase_m, counts_per_rev"),
}


def checked(recording: Recording, folder: Path, along: bool) -> tuple[str, set[str]]:
    """Return what `check` says is wrong, and the runs that look suspicious."""
    report = check_campaign(read_campaign(write(recording, folder, along=along)))
    return " ".join(note.sentence for note in report.wrong), {note.run_id for note in report.suspicious} - {""}


@pytest.mark.parametrize(("drive", "along"), [("tricycle", False), ("ackermann", True)])
def test_units_and_senses(drive: str, along: bool, tmp_path: Path) -> None:
    sound = getattr(plant, drive)(np.random.default_rng(0), repeats=2)
    assert checked(sound, tmp_path / "sound", along) == ("", set())
    for name, (change, words) in FAULTS.items():
        of_all, of_one = sound.copy(), sound.copy()
        for run in of_all.runs:
            change(run)
        wrong, _ = checked(of_all, tmp_path / name, along)
        assert words in wrong, name
        # a circle: it ends where an eight does not
        change(of_one.runs[1])
        wrong, runs = checked(of_one, tmp_path / f"{name} in one", along)
        if name == "steering in degrees":
            # no angle of a single run is a whole turn, either
            assert words in wrong
        elif name != "counts with quadrature":
            assert (wrong, runs) == ("", {"circle_ccw_0"}), name


def test_a_car_s_angle_counted_from_a_quarter_turn_is_named(tmp_path: Path) -> None:
    """No car steers by more than a radian half of the time."""
    made = plant.ackermann(np.random.default_rng(0), repeats=2)
    for run in made.runs:
        of_column("steer_rad", lambda angle: angle + np.pi / 2)(run)
    wrong, _ = checked(made, tmp_path / "c", along=True)
    assert "in half of all samples" in wrong and "is it 0 straight ahead?" in wrong
