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
from calib.reporting.blocks import Block, Drawings, Section, catalogue, drawn
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


def _quoted(word: str) -> str:
    plain = shlex.quote(word) == word or set(word) & set('"$`\\!')
    return shlex.quote(word) if plain else f'"{word}"'


def next_step(step: str, **names: str | Path | Iterable[str | Path]) -> str:
    """Return the line after a step of ``words.toml``; ``runs`` is the campaign `c`, where that has runs to diagnose."""
    campaign = Path(str(names.get("c", "")))
    names["runs"] = campaign if (campaign / "campaign.toml").is_file() else "CAMPAIGN"
    words = {name: [one] if isinstance(one, str | Path) else one for name, one in names.items()}
    quoted = {name: " ".join(map(_quoted, map(str, several))) for name, several in words.items()}
    return "Next: " + catalogue()["next"][step].format(**quoted)


#: what a check found -> its step, where the law of the load lacks runs
_NEEDED: Final = ("missing_counts", "missing_distance")
_LACKING: Final = {"few_runs": "check lacks runs", "one_session": "check lacks days"}


def after_check(report: CheckReport, columns: Iterable[str]) -> str:
    """Return the step that a check was; `columns`: of run table and logs."""
    used = report.found.n_runs - report.found.n_excluded
    nothing = (one.code in _NEEDED and one.text.startswith(f"{used} run(s)") for one in report.suspicious)
    if report.verdict == "wrong" or any(nothing):
        return "check wrong"
    front_alone = "counts_front" in columns and report.found.counts_left is None
    if report.found.distance_m is None or front_alone:
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
    if step in catalogue()["next"]:
        return step
    # runs to drive next are sought for confounded causes alone
    return without_runs(diagnosis) if diagnosis.groups and not (diagnosis.next_runs or simulator) else "diagnose"


def without_runs(diagnosis: Diagnosis) -> str:
    """Return the step where no run tells the causes apart: of two instruments a third length tells which is wrong."""
    from calib.gap.effects.reference import RangefinderScale, ReferenceScale

    instruments = {RangefinderScale.id, ReferenceScale.id}
    both = any(instruments.issubset(group.effects) for group in diagnosis.groups)
    return "plan instruments" if both else "plan nothing"
