"""A hidden change of a simulator is found in its own parameters, and the simulator itself shows that the gap closes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.gap.decision.diagnosis import VerdictKind
from calib.gap.decision.held_out import RERUN
from calib.gap.effects.encoder import BLUNDER_MISFIT, misfit
from calib.gap.simulator import read_settings
from calib.gap.simulator.diagnose import SimulatorDiagnosis, diagnose_simulator
from calib.gap.simulator.runner import SimulatorRunner
from tests.gap.simulator.made import NOMINAL, NUMPY, called, numpy_campaign, numpy_settings

#: standard deviations within which an estimate is of its truth: a chance of some 1 in 4000 of more
SPREAD = 3.7
#: a closed gap is at its noise within the scatter of a root mean square over some fifty readings
CLOSED = 1.3
RUNS_BESIDE_PARAMETERS = 3


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALIB_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def diagnosed(folder: Path, hidden: object, sim: Path | None = None) -> SimulatorDiagnosis:
    """Diagnose a simulator whose script is called in this process."""
    with patch.object(SimulatorRunner, "_finished", called):
        return started(folder, hidden, sim)


def started(folder: Path, hidden: object, sim: Path | None = None) -> SimulatorDiagnosis:
    """Diagnose a simulator that is started for each run, as a user's is."""
    made = numpy_campaign(folder / "campaign", hidden)  # type: ignore[arg-type]
    return diagnose_simulator(read_campaign(made), read_settings(sim or numpy_settings(folder)), workers=2)


@pytest.fixture(scope="module")
def small_wheel(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulatorDiagnosis]:
    folder = tmp_path_factory.mktemp("small_wheel")
    return folder, started(folder, {"wheel_radius_left": 0.09944})


def test_the_parameter_is_named_with_what_to_set(small_wheel: tuple[Path, SimulatorDiagnosis]) -> None:
    full = small_wheel[1].diagnosis
    assert full.kind is VerdictKind.EXPLAINED
    assert [cause.effect for cause in full.causes] == ["simulator:wheel_radius_left"]
    assert full.judged_against == "SIM.toml"
    assert "wheel_radius_left of your simulator is 0.56 % too large: set it to 0.0994" in full.sentence
    quantity = full.causes[0].parameters["wheel_radius_left"]
    low, high = quantity.ci95
    sd = (high - low) / (2 * 1.96)
    assert abs(quantity.value - (0.09944 - 0.1)) < SPREAD * sd
    assert full.fix.parameters == pytest.approx({"wheel_radius_left": 0.1 + quantity.value}, rel=1e-12)
    assert full.recommended


def test_a_gap_of_a_tenth_of_the_way_is_judged_after_the_fit(tmp_path: Path) -> None:
    """What a parameter closes is no blunder of units or axes, however large the gap was before."""
    done = diagnosed(tmp_path, {"wheel_radius_left": 0.098})
    evidence = done.diagnosis.evidence
    assert evidence is not None
    assert np.mean(misfit(evidence.nominal, evidence.nominal)) > BLUNDER_MISFIT
    assert done.diagnosis.kind is VerdictKind.EXPLAINED
    assert [cause.effect for cause in done.diagnosis.causes] == ["simulator:wheel_radius_left"]


def test_closure_is_what_the_simulator_shows_with_the_fix(small_wheel: tuple[Path, SimulatorDiagnosis]) -> None:
    """Against end poses that the example's own function gives for the parameters that were named."""
    folder, done = small_wheel
    closure = done.diagnosis.closure
    assert closure.held_out == RERUN
    assert closure.fraction is not None
    assert closure.fraction > 0.99
    made = read_campaign(folder / "campaign")
    for parameters, stated in (({}, closure.before_rms_m), (done.diagnosis.fix.parameters, closure.after_rms_m)):
        out = folder / "out.csv"
        (folder / "p.json").write_text(json.dumps(NOMINAL | dict(parameters)))
        from examples.numpy_simulator.simulator import main

        main(folder / "campaign", folder / "p.json", out)
        table = np.genfromtxt(out, delimiter=",", skip_header=1)[:, 2:4]
        measured = np.column_stack([made.runs.numbers["ref_x_m"], made.runs.numbers["ref_y_m"]])
        apart = np.sqrt(np.mean(((measured - table) ** 2).sum(axis=1)))
        # the diagnosis reads it along and across the end heading: the same length
        assert stated == pytest.approx(apart, rel=1e-6)


