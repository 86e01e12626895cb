"""Topics of a result: what the terminal prints and what the report shows of each, in one file.

Here `calib.documents.Result` meets its topic: words and figures by the class of the result.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from calib.documents import Result
from calib.errors import BadInputError
from calib.reporting import Block, Drawings, Section, drawn, named
from calib.reporting.formatting import to_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from calib.gap.decision.diagnosis import Diagnosis, Plan
    from calib.kinematics.result import Geometry
    from calib.odometry.replay import Replay
    from calib.odometry.simulation import Simulation
    from calib.radius.result import Fit


def summary(result: Result) -> str:
    """Return what the command prints of a result."""
    return to_text(content_of(result, brief=False))


def brief(result: Result) -> str:
    """Return what the interpreter shows of a result."""
    return to_text(content_of(result, brief=True)).rstrip()


def figure(result: Result, kind: str | None) -> "Figure":
    """Return a figure of a result, the first one where no kind is named."""
    figures: Drawings = PRESENTED[type(result).__name__][2](result)
    kind = next(iter(figures), "") if kind is None else kind
    if kind not in [*figures]:
        raise BadInputError(
            f"plot: found the kind {kind!r}; expected one of {', '.join(figures) or 'none: there is nothing to draw'}"
        )
    return drawn("marked", figures[kind](), simulated=getattr(result, "simulated", False))


def content_of(result: Result, *, brief: bool) -> Sequence[Block | Section]:
    """Return what the command prints of a result, or, `brief`, what interpreter and notebook show."""
    printed, shown, _ = PRESENTED[type(result).__name__]
    blocks: Sequence[Block | Section] = named("topics", shown if brief else printed)(result)
    return blocks


def _fit(fit: "Fit") -> Drawings:
    from calib.reporting.topics.fit import fit_pictures

    runs, regressions, deviation, residuals, *_ = (picture.draw for picture in fit_pictures(fit))
    return {"regressions": regressions, "runs": runs, "path_deviation": deviation, "residuals": residuals}


def _diagnosis(diagnosis: "Diagnosis") -> Drawings:
    from calib.reporting.figures.gap import gap_figures

    figures = gap_figures(diagnosis)
    return {name: partial(figures.__getitem__, name) for name in sorted(figures, key=lambda one: one != "before-after")}


def _plan(plan: "Plan") -> Drawings:
    from calib.gap.plan import outlook_of

    return {"matrix": lambda: drawn("gap.plan_matrix", outlook_of(plan.campaign))}


def _simulation(simulation: "Simulation") -> Drawings:
    from calib.odometry.simulation import SHOWN

    return {
        name: partial(drawn, "studies.sweep_figure", sweep, error=SHOWN.get(name, "lateral_m"), title=simulation.title)
        for name, sweep in simulation.sweeps.items()
    }


def _geometry(geometry: "Geometry") -> Drawings:
    return {"paths": partial(drawn, "calibration.draw_paths", geometry.paths)}


def _replay(replay: "Replay") -> Drawings:
    return {"end_errors": partial(drawn, "studies.replay_figure", replay)}


#: class of a result -> ``module.function`` here: what its command prints, and interpreter and notebook show; its
#: figures by kind, the default first
PRESENTED: Final[Mapping[str, tuple[str, str, Callable[[Any], Drawings]]]] = {
    "Fit": ("fit.fit_content", "fit.fit_brief", _fit),
    "Geometry": ("geometry.geometry_content", "geometry.geometry_brief", _geometry),
    "Diagnosis": ("diagnosis.diagnosis_full", "diagnosis.diagnosis_brief", _diagnosis),
    "Plan": ("diagnosis.plan_content", "diagnosis.plan_content", _plan),
    "Simulation": ("simulation.simulation_content", "simulation.simulation_content", _simulation),
    "Replay": ("simulation.replay_content", "simulation.replay_content", _replay),
}
