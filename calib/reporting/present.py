"""Words and figures of each result, where `calib.documents.Result` meets its topic; and what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from calib.documents import Result
from calib.errors import BadInputError
from calib.reporting.blocks import Block, Drawings, Section, drawn
from calib.reporting.formatting import to_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.campaign.check import CheckReport
    from calib.gap.decision.diagnosis import Diagnosis, Plan
    from calib.kinematics.result import Geometry
    from calib.odometry.simulation import Simulation
    from calib.radius.result import Fit


#: class of a result -> ``module.function`` of `calib.reporting.topics`: what its command prints, and what interpreter
#: and notebook show
CONTENT: Final = {
    "Fit": ("fit.fit_content", "fit.fit_brief"),
    "Geometry": ("geometry.geometry_content", "geometry.geometry_brief"),
    "Diagnosis": ("diagnosis.diagnosis_full", "diagnosis.diagnosis_brief"),
    "Plan": ("diagnosis.plan_content", "diagnosis.plan_content"),
    "Simulation": ("simulation.simulation_content", "simulation.simulation_content"),
    "Replay": ("simulation.replay_content", "simulation.replay_content"),
}


def summary(result: Result) -> str:
    """Return what the command prints of a result."""
    return to_text(_content(result, brief=False))


def brief(result: Result) -> str:
    """Return what the interpreter shows of a result."""
    return to_text(_content(result, brief=True)).rstrip()


def brief_html(result: Result) -> str:
    """Return what a notebook shows of a result."""
    from calib.reporting.pages import blocks_html

    return blocks_html(_content(result, brief=True))


def figure(result: Result, kind: str | None) -> Figure:
    """Return a figure of a result, the first one where no kind is named."""
    figures = _FIGURES[type(result).__name__](result)
    kind = next(iter(figures), "") if kind is None else kind
    if kind not in figures:
        raise BadInputError(
            f"plot: found the kind {kind!r}; expected one of {', '.join(figures) or 'none: there is nothing to draw'}"
        )
    return figures[kind]()


def _content(result: Result, *, brief: bool) -> Sequence[Block | Section]:
    module, _, function = CONTENT[type(result).__name__][brief].partition(".")
    blocks: Sequence[Block | Section] = getattr(import_module(f"calib.reporting.topics.{module}"), function)(result)
    return blocks


def _fit(fit: Fit) -> Drawings:
    session = fit.radii.session
    return {
        "regressions": partial(drawn, "calibration.regressions", fit.left, fit.right, session),
        "runs": partial(drawn, "calibration.runs_by_series", fit.radii),
        "path_deviation": partial(drawn, "calibration.path_deviation", fit.radii),
        "residuals": partial(drawn, "calibration.residuals", fit.left, fit.right, session),
    }


def _diagnosis(diagnosis: Diagnosis) -> Drawings:
    from calib.reporting.figures.gap import gap_figures

    figures = gap_figures(diagnosis)
    return {name: partial(figures.__getitem__, name) for name in sorted(figures, key=lambda one: one != "before-after")}


def _plan(plan: Plan) -> Drawings:
    from calib.gap.plan.identifiability import outlook_of

    return {"matrix": lambda: drawn("gap.plan_matrix", outlook_of(plan.campaign))}


def _simulation(simulation: Simulation) -> Drawings:
    from calib.odometry.simulation import SHOWN

    return {
        name: partial(drawn, "motion.sweep_figure", sweep, error=SHOWN.get(name, "lateral_m"), title=simulation.title)
        for name, sweep in simulation.sweeps.items()
    }


#: kind of figure -> its drawing function, the default first
_FIGURES: Final[Mapping[str, Callable[[Any], Drawings]]] = {
    "Fit": _fit,
    "Geometry": lambda one: {"paths": partial(drawn, "calibration.draw_paths", one.paths, simulated=one.simulated)},
    "Diagnosis": _diagnosis,
    "Plan": _plan,
    "Simulation": _simulation,
    "Replay": lambda replay: {"end_errors": partial(drawn, "motion.replay_figure", replay)},
}


#: failed checks of a fit that further runs alone mend
_OF_MISSING_RUNS: Final = frozenset({"design", "order"})
_AGAIN: Final = "'calib diagnose {runs} --simulator SIM.toml' for what is left."
_SIMULATOR: Final = "run your simulator with it, then " + _AGAIN
#: command and outcome -> what follows; ``c``: its campaign or source, ``file``: what was written
STEPS: Final = {
    "init": "fill in campaign.toml, and runs.csv with a row a run, then 'calib check {c}'.",
    "ingest --describe": "save the mapping above as mapping.toml, correct it, then "
    "'calib ingest {sources} --mapping mapping.toml --into campaign'.",
    "ingest": "'calib check {c}'.",
    "ingest --dry-run": "the same without --dry-run, then 'calib check {c}'.",
    "check wrong": "correct what is wrong above, then 'calib check {c}'.",
    "check": "'calib fit {c}' for the law of the load, 'calib geometry {c}' for the track.",
    "check lengths": "'calib fit {c}' for the law of the load.",
    "check lacks days": "'calib plan {c}' names runs for another day; 'calib fit {c}' gives the law of this one.",
    "check lacks runs": "drive the runs that are missing, see above, then 'calib check {c}'.",
    "check without distances": "'calib geometry {c}' for radii and lengths, 'calib diagnose {c}' for the gap.",
    "fit": "'calib report {c}' to sign it, 'calib export {c} --to json --output coefficients.json' to use it.",
    "fit failed": "correct in runs.csv, or exclude there, what failed above, then 'calib fit {c}'.",
    "fit lacks runs": "'calib plan {c}' names the runs that are missing; drive them, then fit again.",
    "geometry": "'calib geometry {c} --output coefficients.json' to use it.",
    "geometry failed": "correct what is named above, then 'calib geometry {c}'.",
    "geometry lengths": "'calib fit {c}' for the law of the load; measure headings or closed loops for the track.",
    "geometry --output": "'calib export {file} --to ros2 --output params'; "
    "'calib diagnose {c} --model {file}' for what is left.",
    "diagnose": "'calib plan {c}' names the runs that settle it; drive them, then diagnose again.",
    "diagnose --apply": "'calib diagnose {c} --model {file}' for what is left.",
    "diagnose no_gap": "nothing to correct; 'calib diagnose {c}' again once tyres, floor or loads change.",
    "diagnose recommended": "'calib diagnose {c} --apply corrected.json' writes the corrected model.",
    "diagnose simulator": "'calib diagnose {c} --simulator {sim} --apply parameters.json' writes what to set; "
    "make it the nominal values of {sim}, then diagnose again.",
    "diagnose simulator lacks": "give your simulator, and {sim}, a parameter for what is named, then "
    "'calib diagnose {c} --simulator {sim}'.",
    "diagnose simulator group": "'calib diagnose {c} --simulator {sim} --exclude EFFECT' for what to set, where EFFECT "
    "of the library is not at work.",
    "diagnose unknown": "add columns of suspected quantities to runs.csv (temperature_C, tyre pressure, floor), then "
    "'calib diagnose {c}'.",
    "diagnose wrong": "correct what is named above, see 'calib check {c}', then 'calib diagnose {c}'.",
    "diagnose counters": "correct or exclude {runs_named} by 'calib check {c}', then 'calib diagnose {c}'.",
    "plan": "drive them, add them to runs.csv of the campaign, then 'calib diagnose {c}'.",
    "plan nothing": "no run tells more: repeat those driven, on other days if you can, then 'calib diagnose {c}'.",
    "plan --from": "drive the plan, add its runs to runs.csv, then 'calib diagnose CAMPAIGN'.",
    "report": "'calib export {c} --to dcc --output certificate.xml' for the certificate.",
    "report unstated": "'calib export {c} --to json --output coefficients.json' to use it.",
    "report failed": "correct what failed, or drive what 'calib plan {c}' names, then fit again.",
    "export json": "'calib diagnose {runs} --model {file}' for what is left.",
    "export ros2": "pass it after the controllers' own parameter file (--params-file {file}).",
    "export c": "cc -fsyntax-only -x c {file} checks it with your compiler; then include it.",
    "export c_effects": "include it in your simulator's loop, then " + _AGAIN,
    "export csv": "'calib export {c} --to json --output coefficients.json' has the law itself.",
    "export mjcf": _SIMULATOR,
    "export urdf": _SIMULATOR,
    "export sdf": _SIMULATOR,
    "export dcc": "'calib report {c}' has the same for people; sign both.",
    "export mcap": "open {file} in Foxglove.",
    "export nav2": "pass it after the navigation's own parameter file (--params-file {file}).",
    "deviation": "'calib deviation CAMPAIGN' judges the paths of runs driven.",
    "deviation CAMPAIGN": "'calib fit {c}' corrects every radius for its path.",
    "deviation unknown": "add what tells the path, as said above, then 'calib deviation {c}'; 'calib fit {c}' takes "
    "such runs for straight.",
    "loads": "write them into runs.csv as load_left_N and load_right_N, then 'calib check CAMPAIGN'.",
    "loads --weighed": "write mass and place into runs.csv as payload_kg, payload_x_m and payload_y_m, then "
    "'calib check CAMPAIGN'.",
    "simulate": "'calib simulate journey --law CAMPAIGN' drives under a law that was measured.",
    "simulate --law": "'calib export {c} --to json --output coefficients.json' for the vehicle.",
    "simulate replay": "'calib diagnose {c}' for the causes of the errors that remain.",
    "effects": "'calib effects EFFECT' for one of them in full.",
    "effects EFFECT": "'calib diagnose {c}' says whether the runs show it.",
    "fleet": "'calib fleet run {c} --what {other} --into fleet-{other}'.",
    "fleet table": "'calib fleet run FOLDER --what diagnose' takes a campaign folder a vehicle, with logs.",
    "fleet vehicle failed": "'calib check {first}', then 'calib fleet run {c} --what {what} --into {into}' again.",
    "fleet file failed": "correct the files named above, then 'calib fleet run {c} --what {what} --into {into}' again.",
    "fleet simulate": "'calib fleet run {c} --into fleet'.",
    "fleet simulate --poses": "'calib fleet run {c} --what geometry --into fleet'.",
    "challenge make": "'calib challenge run {c}'.",
    "challenge run": "'calib challenge score {c}'.",
    "challenge score": "'calib challenge own CAMPAIGN' for what your own runs would show.",
    "challenge own": "'calib diagnose {c}' for the campaign itself.",
}


def _quoted(word: str) -> str:
    plain = shlex.quote(word) == word or set(word) & set('"$`\\!')
    return shlex.quote(word) if plain else f'"{word}"'


def next_step(step: str, **names: str | Path | Iterable[str | Path]) -> str:
    """Return the line after a step of `STEPS`; ``runs`` is the campaign `c`, where that has runs to diagnose."""
    campaign = Path(str(names.get("c", "")))
    names["runs"] = campaign if (campaign / "campaign.toml").is_file() else "CAMPAIGN"
    words = {name: [one] if isinstance(one, str | Path) else one for name, one in names.items()}
    quoted = {name: " ".join(map(_quoted, map(str, several))) for name, several in words.items()}
    return "Next: " + STEPS[step].format(**quoted)


#: what a check found -> its step, where the law of the load lacks runs
_LACKING: Final = {"few_runs": "check lacks runs", "one_session": "check lacks days"}


def after_check(report: CheckReport, columns: Iterable[str]) -> str:
    """Return the step that a check was; `columns`: of run table and logs."""
    if report.verdict == "wrong":
        return "check wrong"
    if report.found.distance_m is None:
        return "check without distances"
    if {"ref_x_m", "ref_theta_rad", "gyro_z_radps", "loop"}.intersection(columns):
        return "check"
    codes = {note.code for note in report.suspicious}
    return next((step for code, step in _LACKING.items() if code in codes), "check lengths")


def after_fit(fit: Fit) -> str:
    """Return the step that a fit was: runs are missing only where nothing else fails."""
    failed = {check.name for wheel in fit.wheels.values() for check in wheel.checks if not check.passed}
    return "fit" if not failed else "fit lacks runs" if failed <= _OF_MISSING_RUNS else "fit failed"


def after_geometry(geometry: Geometry, output: Path | None) -> str:
    """Return the step that a geometry was; `output`: the coefficient file that was written."""
    if any("straight runs alone" in one for one in geometry.why):
        return "geometry lengths"
    return "geometry failed" if not geometry.passed else "geometry" if output is None else "geometry --output"


def after_diagnosis(diagnosis: Diagnosis, *, simulator: bool = False) -> str:
    """Return the step that a diagnosis was, by its verdict and fix; `simulator`: whether it was of the user's own."""
    kind = "recommended" if diagnosis.recommended else diagnosis.kind.value
    if simulator and diagnosis.recommended:
        tied = any(name.startswith("simulator:") for group in diagnosis.groups for name in group.effects)
        kind = "simulator" if diagnosis.fix.parameters else "simulator group" if tied else "simulator lacks"
    # what was corrected before the search has no finite signal
    wrong = diagnosis.correct_first or any(cause.signal == float("inf") for cause in diagnosis.causes)
    kind = diagnosis.kind.value if diagnosis.kind.value == "no_gap" else "wrong" if wrong else kind
    step = f"diagnose {kind}"
    return step if step in STEPS else "diagnose"