def test_a_linear_simulator_runs_once_a_parameter_and_three_times_more(
    small_wheel: tuple[Path, SimulatorDiagnosis],
) -> None:
    folder, done = small_wheel
    assert done.runs.ran == done.runs.asked <= len(NOMINAL) + RUNS_BESIDE_PARAMETERS
    settings = read_settings(folder / "SIM.toml")
    again = diagnose_simulator(read_campaign(folder / "campaign"), settings)
    assert again.runs.ran == 0
    assert again.diagnosis.to_dict() == done.diagnosis.to_dict()


def test_what_no_parameter_does_is_left_to_the_library(tmp_path: Path) -> None:
    """Radii that follow the temperature, of which the simulator knows nothing."""
    warm = 2e-4

    def hidden(number: int) -> dict[str, float]:
        radius = 0.1 * (1.0 + warm * ((12.0, 28.0)[number // 8] - 20.0))
        return {"wheel_radius_left": radius, "wheel_radius_right": radius}

    full = diagnosed(tmp_path, hidden).diagnosis
    named = {cause.effect for cause in full.causes} | {name for group in full.groups for name in group}
    assert "temperature_radius" in named
    assert not any(name.startswith("simulator:") for name in named)
    assert "No parameter of your simulator can do this" in full.sentence
    assert "of the library can" in full.sentence
    assert full.fix.parameters == {}


def test_parameters_that_do_together_what_the_library_can_are_named(tmp_path: Path) -> None:
    """A slope for each wheel: to the library one law of the load, to the simulator two parameters."""
    slopes = {"left": -1.5e-6, "right": -1.2e-6}

    def hidden(number: int) -> dict[str, float]:
        over_N = 0.5 * 9.81 * (0.0, 200.0)[number // 4 % 2]
        return {f"wheel_radius_{side}": 0.1 + slope * over_N for side, slope in slopes.items()}

    text = (NUMPY / "simulator.py").read_text()
    assert 'p["load_slope"]' in text
    (tmp_path / "two.py").write_text(text.replace('p["load_slope"]', 'p[f"load_slope_{w}"]'))
    sim = numpy_settings(tmp_path)
    table = '[[parameter]]\nname = "load_slope_SIDE"\nnominal = 0.0\nstep = 1e-7\nlargest = 5e-6\nunit = "m/N"\n'
    before, _, after = sim.read_text().partition('[[parameter]]\nname = "load_slope"')
    start = after.index("[[parameter]]")
    both = "".join(table.replace("SIDE", side) for side in slopes)
    sim.write_text((before + both + after[start:]).replace(str(NUMPY / "simulator.py"), "two.py"))
    found = diagnosed(tmp_path, hidden, sim).diagnosis
    assert {cause.effect for cause in found.causes} == {f"simulator:load_slope_{side}" for side in slopes}
    for side, slope in slopes.items():
        assert found.fix.parameters[f"load_slope_{side}"] == pytest.approx(slope, rel=0.03)


def test_a_cause_beside_the_parameter_does_not_move_it(tmp_path: Path) -> None:
    """The wheels grow with the temperature above 12 degrees, the track is 0.7 % off: radii are large on average."""

    def hidden(number: int) -> dict[str, float]:
        radius = 0.1 * (1.0 + 5e-4 * ((12.0, 28.0)[number // 8] - 12.0))
        return {"wheel_radius_left": radius, "wheel_radius_right": radius, "track": 0.705}

    done = diagnosed(tmp_path, hidden).diagnosis
    names = {cause.effect for cause in done.causes}
    assert "simulator:track" in names
    low, high = next(c for c in done.causes if c.effect == "simulator:track").parameters["track"].ci95
    assert abs(done.fix.parameters["track"] - 0.705) < SPREAD * (high - low) / (2 * 1.96)
    # the parameters alone leave what the temperature does: no whole explanation
    assert done.kind is VerdictKind.PARTLY_EXPLAINED


def test_no_gap_is_no_gap(tmp_path: Path) -> None:
    done = diagnosed(tmp_path, {})
    assert done.diagnosis.kind is VerdictKind.NO_GAP
    assert done.diagnosis.fix.parameters == {}
    assert done.runs.asked <= len(NOMINAL) + 2


#: one parameter of the example by another law: the left radius is 0.101 - 1e-4 / softness, or with noise
OTHER = """
import json, random, sys
from pathlib import Path
sys.path.insert(0, EXAMPLE)
import simulator
campaign, parameters, out = map(Path, sys.argv[1:])
given = json.loads(parameters.read_text())
p = {name: NOMINAL[name] for name in NOMINAL}
LAW
parameters.write_text(json.dumps(p))
simulator.main(campaign, parameters, out)
NOISE
"""


def other_settings(folder: Path, law: str, parameter: str, noise: str = "") -> Path:
    """SIM.toml of a script that maps one parameter of its own to those of the example."""
    text = OTHER.replace("LAW", law).replace("EXAMPLE", repr(str(NUMPY))).replace("NOMINAL", repr(NOMINAL))
    (folder / "other.py").write_text(text.replace("NOISE", noise))
    path = folder / "SIM.toml"
    command = [sys.executable, "other.py", "{campaign}", "{parameters}", "{out}"]
    path.write_text(f"command = {json.dumps(command)}\n{parameter}")
    return path


def soft(folder: Path, softness: float) -> SimulatorDiagnosis:
    """Diagnose a left radius of 0.101 - 1e-4 / softness, which is nominal at 0.1."""
    sim = other_settings(
        folder,
        'p["wheel_radius_left"] = 0.101 - 1e-4 / given["softness"]',
        '[[parameter]]\nname = "softness"\nnominal = 0.1\nstep = 0.001\nlargest = 0.2\n',
    )
    return diagnosed(folder, {"wheel_radius_left": 0.101 - 1e-4 / softness}, sim)


def closes(done: SimulatorDiagnosis) -> bool:
    after, floor = done.diagnosis.closure.after_rms_m, done.diagnosis.closure.floor_rms_m
    assert after is not None and floor is not None
    return after < CLOSED * floor


@pytest.mark.parametrize("softness", [0.06, 0.05])
def test_a_parameter_that_acts_by_a_curve_is_iterated(tmp_path: Path, softness: float) -> None:
    """At 0.06 the slope is 2.8 times that at 0.1; at 0.05 the first step leads beyond zero, to the other branch."""
    done = soft(tmp_path, softness)
    assert [cause.effect for cause in done.diagnosis.causes] == ["simulator:softness"]
    # the radius is known to some 2e-6 m and changes by 1e-4 / softness^2: as wide as the slope there, not that at 0.1
    low, high = done.diagnosis.causes[0].parameters["softness"].ci95
    sd = (high - low) / (2 * 1.96)
    assert sd == pytest.approx(2e-6 * softness**2 / 1e-4, rel=0.25)
    assert abs(done.diagnosis.fix.parameters["softness"] - softness) < SPREAD * sd
    assert closes(done) and done.diagnosis.recommended
    assert 2 <= done.runs.asked - 3 <= 8


def test_a_fix_that_further_runs_do_not_reach_is_not_recommended(tmp_path: Path) -> None:
    """At 0.02 the slope is twenty-five times that at 0.1: more than eight runs follow."""
    done = soft(tmp_path, 0.02)
    assert done.runs.asked - 3 == 8
    assert not done.diagnosis.recommended
    assert any("still asks for another value" in text for text in done.diagnosis.fix.why)


def test_a_fix_that_the_simulator_does_not_confirm_is_no_explanation(tmp_path: Path) -> None:
    """A parameter with an edge: a step to either side of nominal changes the radius, the value that is off does not."""
    sim = other_settings(
        tmp_path,
        'd = given["left"] - 0.1\np["wheel_radius_left"] = 0.1 + max(d, -1e-4)',
        '[[parameter]]\nname = "left"\nnominal = 0.1\nstep = -0.00005\nlargest = 0.005\nunit = "m"\n',
    )
    done = diagnosed(tmp_path, {"wheel_radius_left": 0.0994}, sim)
    assert done.diagnosis.kind is VerdictKind.PARTLY_EXPLAINED
    assert not done.diagnosis.recommended
    assert any("your simulator, run again with it, closes" in text for text in done.diagnosis.fix.why)


def test_a_cause_that_a_curve_imitated_leaves_no_trace_in_the_fix(tmp_path: Path) -> None:
    """The track follows the square of a parameter: beside its slope alone the library's track is named, at first."""
    sim = other_settings(
        tmp_path,
        'q = given["q"]\np["wheel_radius_left"] = 0.1 - 1e-3 * q\np["track"] = 0.7 * (1 + 0.02 * q**2)',
        '[[parameter]]\nname = "q"\nnominal = 0.0\nstep = 0.01\nlargest = 5.0\n',
    )
    done = diagnosed(tmp_path, {"wheel_radius_left": 0.0994, "track": 0.7 * (1 + 0.02 * 0.36)}, sim)
    assert [cause.effect for cause in done.diagnosis.causes] == ["simulator:q"]
    low, high = done.diagnosis.causes[0].parameters["q"].ci95
    assert abs(done.diagnosis.fix.parameters["q"] - 0.6) < SPREAD * (high - low) / (2 * 1.96)
    assert closes(done) and done.diagnosis.recommended


#: of ends that scatter by 2 mm a run, as much as the reference does
NOISE = """
def taken(seed):
    try:
        seed.touch(exist_ok=False)
    except FileExistsError:
        return True
# each run takes the next of a row of seeds, in any order
seed = next(n for n in range(10000) if not taken(Path(__file__).with_suffix(f".{n}")))
random.seed(seed)
rows = out.read_text().splitlines()
shaken = [row.split(",")[:1] + [str(float(v) + random.gauss(0.0, 2e-3)) for v in row.split(",")[1:4]]
          + row.split(",")[4:] for row in rows[1:]]
out.write_text("\\n".join([rows[0], *map(",".join, shaken)]))
"""


def test_a_noisy_simulator_is_averaged(tmp_path: Path) -> None:
    sim = other_settings(
        tmp_path,
        'p["track"] = given["track"]',
        '[[parameter]]\nname = "track"\nnominal = 0.7\nstep = 0.01\nlargest = 0.05\nunit = "m"\n',
        NOISE,
    )
    done = diagnosed(tmp_path, {"track": 0.712}, sim)
    assert done.diagnosis.causes[0].effect == "simulator:track"
    assert any("does not repeat itself" in note for note in done.diagnosis.notes)
    low, high = done.diagnosis.causes[0].parameters["track"].ci95
    assert abs(done.diagnosis.fix.parameters["track"] - 0.712) < SPREAD * (high - low) / (2 * 1.96)
    assert done.runs.asked >= 8


def test_a_noisy_simulator_of_several_parameters_names_the_one(tmp_path: Path) -> None:
    """All parameters of the example; a step of the slope as declared changes no more than four times the scatter."""
    name, value = "load_slope", 1.5e-6
    text = (NUMPY / "SIM.toml").read_text()
    sim = other_settings(tmp_path, "p.update(given)", text[text.index("[[parameter]]") :], NOISE)
    done = diagnosed(tmp_path, {name: value}, sim)
    assert [cause.effect for cause in done.diagnosis.causes] == [f"simulator:{name}"]
    low, high = done.diagnosis.causes[0].parameters[name].ci95
    assert abs(done.diagnosis.fix.parameters[name] - value) < SPREAD * (high - low) / (2 * 1.96)
    after, floor = done.diagnosis.closure.after_rms_m, done.diagnosis.closure.floor_rms_m
    assert after is not None and floor is not None and after < CLOSED * floor


def test_the_command_says_it_and_writes_what_to_set(
    small_wheel: tuple[Path, SimulatorDiagnosis], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, done = small_wheel
    call = ["diagnose", str(folder / "campaign"), "--simulator", str(folder / "SIM.toml")]
    target = tmp_path / "set.json"
    assert run([*call, "--apply", str(target), "--json", "-"]) == 0
    printed = capsys.readouterr()
    assert json.loads(target.read_text()) == done.diagnosis.fix.parameters
    document = json.loads(printed.out)
    assert document["fix"]["parameters"] == done.diagnosis.fix.parameters
    assert document["judged_against"] == "SIM.toml"
    assert document["closure"]["held_out"] == RERUN
    assert document["causes"][0]["effect"] == "simulator:wheel_radius_left"
    assert run(call) == 0
    told = capsys.readouterr().out
    assert "Simulator: 0 runs" in told
    assert "--apply parameters.json' writes what to set" in " ".join(told.split())
    # what is done is no next step
    assert run([*call, "--apply", str(target), "--force"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "--apply" not in told and f"Next: make the values of {target} the nominal ones of" in told


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--model", "coefficients.json"], "--simulator"),
        (["--exclude", "simulator:no_such"], "simulator:wheel_radius_left"),
        (["--exclude", "track_widht"], "track_width"),
        (["--workers", "100000"], "workers"),
    ],
)
def test_what_does_not_go_together_is_one_line(
    small_wheel: tuple[Path, SimulatorDiagnosis], options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = small_wheel[0]
    assert run(["diagnose", str(folder / "campaign"), "--simulator", str(folder / "SIM.toml"), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    assert words in printed.err


def test_an_interrupted_diagnosis_says_which_runs_are_kept(
    small_wheel: tuple[Path, SimulatorDiagnosis], tmp_path: Path
) -> None:
    """By a signal, while the second run of the simulator is at work."""
    held = 'Path(f"at_work_{given[\'track\'] != 0.7}").touch(); time.sleep(60 * (given["track"] != 0.7))'
    sim = other_settings(
        tmp_path,
        f'import time; p["track"] = given["track"]; {held}',
        '[[parameter]]\nname = "track"\nnominal = 0.7\nstep = 0.01\nlargest = 0.05\n',
    )
    # a shell's background job ignores the signal; here it is heeded wherever the tests run
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    command = f"{heeding}from calib.cli.main import main; main()"
    arguments = ["diagnose", str(small_wheel[0] / "campaign"), "--simulator", str(sim)]
    call = [sys.executable, "-c", command, *arguments]
    environment = os.environ | {"CALIB_CACHE": str(tmp_path / "cache")}
    process = subprocess.Popen(call, stderr=subprocess.PIPE, text=True, env=environment)
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.rglob("at_work_True")) and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert "results of 1 run of the simulator" in errors


def test_no_campaign_gives_a_command(small_wheel: tuple[Path, SimulatorDiagnosis], tmp_path: Path) -> None:
    """A command in campaign.toml is nothing that is run."""
    folder = small_wheel[0]
    path = folder / "campaign" / "campaign.toml"
    text, flag = path.read_text(), tmp_path / "flag"
    try:
        path.write_text(f'simulator = "SIM.toml"\ncommand = ["touch", "{flag}"]\n{text}')
        run(["diagnose", str(folder / "campaign")])
    finally:
        path.write_text(text)
    assert not flag.exists()


def test_the_example_is_short() -> None:
    lines = [line for line in (NUMPY / "simulator.py").read_text().splitlines() if line.strip()]
    assert len(lines) <= 40
