"""What the functions of `calib.api` return: the results of each stage, which can also draw and sum up themselves.

A stage can do neither, since words and figures stand above it; each class here adds ``summary`` and ``plot`` to the
stage's own result. What a summary says are the blocks that the command prints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeVar

from calib.campaign.model import Campaign
from calib.errors import BadInputError
from calib.gap import diagnosis as gap_diagnosis
from calib.gap.verdict.outcome import PlannedRunAdvice
from calib.gap.verdict.result import Verdict
from calib.geometry import result as geometry_result
from calib.motion.studies import replay as motion_replay
from calib.motion.studies import run as motion_run
from calib.radius import fitted as radius_fitted

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from calib.report.blocks import Block, Section

Result = TypeVar("Result")


def extended(kind: type[Result], result: Any, **changes: Any) -> Result:
    """Return `result`, with `changes` to its fields, as `kind`, a class that adds methods and no fields."""
    return kind(**({part.name: getattr(result, part.name) for part in fields(result)} | changes))


class _Shown:
    """Says in the interpreter and in a notebook what its command prints."""

    __slots__ = ()

    def _content(self) -> Sequence[Block | Section]:
        raise NotImplementedError

    def _brief(self) -> Sequence[Block | Section]:
        """Return what the interpreter shows of it."""
        return self._content()

    def summary(self) -> str:
        """Return what the command prints, as lines of text."""
        from calib.report.text import to_text

        return to_text(self._content())

    def __repr__(self) -> str:
        from calib.report.text import to_text

        return to_text(self._brief()).rstrip()

    def _repr_html_(self) -> str:
        from calib.report.html import blocks_html

        return blocks_html(self._brief())


def _chosen(figures: Mapping[str, Any], kind: str | None) -> Any:
    """Return the figure of that name, or the first one."""
    kind = next(iter(figures), "") if kind is None else kind
    if kind not in figures:
        raise BadInputError(
            f"plot: found the kind {kind!r}; expected one of {', '.join(figures) or 'none: there is nothing to draw'}"
        )
    return figures[kind]


class Fit(_Shown, radius_fitted.Fit):
    """The fit of a campaign; see `calib.radius.fitted.Fit`."""

    __slots__ = ()

    def _content(self) -> Sequence[Block | Section]:
        from calib.report.statements.fit import fit_content

        return fit_content(self)

    def _brief(self) -> Sequence[Block | Section]:
        from calib.report.statements.checks import usable_notice
        from calib.report.statements.law import law_table

        return (law_table(self), usable_notice(self))

    def plot(self, kind: str = "regressions") -> Figure:
        """Draw the fit.

        Parameters
        ----------
        kind : {"regressions", "runs", "path_deviation", "residuals"}
            Which figure.
        """
        from calib.report.figures import radius as drawn

        session = self.radii.session
        draw = {
            "regressions": lambda: drawn.regressions(self.left, self.right, session),
            "runs": lambda: drawn.runs_by_series(self.radii),
            "path_deviation": lambda: drawn.path_deviation(self.radii),
            "residuals": lambda: drawn.residuals(self.left, self.right, session),
        }
        figure: Figure = _chosen(draw, kind)()
        return figure


class Geometry(_Shown, geometry_result.Geometry):
    """The geometry of a vehicle; see `calib.geometry.result.Geometry`."""

    __slots__ = ()

    def _content(self) -> Sequence[Block | Section]:
        from calib.report.statements.geometry import geometry_content

        return geometry_content(self)

    def _brief(self) -> Sequence[Block | Section]:
        return self._content()[:2]

    def plot(self) -> Figure:
        """Draw the paths of the runs before and after the calibration, beside the reference."""
        from calib.report.figures.geometry import draw_paths

        return draw_paths(self.paths, simulated=self.simulated)


class Diagnosis(_Shown, gap_diagnosis.Diagnosis):
    """The diagnosis of a campaign; see `calib.gap.diagnosis.Diagnosis`."""

    __slots__ = ()

    def _content(self) -> Sequence[Block | Section]:
        from calib.report.statements.diagnosis import verdict_content

        return verdict_content(self.verdict)

    def _brief(self) -> Sequence[Block | Section]:
        from calib.report.statements.diagnosis import verdict_notice

        return (verdict_notice(self.verdict),)

    @property
    def table(self) -> DataFrame:
        """The causes as a table, a row a parameter; SI units, 95 % intervals."""
        from pandas import DataFrame

        rows = [
            {
                "effect": cause["effect"],
                "form": cause["form"],
                "probability": cause["probability"],
                "share": cause["share"],
                "parameter": name,
                "value": quantity["value"],
                "low_95": quantity["ci95"][0],
                "high_95": quantity["ci95"][1],
                "unit": quantity["unit"],
            }
            for cause in self.to_dict()["causes"]
            for name, quantity in cause["parameters"].items()
        ]
        return DataFrame(rows)

    def plot(self, kind: str | None = None) -> Figure:
        """Draw the diagnosis.

        Parameters
        ----------
        kind : str, optional
            ``before-after`` (the default), ``gap-map`` or ``gap-by-covariate-<channel>``, where the data allow it.
        """
        from calib.report.figures.gap_files import gap_pictures

        figures = gap_pictures(self)
        figure: Figure = _chosen(figures, "before-after" if kind is None and "before-after" in figures else kind)
        return figure


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plan(_Shown):
    """The runs to drive next.

    Parameters
    ----------
    campaign : Campaign
        What was driven.
    verdict : Verdict
        What it says so far.
    runs : tuple of PlannedRunAdvice
        Best first.
    """

    campaign: Campaign
    verdict: Verdict
    runs: tuple[PlannedRunAdvice, ...]

    @property
    def table(self) -> DataFrame:
        """The runs as a table, best first."""
        from pandas import DataFrame

        return DataFrame([run.to_dict() for run in self.runs])

    def _content(self) -> Sequence[Block | Section]:
        from calib.report.statements.diagnosis import verdict_notice
        from calib.report.statements.plan import next_runs_table

        return (verdict_notice(self.verdict), next_runs_table([run.to_dict() for run in self.runs]))

    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain values: what ``calib plan --json`` prints."""
        document = self.verdict.to_dict()
        return {
            "verdict": document["verdict"],
            "indistinguishable": document["indistinguishable"],
            "next_runs": [run.to_dict() for run in self.runs],
        }

    def plot(self) -> Figure:
        """Draw which effects the runs driven so far tell apart."""
        from calib.gap.plan.outlook import outlook_of
        from calib.report.figures.plan import plan_matrix

        return plan_matrix(outlook_of(self.campaign))


