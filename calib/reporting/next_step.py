"""What to do now: the last line of a command, with the command that follows."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from calib.gap.decision.diagnosis import Diagnosis
    from calib.kinematics.result import Geometry


#: what a law that cannot be used asks for
_MISSING_RUNS: Final = "'calib plan {c}' names the runs that are missing; drive them, then fit again."


def after_check(verdict: str, campaign: Path, *, distances: bool) -> str:
    """Return what follows a check: ``sound``, ``look at this`` or ``wrong``; `distances`: whether any was measured."""
    if verdict == "wrong":
        return _next("correct what is wrong above, then 'calib check {c}'.", c=campaign)
    if not distances:
        return _next("'calib geometry {c}' for radii and lengths, 'calib diagnose {c}' for the gap.", c=campaign)
    return _next("'calib fit {c}' for the law of the load, 'calib geometry {c}' for the track.", c=campaign)


def after_fit(passed: bool, campaign: Path) -> str:
    """Return what follows a fit, usable or not."""
    signed = "'calib report {c}' to sign it, 'calib export {c} --to json --output coefficients.json' to use it."
    return _next(signed if passed else _MISSING_RUNS, c=campaign)


def after_geometry(geometry: Geometry, campaign: Path, output: Path | None) -> str:
    """Return what follows a geometry; `output`: the coefficient file that was written."""
    if not geometry.passed:
        return _next("correct what is named above, then 'calib geometry {c}'.", c=campaign)
    if output is None:
        return _next("'calib geometry {c} --output coefficients.json' to use it.", c=campaign)
    steps = "'calib export {file} --to ros2 --output params'; 'calib diagnose {c} --model {file}' for what is left."
    return _next(steps, c=campaign, file=output)


def after_diagnosis(diagnosis: Diagnosis, campaign: Path) -> str:
    """Return what follows a diagnosis, by its verdict and whether its fix is recommended."""
    step = "'calib plan {c}' names the runs that settle it; drive them, then diagnose again."
    if diagnosis.kind.value == "no_gap":
        step = "nothing to correct; 'calib diagnose {c}' again once tyres, floor or loads change."
    elif diagnosis.recommended:
        step = "'calib diagnose {c} --apply corrected.json' writes the corrected model."
    elif diagnosis.kind.value == "unknown":
        suspected = "columns of suspected quantities to runs.csv (temperature_C, tyre pressure, floor)"
        step = f"add {suspected}, then 'calib diagnose {{c}}'."
    return _next(step, c=campaign)


def after_plan(campaign: Path, n_runs: int) -> str:
    """Return what follows a plan of runs to drive next."""
    if not n_runs:
        return _next("no further run tells causes apart; 'calib diagnose {c}' has the verdict.", c=campaign)
    return _next("drive them, add them to runs.csv of the campaign, then 'calib diagnose {c}'.", c=campaign)


def after_report(passed: bool, source: Path) -> str:
    """Return what follows a report, whose checks passed or not."""
    certificate = "'calib export {c} --to dcc --output certificate.xml' for the certificate."
    return _next(certificate if passed else _MISSING_RUNS, c=source)


_AGAIN: Final = "'calib diagnose {runs} --simulator SIM.toml' for what is left."
_SIMULATOR: Final = "run your simulator with it, then " + _AGAIN
#: format of an export -> what follows; ``c`` is its source, ``runs`` its campaign, ``file`` what was written
_AFTER_EXPORT: Final = {
    "json": "'calib diagnose {runs} --model {file}' for what is left.",
    "ros2": "pass it after the controllers' own parameter file (--params-file {file}).",
    "c": "cc -fsyntax-only -x c {file} checks it with your compiler; then include it.",
    "c_effects": "include it in your simulator's loop, then " + _AGAIN,
    "csv": "'calib export {c} --to json --output coefficients.json' has the law itself.",
    "mjcf": _SIMULATOR,
    "urdf": _SIMULATOR,
    "sdf": _SIMULATOR,
    "dcc": "'calib report {c}' has the same for people; sign both.",
    "mcap": "open {file} in Foxglove.",
    "nav2": "pass it after the navigation's own parameter file (--params-file {file}).",
}


def after_export(to: str, source: Path, output: Path) -> str:
    """Return what follows an export in a format; a source that has no runs cannot be diagnosed."""
    runs = source if (source / "campaign.toml").is_file() else "CAMPAIGN"
    return _next(_AFTER_EXPORT[to], c=source, runs=runs, file=output)


def after_files(sources: Sequence[Path]) -> str:
    """Return what follows a look at a laboratory's files."""
    ingest = f"calib ingest {shlex.join(map(str, sources))} --mapping mapping.toml --into campaign"
    return f"Next: save the mapping above as mapping.toml, correct it, then '{ingest}'."


