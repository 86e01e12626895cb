"""Words and figures of each result, where `calib.documents.Result` meets its topic."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from calib.documents import Result
from calib.errors import BadInputError
from calib.reporting.blocks import Block, Drawings, Section, drawn
from calib.reporting.formatting import to_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.gap.decision.diagnosis import Diagnosis, Plan
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
