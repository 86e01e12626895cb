"""What to do now: the last line of a command, with the command that follows."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
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
    """Return what follows an export in a format; a source that has no runs cannot be diagnosed."""
    campaign = source if (source / "campaign.toml").is_file() else Path("CAMPAIGN")
    again = _command("diagnose", campaign, "--simulator", "SIM.toml")
    simulator = f"run your simulator with it, then {again} for what is left."
    steps = {
        "json": f"{_command('diagnose', campaign, '--model', output)} for what is left.",
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


def after_files(sources: Sequence[Path]) -> str:
    """Return what follows a look at a laboratory's files."""
    ingest = _command("ingest", *sources, "--mapping", "mapping.toml", "--into", "campaign")
    return _next(f"save the mapping above as mapping.toml, correct it, then {ingest}.")


def after_ingest(campaign: Path, *, written: bool) -> str:
    """Return what follows an import, or its trial without files."""
    check = _command("check", campaign)
    return _next(f"{check}." if written else f"the same without --dry-run, then {check}.")


def after_init(campaign: Path) -> str:
    """Return what follows a blank campaign."""
    return _next(f"fill in campaign.toml, and runs.csv with a row a run, then {_command('check', campaign)}.")


def after_deviation(campaign: Path | None) -> str:
    """Return what follows a table of woven paths, or the verdict on a campaign's."""
    if campaign is None:
        return _next(f"{_command('deviation', 'CAMPAIGN')} judges the paths of runs driven.")
    return _next(f"{_command('fit', campaign)} corrects every radius for its path.")


def after_loads() -> str:
    """Return what follows wheel loads."""
    return _next(f"write them into runs.csv as load_left_N and load_right_N, then {_command('check', 'CAMPAIGN')}.")


def after_plan_file() -> str:
    """Return what follows the judgement on a plan."""
    return _next(f"drive the plan, add its runs to runs.csv, then {_command('diagnose', 'CAMPAIGN')}.")


def after_simulation(law: Path | None) -> str:
    """Return what follows a simulated journey; `law`: the law that it was driven under."""
    if law is None:
        return _next(f"{_command('simulate', 'journey', '--law', 'CAMPAIGN')} drives under a law that was measured.")
    return _next(f"{_command('export', law, '--to', 'json', '--output', 'coefficients.json')} for the vehicle.")


def after_replay(campaign: Path) -> str:
    """Return what follows a replay of logged runs."""
    return _next(f"{_command('diagnose', campaign)} for the causes of the errors that remain.")


def after_effects(effect: str | None, campaign: Path | None) -> str:
    """Return what follows the catalogue of effects, or one of them."""
    if effect is None:
        return _next(f"{_command('effects', 'EFFECT')} for one of them in full.")
    return _next(f"{_command('diagnose', campaign or 'CAMPAIGN')} says whether the runs show it.")


def after_fleet(folder: Path, failed: Sequence[Path], what: str) -> str:
    """Return what follows a task over a fleet; `failed`: the vehicles that failed, as folders of campaigns."""
    if failed:
        campaigns = [vehicle for vehicle in failed if vehicle.is_dir()]
        look = _command("check", *campaigns[:1]) if campaigns else "correct the files named above"
        return _next(f"{look}, then {_command('fleet', 'run', folder, '--what', what, '--into', 'fleet')} again.")
    other = "diagnose" if what in {"fit", "geometry"} else "fit"
    return _next(f"{_command('fleet', 'run', folder, '--what', other, '--into', f'fleet-{other}')}.")


def after_fleet_simulation(folder: Path, *, poses: bool) -> str:
    """Return what follows a simulated fleet."""
    what = ("--what", "geometry") if poses else ()
    return _next(f"{_command('fleet', 'run', folder, *what, '--into', 'fleet')}.")


def after_challenge(step: str, folder: Path) -> str:
    """Return what follows a step of the blind check: ``make``, ``run``, ``score`` or ``own``."""
    steps = {
        "make": f"{_command('challenge', 'run', folder)}.",
        "run": f"{_command('challenge', 'score', folder)}.",
        "score": f"{_command('challenge', 'own', 'CAMPAIGN')} for what your own runs would show.",
        "own": f"{_command('diagnose', folder)} for the campaign itself.",
    }
    return _next(steps[step])


def _next(text: str) -> str:
    return f"Next: {text}"


def _command(name: str, *arguments: str | Path) -> str:
    given: Iterable[str] = (shlex.quote(str(argument)) for argument in arguments)
    return f"'calib {name} {' '.join(given)}'"