def after_ingest(campaign: Path, *, written: bool) -> str:
    """Return what follows an import, or its trial without files."""
    return _next("'calib check {c}'." if written else "the same without --dry-run, then 'calib check {c}'.", c=campaign)


def after_init(campaign: Path) -> str:
    """Return what follows a blank campaign."""
    return _next("fill in campaign.toml, and runs.csv with a row a run, then 'calib check {c}'.", c=campaign)


def after_deviation(campaign: Path | None) -> str:
    """Return what follows a table of woven paths, or the verdict on a campaign's."""
    if campaign is None:
        return _next("'calib deviation CAMPAIGN' judges the paths of runs driven.")
    return _next("'calib fit {c}' corrects every radius for its path.", c=campaign)


def after_loads() -> str:
    """Return what follows wheel loads."""
    return _next("write them into runs.csv as load_left_N and load_right_N, then 'calib check CAMPAIGN'.")


def after_plan_file() -> str:
    """Return what follows the judgement on a plan."""
    return _next("drive the plan, add its runs to runs.csv, then 'calib diagnose CAMPAIGN'.")


def after_simulation(law: Path | None) -> str:
    """Return what follows a simulated journey; `law`: the law that it was driven under."""
    if law is None:
        return _next("'calib simulate journey --law CAMPAIGN' drives under a law that was measured.")
    return _next("'calib export {law} --to json --output coefficients.json' for the vehicle.", law=law)


def after_replay(campaign: Path) -> str:
    """Return what follows a replay of logged runs."""
    return _next("'calib diagnose {c}' for the causes of the errors that remain.", c=campaign)


def after_effects(effect: str | None, campaign: Path | None) -> str:
    """Return what follows the catalogue of effects, or one of them."""
    if effect is None:
        return _next("'calib effects EFFECT' for one of them in full.")
    return _next("'calib diagnose {c}' says whether the runs show it.", c=campaign or "CAMPAIGN")


def after_fleet(folder: Path, failed: Sequence[Path], what: str) -> str:
    """Return what follows a task over a fleet; `failed`: the vehicles that failed, as folders of campaigns."""
    if failed:
        campaigns = [vehicle for vehicle in failed if vehicle.is_dir()]
        look = "'calib check {first}'" if campaigns else "correct the files named above"
        again = ", then 'calib fleet run {folder} --what {what} --into fleet' again."
        return _next(look + again, first=campaigns[0] if campaigns else "", folder=folder, what=what)
    other = "diagnose" if what in {"fit", "geometry"} else "fit"
    return _next("'calib fleet run {folder} --what {other} --into fleet-{other}'.", folder=folder, other=other)


def after_fleet_simulation(folder: Path, *, poses: bool) -> str:
    """Return what follows a simulated fleet."""
    return _next(f"'calib fleet run {{folder}}{' --what geometry' if poses else ''} --into fleet'.", folder=folder)


#: step of the blind check -> what follows
_AFTER_CHALLENGE: Final = {
    "make": "'calib challenge run {c}'.",
    "run": "'calib challenge score {c}'.",
    "score": "'calib challenge own CAMPAIGN' for what your own runs would show.",
    "own": "'calib diagnose {c}' for the campaign itself.",
}


def after_challenge(step: str, folder: Path) -> str:
    """Return what follows a step of the blind check: ``make``, ``run``, ``score`` or ``own``."""
    return _next(_AFTER_CHALLENGE[step], c=folder)


def _next(text: str, **names: str | Path) -> str:
    """Return the line; names of files stand in braces, and the command quotes them for the shell."""
    return "Next: " + text.format(**{name: shlex.quote(str(value)) for name, value in names.items()})
