"""The figures: inside their canvas, the same bytes, and for any campaign."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text as Label

from calib.api import simulate
from calib.kinematics.result import RunTrace
from calib.radius.effective import EffectiveRadii
from calib.radius.fit import fit_law
from calib.reporting import Picture
from calib.reporting.content import Report, compose
from calib.reporting.figures import gap as gap_figures
from calib.reporting.figures import marked, named_groups, render, render_all
from calib.reporting.figures.calibration import (
    correlations,
    draw_paths,
    path_deviation,
    regressions,
    residuals,
    runs_by_series,
)
from calib.reporting.figures.studies import replay_figure, sweep_errors_figure, sweep_figure
from calib.reporting.source import Source
from tests.reporting.making import CHANNELS, findings, with_findings


def clipped(figure: Figure) -> list[str]:
    """Texts that reach beyond the figure's edge."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    box = figure.bbox
    found = []
    for label in figure.findobj(Label):
        assert isinstance(label, Label)
        if not label.get_visible() or not label.get_text().strip() or (label.axes and not label.axes.get_visible()):
            continue
        extent = label.get_window_extent(canvas.get_renderer())
        # 1 pixel: anti-aliasing at the edge; ticks outside the axes' limits are not drawn
        if extent.x0 < box.x0 - 1 or extent.x1 > box.x1 + 1 or extent.y0 < box.y0 - 1 or extent.y1 > box.y1 + 1:
            found.append(label.get_text())
    return [text for text in found if text not in undrawn(figure)]


def undrawn(figure: Figure) -> set[str]:
    """Labels of ticks outside their axis' limits."""
    made: set[str] = set()
    for axes in figure.axes:
        for axis, (low, high) in ((axes.xaxis, sorted(axes.get_xlim())), (axes.yaxis, sorted(axes.get_ylim()))):
            made |= {tick.label1.get_text() for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high}
    return made


def radii_like(n: int, sessions: int, *, loads: int, seed: int = 1) -> EffectiveRadii:
    rng = np.random.default_rng(seed)
    load = np.linspace(300, 1100, loads)[np.arange(n) % loads]
    session = np.array([f"_session {k % sessions} of a rather long name" for k in range(n)])
    radius = 0.1 + 1e-6 * (load - 300) + rng.normal(0, 1e-5, n)
    nothing = np.full(n, np.nan)
    return EffectiveRadii(
        run_id=np.array([f"r{k}" for k in range(n)]),
        session=session,
        direction=np.array(["out", "back"])[np.arange(n) % 2],
        load_left_N=load,
        load_right_N=load[::-1].copy(),
        distance_m=np.full(n, 40.0),
        radius_left_m=radius,
        radius_right_m=radius[::-1].copy(),
        std_left_m=np.full(n, 4e-6),
        std_right_m=np.full(n, 4e-6),
        path_left=np.zeros(n),
        path_right=np.zeros(n),
        path_source=np.full(n, "none"),
        amplitude_m=nothing,
        wavelength_m=nothing,
    )


@pytest.mark.parametrize(("n", "sessions", "loads"), [(3, 1, 3), (40, 20, 1), (2100, 9, 7)])
def test_no_text_of_a_figure_is_clipped(n: int, sessions: int, loads: int) -> None:
    """Few runs, many sessions, one load, thousands of runs, names that begin with an underscore."""
    radii = radii_like(n, sessions, loads=loads)
    fit = fit_law(radii, reference_load_N=300.0)
    for figure in (
        runs_by_series(radii),
        regressions(fit.left, fit.right, radii.session),
        path_deviation(radii),
        residuals(fit.left, fit.right, radii.session),
    ):
        assert clipped(figure) == []


def test_the_figures_of_the_sample_are_not_clipped_and_hold_no_pixels(report: Report) -> None:
    for picture in report.pictures:
        figure = picture.draw()
        assert clipped(figure) == [], picture.name
        assert b"<image" not in render(figure, "svg"), picture.name


def small() -> Figure:
    """Return a figure of few runs, made anew."""
    return runs_by_series(radii_like(3, 1, loads=3))


def test_a_figure_is_drawn_to_the_same_bytes() -> None:
    for form in ("svg", "png", "pdf"):
        assert render(small(), form) == render(small(), form), form


def test_the_style_does_not_depend_on_the_users_settings() -> None:
    import matplotlib as mpl

    first = render(small(), "svg")
    with mpl.rc_context({"font.size": 30, "axes.grid": False, "text.parse_math": True, "savefig.bbox": "tight"}):
        assert render(small(), "svg") == first


def test_drawing_needs_no_display_and_no_pyplot() -> None:
    drawing = "calib.reporting.figures.calibration, calib.reporting.figures.gap"
    code = f"import sys, {drawing}; print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_every_picture_has_words_for_those_who_do_not_see_it(source: Source) -> None:
    for one in compose(with_findings(source)).pictures:
        assert isinstance(one, Picture)
        assert len(one.alt) > 20
        assert one.caption.endswith(".")


@pytest.mark.parametrize("n", [1, 4, 400])
def test_no_text_of_a_gap_figure_is_clipped(n: int) -> None:
    _, gap = findings(n=n)
    assert gap.offset_m is not None
    for figure in (
        gap_figures.gap_map(gap.paths_m, gap.offset_m, gap.labels["kind"]),
        gap_figures.gap_by_covariate(
            gap.before[:, 3], "heading", "rad", gap.covariates, noise_level=1e-3, group=gap.labels["kind"]
        ),
        gap_figures.before_after(CHANNELS, gap.before, gap.after, gap.noise_level),
    ):
        assert clipped(figure) == []


