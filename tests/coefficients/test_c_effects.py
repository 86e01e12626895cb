"""The header of effects moves the wheels as the Python class does, which moves them as the diagnosis does."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import ExportOptions
from calib.coefficients.formats.for_vehicle import EFFECTS_NAME, OTHER_FORMS, effects_header, known_effects
from calib.coefficients.sections import EffectSection
from calib.gap.effects.library import every_effect, section_of
from calib.gap.observations import Observations
from calib.runtime import Effects, Run
from calib.runtime import effects as runtime
from tests.coefficients.test_c_header import STRICT
from tests.runtime.driving import coefficient_file, driven_runs, run_of, sections_of

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")

#: of a travel in metres: both compute in doubles, in another order
AGREES = 1e-12
PROBE = """#include <stdio.h>
#include "calib_effects.h"
int main(void)
{
    calib_effects e; double l, r, dt; int back;
    calib_effects_run run = calib_effects_unknown();
    if (scanf("%lf %lf %lf %lf %lf %lf %lf %d %lf %lf", &run.load_left_N, &run.load_right_N, &run.payload_kg,
              &run.temperature_C, &run.speed_mps, &run.travelled_km, &run.minutes_under_load, &back,
              &run.phase_left_rad, &run.phase_right_rad) != 10) return 1;
    run.back = back;
COVARIATE
    calib_effects_begin(&e, &run);
    while (scanf("%lf %lf %lf", &l, &r, &dt) == 3) {
        const calib_effects_motion m = calib_effects_step(&e, l, r, dt);
        printf("%.17g %.17g %.17g %.17g %.17g\\n", m.left_m, m.right_m, m.track_m, m.aside_m, m.turn_rad);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def driven() -> tuple[Campaign, Observations]:
    return driven_runs()


def moved(file: CoefficientFile, run: Run, steps: np.ndarray, folder: Path) -> np.ndarray:
    """Return what the compiled header makes of steps (n_steps, 3), shape (n_steps, 5)."""
    [header] = effects_header(file, ExportOptions())
    (folder / EFFECTS_NAME).write_bytes(header.data)
    covariate = '    if (scanf("%lf", &run.covariate[0]) != 1) return 1;' if b"covariate[1]" in header.data else ""
    (folder / "probe.c").write_text(PROBE.replace("COVARIATE", covariate), encoding="utf-8")
    command = ["cc", *STRICT, "-O2", "-o", str(folder / "probe"), str(folder / "probe.c"), "-lm"]
    subprocess.run(command, check=True, cwd=folder)
    numbers = [
        *(run.load_left_N, run.load_right_N, run.payload_kg, run.temperature_C, run.speed_mps, run.travelled_km),
        *(run.minutes_under_load, int(run.direction == "back"), run.phase_left_rad, run.phase_right_rad),
    ]
    if covariate:
        numbers.append(run.covariates["tyre_bar"])
    rows = [numbers, *steps.tolist()]
    text = "\n".join(" ".join(format(float(value), ".17g") for value in row) for row in rows)
    done = subprocess.run([str(folder / "probe")], input=text, capture_output=True, text=True, check=True)
    return np.array([[float(part) for part in line.split()] for line in done.stdout.splitlines()])


def assert_alike(made: Campaign, s: Observations, sections: list[EffectSection], folder: Path) -> None:
    file = coefficient_file(made, s, sections)
    path = folder / "c.json"
    path.write_bytes(file.to_bytes())
    effects = Effects.from_file(path)
    number = int(np.flatnonzero(s.from_log)[-1])
    steps = slice(int(s.starts[number]), int(s.starts[number + 1]))
    rolled = np.column_stack((s.roll_left_rad[steps], s.roll_right_rad[steps], s.duration_s[steps]))
    run = run_of(s, number)
    effects.begin(run)
    wanted = [effects.step(*row) for row in rolled.tolist()]
    found = moved(file, run, rolled, folder)
    expected = [[m.left_m, m.right_m, m.track_m, m.aside_m, m.turn_rad] for m in wanted]
    np.testing.assert_allclose(found, expected, rtol=AGREES, atol=AGREES)


def test_the_header_knows_the_effects_of_the_runtime() -> None:
    assert known_effects() == set(runtime._ACTS)
    assert OTHER_FORMS == runtime._OTHER_FORMS


@pytest.mark.parametrize("name", [*sorted(known_effects()), "covariate:tyre_bar"])
def test_each_effect_moves_the_wheels_as_in_python(
    name: str, driven: tuple[Campaign, Observations], tmp_path: Path
) -> None:
    made, s = driven
    for section in sections_of(name, s)[-2:]:
        assert_alike(made, s, [section], tmp_path)


def test_all_effects_act_together(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    made, s = driven
    assert_alike(made, s, [sections_of(name, s)[0] for name in (*runtime._ACTS, "covariate:tyre_bar")], tmp_path)


def test_what_is_not_known_has_no_effect(driven: tuple[Campaign, Observations], tmp_path: Path) -> None:
    """An unknown temperature or time under load leaves the wheels as they are."""
    made, s = driven
    file = coefficient_file(made, s, [sections_of(n, s)[0] for n in ("temperature_radius", "load_creep")])
    run = Run(load_left_N=300.0, load_right_N=300.0)
    assert math.isnan(run.temperature_C)
    [row] = moved(file, run, np.array([[0.1, 0.1, 0.02]]), tmp_path)
    wheel = file.wheels.left
    radius = wheel.radius_ref.value + wheel.slope.value * (300.0 - wheel.reference_load.value)
    assert row[0] == pytest.approx(0.1 * radius, rel=AGREES)


def test_loads_outside_the_valid_range_are_taken_as_in_python(
    driven: tuple[Campaign, Observations], tmp_path: Path
) -> None:
    """Clamped where a wheel can carry them, or refused: the motion is NaN. A time before the load is none."""
    made, s = driven
    clamping, steps = coefficient_file(made, s, [sections_of("load_creep", s)[0]]), np.array([[0.1, 0.1, 0.02]])
    wheels = clamping.to_dict()["wheels"]
    wheels["left"]["valid_load"]["max"]["value"] = 4000.0
    clamping = clamping.changed(wheels=wheels)

    def at(file: CoefficientFile, load_N: float, minutes: float = -30.0) -> np.ndarray:
        return moved(file, Run(load_left_N=load_N, load_right_N=300.0, minutes_under_load=minutes), steps, tmp_path)[0]

    np.testing.assert_array_equal(at(clamping, 5000.0), at(clamping, 4000.0, minutes=0.0))
    assert np.isnan([at(clamping, load_N)[0] for load_N in (math.nan, 5000.1, -1.0)]).all()
    assert np.isnan(at(clamping.changed(outside="refuse"), 9000.0)[0])


def test_effects_that_do_not_act_on_motion_are_named(
    driven: tuple[Campaign, Observations],
) -> None:
    made, s = driven
    yaw = section_of(every_effect(s)["reference_yaw"].forms(s)[0], np.array([0.01]))
    [header] = effects_header(coefficient_file(made, s, [yaw, sections_of("track_width", s)[0]]), ExportOptions())
    assert b"NOT in this header: reference_yaw" in header.data
    assert header.notes == ("not in the header: reference_yaw",)
