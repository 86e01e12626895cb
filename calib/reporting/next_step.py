"""What to do now: the last line of a command, with the command that follows."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry


def after_check(verdict: str, campaign: Path, *, distances: bool) -> str:
    """Return what follows a check: ``sound``, ``look at this`` or ``wrong``; `distances`: whether any was measured."""
    if verdict == "wrong":
        return _next(f"correct what is wrong above, then {_command('check', campaign)}.")
    if not distances:
        lengths = f"{_command('geometry', campaign)} for radii and lengths"
        return _next(f"{lengths}, {_command('diagnose', campaign)} for the gap.")
    return _next(
        f"{_command('fit', campaign)} for the law of the load, {_command('geometry', campaign)} for the track."
    )


def after_fit(passed: bool, campaign: Path) -> str:
    """Return what follows a fit, usable or not."""
    if passed:
        export = _command("export", campaign, "--to", "json", "--output", "coefficients.json")
        return _next(f"{_command('report', campaign)} to sign it, {export} to use it.")
    return _next(f"{_command('plan', campaign)} names the runs that are missing; drive them, then fit again.")


def after_geometry(geometry: Geometry, campaign: Path, output: Path | None) -> str:
    """Return what follows a geometry; `output`: the coefficient file that was written."""
    if not geometry.passed:
        return _next(f"correct what is named above, then {_command('geometry', campaign)}.")
    if output is None:
        return _next(f"{_command('geometry', campaign, '--output', 'coefficients.json')} to use it.")
    ros2 = _command("export", output, "--to", "ros2", "--output", "params")
    return _next(f"{ros2}; {_command('diagnose', campaign, '--model', output)} for what is left.")


def after_diagnosis(diagnosis: Diagnosis, campaign: Path) -> str:
    """Return what follows a diagnosis, by its verdict and whether its fix is recommended."""
    kind = diagnosis.kind.value
    if kind == "no_gap":
        return _next(f"nothing to correct; {_command('diagnose', campaign)} again once tyres, floor or loads change.")
    if diagnosis.recommended:
        return _next(f"{_command('diagnose', campaign, '--apply', 'corrected.json')} writes the corrected model.")
    if kind == "unknown":
        return _next(
            "add columns of suspected quantities to runs.csv (temperature_C, tyre pressure, floor), then "
            f"{_command('diagnose', campaign)}."
        )
    return _next(f"{_command('plan', campaign)} names the runs that settle it; drive them, then diagnose again.")


def after_plan(campaign: Path, n_runs: int) -> str:
    """Return what follows a plan of runs to drive next."""
    if not n_runs:
        return _next(f"no further run tells causes apart; {_command('diagnose', campaign)} has the verdict.")
    return _next(f"drive them, add them to runs.csv of the campaign, then {_command('diagnose', campaign)}.")


def after_report(passed: bool, source: Path) -> str:
    """Return what follows a report, whose checks passed or not."""
    if passed:
        return _next(f"{_command('export', source, '--to', 'dcc', '--output', 'certificate.xml')} for the certificate.")
    return _next(f"{_command('plan', source)} names the runs that are missing; drive them, then fit again.")


def after_export(to: str, source: Path, output: Path) -> str:
    """Return what follows an export in a format."""
    again = _command("diagnose", source, "--simulator", "SIM.toml")
    simulator = f"run your simulator with it, then {again} for what is left."
    steps = {
        "json": f"{_command('diagnose', source, '--model', output)} for what is left.",
        "ros2": f"pass it after the controllers' own parameter file (--params-file {shlex.quote(str(output))}).",
        "c": f"cc -fsyntax-only -x c {shlex.quote(str(output))} checks it with your compiler; then include it.",
        "c_effects": f"include it in your simulator's loop, then {again} for what is left.",
        "csv": f"{_command('export', source, '--to', 'json', '--output', 'coefficients.json')} has the law itself.",
        "mjcf": simulator,
        "urdf": simulator,
        "sdf": simulator,
        "dcc": f"{_command('report', source)} has the same for people; sign both.",
        "mcap": f"open {shlex.quote(str(output))} in Foxglove.",
        "nav2": f"pass it after the navigation's own parameter file (--params-file {shlex.quote(str(output))}).",
    }
    return _next(steps[to])


def _next(text: str) -> str:
    return f"Next: {text}"


def _command(name: str, *arguments: str | Path) -> str:
    given: Iterable[str] = (shlex.quote(str(argument)) for argument in arguments)
    return f"'calib {name} {' '.join(given)}'"
