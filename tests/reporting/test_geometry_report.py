"""Report on a geometry: a perfect calibration looks perfect, an imperfect one does not; what the pages say."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.api import report
from calib.campaign import write_campaign
from calib.campaign.model import Campaign
from calib.cli.main import run as calib
from calib.kinematics.assemble import traces_of
from calib.kinematics.estimate import estimate_geometry
from calib.kinematics.result import Geometry, RunTrace
from calib.reporting import Facts, Notice, Picture
from calib.reporting.content import Report, report_without_law
from calib.reporting.topics.geometry import geometry_sections, parameter_table
from tests.kinematics.campaigns import Leg, Truth, campaign, square

#: noise of the reference
SIGMA_M, SIGMA_RAD = 5e-4, 5e-4
TRUTH = Truth(sensor=(0.15, -0.03, 0.2), delay_s=0.05)


@pytest.fixture(scope="module")
def along() -> Campaign:
    """Six free recordings by a sensor well off the axle, turned and late."""
    rng = np.random.default_rng(1)
    legs: list[list[Leg]] = [[(1.0, turn) for turn in rng.uniform(-1.5, 1.5, 16)] for _ in range(6)]
    routes = [("free", one) for one in legs]
    return campaign(routes, TRUTH, rng, sigma=(SIGMA_M, SIGMA_RAD), along=True, samples=400)


@pytest.fixture(scope="module")
def squares() -> Campaign:
    rng = np.random.default_rng(2)
    routes = [(f"square{sense}", square(2.0, sense)) for sense in (1, -1) for _ in range(6)]
    return campaign(routes, Truth(), rng, sigma=(SIGMA_M, SIGMA_RAD))


@pytest.fixture(scope="module")
def estimated(along: Campaign) -> Geometry:
    found = estimate_geometry(along, using="windows")
    return replace(found, paths=traces_of(along, found))


def rms(traces: tuple[RunTrace, ...], channel: int, *, before: bool = False) -> float:
    left = np.concatenate([trace.residual_before if before else trace.residual_after for trace in traces])
    return float(np.sqrt(np.nanmean(left[:, channel] ** 2)))


def test_a_perfect_calibration_looks_perfect(estimated: Geometry) -> None:
    """What is left along the way is the reference's own noise: of the sensor, at its time, laid on the reference."""
    assert rms(estimated.paths, 0) == pytest.approx(SIGMA_M, rel=0.15)
    assert rms(estimated.paths, 1) == pytest.approx(SIGMA_M, rel=0.15)
    assert rms(estimated.paths, 2) == pytest.approx(SIGMA_RAD, rel=0.15)
    assert rms(estimated.paths, 0, before=True) > 20.0 * SIGMA_M


def test_the_path_of_the_axle_does_not(along: Campaign, estimated: Geometry) -> None:
    """Without the sensor's place the same radii leave centimetres: the figure can fail."""
    shifted = tuple(replace(one, value=0.0) if one.name.startswith("sensor") else one for one in estimated.estimates)
    assert rms(traces_of(along, replace(estimated, estimates=shifted)), 1) > 10.0 * SIGMA_M


def report_on(driven: Campaign) -> Report:
    found = estimate_geometry(driven, using="windows" if "ref_x_m" in driven.logs.columns else None)
    return report_without_law(
        driven,
        issued="2026-01-01",
        why="no distance",
        geometry=replace(found, paths=traces_of(driven, found)),
        coefficients=b"{}",
    )


@pytest.mark.parametrize(("name", "residuals"), [("along", "in-time"), ("squares", "by-run")])
def test_pages_hold_verdict_residuals_paths_and_correlation(
    name: str, residuals: str, request: pytest.FixtureRequest
) -> None:
    pages = report_on(request.getfixturevalue(name))
    blocks = [block for section in pages.sections for block in section.blocks]
    notice = next(block for block in blocks if isinstance(block, Notice))
    assert notice.title == "Geometry calibrated" and "held-out" in notice.text
    facts = next(dict(block.rows) for block in blocks if isinstance(block, Facts))
    assert set(facts) == {"Drive", "Runs", "Intervals", "Not determined", "Outliers"}
    pictures = [block for block in blocks if isinstance(block, Picture)]
    assert [one.name for one in pictures] == [
        "geometry-paths",
        f"geometry-residuals-{residuals}",
        "geometry-correlation",
    ]
    for one in pictures:
        assert one.draw().axes
    # the caption says what is drawn alone: a path by the reference where it follows the vehicle, else its ends
    assert ("dotted" in pictures[0].caption) == (name == "along")
    assert ("in blue, its end coloured" in pictures[0].caption) == (name == "squares")
    assert {line.get_linestyle() for line in pictures[0].draw().axes[0].lines} >= {":" if name == "along" else "None"}
    assert [one.name for one in pages.attachments] == ["geometry.json", "coefficients.json"]