class Simulation(_Shown, motion_run.Simulation):
    """A simulation; see `calib.motion.studies.run.Simulation`."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the simulation as plain values: what ``calib simulate --json`` prints."""
        return self.document()

    @property
    def table(self) -> DataFrame:
        """The end of every vehicle's drive as a table; SI units."""
        from pandas import DataFrame

        rows = [{"figure": name, **row} for name, sweep in self.sweeps.items() for row in sweep.ends()]
        return DataFrame(rows)

    def _content(self) -> Sequence[Block | Section]:
        from calib.report.statements.simulation import simulation_content

        return simulation_content(self)

    def plot(self, kind: str | None = None) -> Figure:
        """Draw the paths and errors of one of `sweeps`.

        Parameters
        ----------
        kind : str, optional
            Its name; the first one without.
        """
        from calib.motion.studies.run import SHOWN
        from calib.report.figures.motion import sweep_figure

        name = _chosen({name: name for name in self.sweeps}, kind)
        return sweep_figure(self.sweeps[name], error=SHOWN.get(name, "lateral_m"), title=self.title)


class Replay(_Shown, motion_replay.Replay):
    """Logged runs replayed; see `calib.motion.studies.replay.Replay`."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the replay as plain values: what ``calib simulate --replay --json`` prints."""
        return self.document()

    @property
    def table(self) -> DataFrame:
        """The runs as a table: end errors by each odometry; SI units."""
        from pandas import DataFrame

        return DataFrame(self.document()["runs"])

    def _content(self) -> Sequence[Block | Section]:
        from calib.report.statements.replay import replay_content

        return replay_content(self)

    def plot(self) -> Figure:
        """Draw the end errors of each odometry."""
        from calib.report.figures.motion import replay_figure

        return replay_figure(self)