def test_arrows_of_the_map_are_magnified_by_the_factor_that_it_says() -> None:
    """An arrow's tip stands at the end position plus the factor times the gap."""
    ends = (np.array([[0.0, 0.0], [10.0, 0.0]]), np.array([[0.0, 0.0], [10.0, 5.0]]))
    offset = np.array([[0.02, 0.01], [0.0, -0.03]])
    figure = gap_figures.gap_map(ends, offset, np.array(["square", "square"]))
    axis = figure.axes[0]
    factor = float(axis.get_title(loc="left").split("arrows ")[1].split(" times")[0])
    arrows = [child for child in axis.texts if getattr(child, "arrow_patch", None) is not None]
    tips = np.array([arrow.xy for arrow in arrows])
    np.testing.assert_allclose(tips, np.array([path[-1] for path in ends]) + factor * offset, rtol=1e-12)
    assert factor > 1


def test_a_map_without_known_gaps_is_still_a_map() -> None:
    figure = gap_figures.gap_map((np.zeros((1, 2)), np.ones((1, 2))), np.full((2, 2), np.nan), np.array(["a", "b"]))
    assert clipped(figure) == []


def test_root_mean_squares_before_and_after_stand_at_the_figure() -> None:
    before, after = np.array([[3e-3], [-4e-3]]), np.array([[1e-3], [np.nan]])
    figure = gap_figures.before_after([("along", "m")], before, after, np.full((2, 1), 1e-3))
    labels = [tick.get_text() for tick in figure.axes[0].get_xticklabels()]
    # sqrt((9 + 16) / 2) = 3.54 mm; NaN is omitted
    assert labels == ["before\nrms 3.54 mm", "after\nrms 1 mm"]


def test_laid_out_once_a_figure_is_the_same_in_every_format() -> None:
    """The SVG as alone; the others by the same places of their axes; the figure keeps its layout engine."""
    figure = path_deviation(radii_like(12, 3, loads=4))
    engine = figure.get_layout_engine()
    forms = render_all(figure, ("png", "svg", "pdf"))
    assert figure.get_layout_engine() is engine
    assert list(forms) == ["png", "svg", "pdf"]
    assert forms["svg"] == render(path_deviation(radii_like(12, 3, loads=4)), "svg")
    assert forms["png"].startswith(b"\x89PNG")
    assert forms["pdf"].startswith(b"%PDF")


def test_long_names_that_end_differently_stay_apart() -> None:
    labels = np.array([f"afternoon_in_the_hot_hall_of_the_plant_in_the_south_{k}" for k in range(4)])
    assert len(set(named_groups(labels, "none").names)) == 4


def test_there_is_no_tick_between_two_runs() -> None:
    radii = radii_like(4, 1, loads=2)
    fit = fit_law(radii, reference_load_N=300.0)
    axes = [runs_by_series(radii).axes[1], residuals(fit.left, fit.right, radii.session).axes[4]]
    for axis in (*axes, path_deviation(radii).axes[1]):
        assert all(float(place).is_integer() for place in axis.get_xticks())


@pytest.mark.parametrize("study", ["asymmetric", "corrected"])
def test_no_legend_of_a_study_is_clipped(study: str) -> None:
    for sweep in simulate(study).sweeps.values():
        assert clipped(sweep_figure(sweep, error="lateral_m", title="")) == []
        assert clipped(sweep_errors_figure(sweep, title="")) == []


def test_decades_are_written_as_numbers() -> None:
    """The style parses no mathematics, so that a name of `$` stays a name: labels of an axis must need none."""
    far = np.array([0.004, 0.03, 0.9])
    errors = SimpleNamespace(along_m=far, lateral_m=far, distance_m=far)
    replay = SimpleNamespace(load_left_N=far, load_right_N=far, errors={"constant": errors, "corrected": errors})
    figure = replay_figure(replay)
    FigureCanvasAgg(figure).draw()
    labels = [label.get_text() for label in figure.axes[1].get_yticklabels(which="both")]
    assert {"0.01", "0.1", "1"} <= set(labels) and not any("$" in label for label in labels)


def test_all_that_paths_of_end_poses_show_is_in_the_legend_and_none_of_it_overlaps() -> None:
    way = np.column_stack((np.linspace(0.0, 5.0, 20), np.zeros(20)))
    ends = np.array([[0.01, 0.02, 0.001]])
    trace = RunTrace("r1", "corridor", way, way, np.array([19]), np.zeros(1), way[-1:], ends, ends)
    figure = marked(draw_paths([trace] * 3), simulated=True)
    assert clipped(figure) == []
    labels = {label.get_text(): label.get_window_extent() for label in figure.findobj(Label) if label.get_text()}
    assert {"odometry before", "odometry after", "reference"} <= labels.keys()
    assert any(label.startswith("odometry after: distance") for label in labels)
    mark = labels.pop("SIMULATED DATA")
    assert not any(mark.overlaps(other) for other in labels.values())


def test_correlations_of_many_parameters_fit_their_cells() -> None:
    """Two digits behind the point, and no zero before it."""
    covariance = np.full((9, 9), -0.1) + 1.1 * np.eye(9)
    for size, shown in ((4, "\u22120.10"), (9, "\u2212.10")):
        figure = correlations([f"p{k}" for k in range(size)], covariance[:size, :size])
        assert {text.get_text() for text in figure.axes[0].texts} == {shown, "1.00"}