def test_a_scale_that_closed_squares_do_not_see_is_held_and_has_no_interval() -> None:
    """All lengths 3 % larger close as well: radii and track are no results, what they are to each other is."""
    larger = Truth(radius_left_m=1.03 * 0.0505, radius_right_m=1.03 * 0.0498, track_m=1.03 * 0.412)
    routes = [(f"square{sense}", square(2.0, sense)) for sense in (1, -1) for _ in range(6)]
    found = estimate_geometry(campaign(routes, larger, np.random.default_rng(2), sigma=(SIGMA_M, SIGMA_RAD)))
    assert found.to_dict()["held"]["mean_radius_m"] == 0.05
    rows = {row[0]: row for row in parameter_table(found).rows}
    for name in ("radius left", "radius right", "track"):
        assert rows[name][4:6] == ("", "held with the mean")
    truths = {"right_over_left": 0.0498 / 0.0505, "track_over_radius": 0.412 / (0.5 * (0.0498 + 0.0505))}
    for name, truth in truths.items():
        low, high = found.to_dict()["ratios"][name]["ci95"]
        assert low - 1e-4 * truth < truth < high + 1e-4 * truth and high - low < 0.01 * truth
        assert "to" in rows[name.replace("_", " ")][5]
    # where the ways do not close nothing is held
    routes = [("free", [(2.0, 0.0), (0.0, 1.0), (1.5, 0.0)])] * 4 + [
        ("back", [(2.0, 0.0), (0.0, -1.0), (1.5, 0.0)])
    ] * 4
    found = estimate_geometry(campaign(routes, Truth(), np.random.default_rng(2), sigma=(SIGMA_M, SIGMA_RAD)))
    assert found.scaled == found.ratios == () and "mean_radius_m" not in found.to_dict()["held"]


@pytest.mark.usefixtures("undrawn", "estimated_once")
def test_runs_without_a_law_give_a_report_of_the_geometry(
    squares: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Command and function write the same PDF, the page too; what follows is named, and that no law is stated.

    Of one geometry, figures left blank: both are the same each time by the tests of their own.
    """
    folder = write_campaign(squares, tmp_path / "c")
    pdf, page = tmp_path / "report.pdf", tmp_path / "report.html"
    assert calib(["report", str(folder), "--into", str(pdf), "--html", str(page), "--date", "2026-01-01"]) == 0
    said = capsys.readouterr().out
    assert "GR-" in said and "calib geometry" in said
    assert pdf.read_bytes().startswith(b"%PDF") and b"geometry.json" in pdf.read_bytes()
    text = page.read_text(encoding="utf-8")
    assert "These runs give no radius law" in text and "radius left" in text
    assert report(folder, tmp_path / "same.pdf", date="2026-01-01").read_bytes() == pdf.read_bytes()


def test_runs_without_an_end_pose_have_no_picture_of_paths_or_residuals(squares: Campaign) -> None:
    """A taped length alone is no end that could be drawn."""
    found = estimate_geometry(squares)
    traces = traces_of(squares, found)
    lone = [
        replace(t, reference_m=t.reference_m * (1.0, np.nan), residual_after=np.nan * t.residual_after) for t in traces
    ]
    for paths, drawn in ((traces, True), (tuple(lone), False)):
        blocks = [block for section in geometry_sections(replace(found, paths=paths), []) for block in section.blocks]
        names = {block.name for block in blocks if isinstance(block, Picture)}
        assert ("geometry-paths" in names) == ("geometry-residuals-by-run" in names) == drawn


def test_a_report_on_slopes_does_not_deny_its_law() -> None:
    """With loads driven the slopes stand in the table, and no sentence says that there is no law."""
    loads = np.tile([[200.0, 250.0], [400.0, 300.0], [600.0, 700.0]], (4, 1))
    routes = [(f"square{sense}", square(2.0, sense)) for sense in (1, -1) for _ in range(6)]
    truth = Truth(slope_left=2e-6, slope_right=-1e-6)
    loaded, bare = (campaign(routes, truth, np.random.default_rng(2), loads=of) for of in (loads, None))
    for driven, denied in ((loaded, False), (bare, True)):
        pages = report_on(driven)
        assert ("These runs give no radius law" in str(pages.sections)) == denied
        assert ("No law of the load" in str(pages.sections)) == denied
        assert ("slope" in str(pages.sections)) == (not denied)


@pytest.mark.usefixtures("undrawn", "estimated_once")
def test_a_doubtful_geometry_has_no_coefficients_without_a_reason(
    along: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reference positions of another sensor in every second run: wrong, reported, status 1, nothing attached."""
    moved = np.repeat(np.arange(len(along.runs)) % 2 * 0.3, np.diff(along.logs.offsets))
    columns = {**along.logs.columns, "ref_x_m": along.logs.columns["ref_x_m"] + moved * along.logs.columns["ref_y_m"]}
    spoilt = replace(along, logs=replace(along.logs, columns=columns))
    folder = write_campaign(spoilt, tmp_path / "c")
    for reason in ([], ["--accept-implausible", "a trial"]):
        pages = ["--into", str(tmp_path / "r.pdf"), "--html", str(tmp_path / "r.html"), "--force"]
        assert calib(["report", str(folder), *pages, *reason, "--json", "-"]) == 1
        document = json.loads(capsys.readouterr().out)
        attached = [one["name"] for one in document["attachments"]]
        assert attached == (["geometry.json", "coefficients.json"] if reason else [])
        # nor does a table give the numbers
        page = (tmp_path / "r.html").read_text(encoding="utf-8")
        assert ("95 % interval" in page, "are not to be used" in page) == (bool(reason), not reason)
