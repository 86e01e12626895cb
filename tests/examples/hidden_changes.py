"""Hidden changes of the MuJoCo vehicle, diagnosed in its own parameters: ``python -m tests.examples.hidden_changes``.

Each campaign of `examples/mujoco_agv/make_campaign.py` hides one change; `calib diagnose --simulator` runs on it with
an empty cache. Printed, a row of the manual's table each: verdict, what to set, end position before and after, runs of
the simulator, wall time in all and of one run. Names of parameters as arguments choose some of the changes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "mujoco_agv"
HIDDEN = {
    "wheel_radius_left": 0.0994,
    "track": 0.707,
    "payload_dy": 0.06,
    "steering_zero": 0.015,
    "friction": 0.3,
    "reference_delay": 0.04,
}


def seconds_of_one_run(campaign: Path, folder: Path, environment: dict[str, str]) -> float:
    """Run the simulator's command once with its nominal parameters, and return what it took by the clock."""
    settings = tomllib.loads((FOLDER / "SIM.toml").read_text())
    parameters, out = folder / "nominal.json", folder / "nominal.csv"
    parameters.write_text(json.dumps({each["name"]: each["nominal"] for each in settings["parameter"]}))
    words = [word.format(campaign=campaign, parameters=parameters, out=out) for word in settings["command"]]
    begun = time.monotonic()
    subprocess.run(words, check=True, cwd=FOLDER, env=environment, capture_output=True)
    return time.monotonic() - begun


def row(name: str, folder: Path) -> str:
    """Make the campaign of a hidden change, diagnose it, and return the row of the table."""
    campaign, out = folder / name, folder / f"{name}.json"
    # `python` of SIM.toml is the one on the path
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"CALIB_CACHE": str(folder / "cache" / name), "PATH": path}
    make = [sys.executable, str(FOLDER / "make_campaign.py"), str(campaign), f"{name}={HIDDEN[name]}"]
    subprocess.run(make, check=True, cwd=FOLDER)
    call = [sys.executable, "-m", "calib", "diagnose", str(campaign), "--simulator", str(FOLDER / "SIM.toml")]
    begun = time.monotonic()
    done = subprocess.run([*call, "--json", str(out)], env=environment, check=False, capture_output=True, text=True)
    seconds = time.monotonic() - begun
    if done.returncode not in {0, 1}:
        raise RuntimeError(done.stderr)
    one = seconds_of_one_run(campaign, folder, environment)
    runs = len(list((folder / "cache" / name).rglob("*.json")))
    document = json.loads(out.read_text())
    closure = document["closure"]
    named = ", ".join(cause["effect"] for cause in document["causes"])
    groups = "; ".join(" or ".join(group) for group in document["indistinguishable"])
    return (
        f"{name}={HIDDEN[name]} | {document['verdict']} | {named or groups} | set {document['fix']['parameters']} | "
        f"{1e3 * closure['before_rms_m']:.3g} -> {1e3 * closure['after_rms_m']:.3g} mm, "
        f"noise {1e3 * closure['floor_rms_m']:.3g} mm | {runs} runs | {seconds:.0f} s in all, {one:.1f} s one run"
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        for wanted in sys.argv[1:] or list(HIDDEN):
            sys.stdout.write(f"{row(wanted, Path(made))}\n")
            sys.stdout.flush()
