"""What a report says."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.campaign.model import Campaign
from calib.campaign.read import read_campaign
from calib.errors import BadFileError, CalibError
from calib.radius.fit import fit_campaign
from calib.radius.result import Fit, write_result
from calib.reporting import Facts, Items, Notice, Section, Table, Text, catalogue
from calib.reporting.content import PAGES, Report, compose
from calib.reporting.source import OPTIONAL, STATED, Source, issue_date, opened, source_of
from calib.reporting.topics.fit import residuals_picture, result_section, usable_notice
from calib.reporting.topics.report import (
    MOST_NOTES,
    coefficients_section,
    deviation_section,
    method_section,
    regression_section,
)
from calib.vehicle import Drive


def words(section: Section) -> str:
    """All that a section says, as one text."""
    parts: list[str] = [section.title]
    for block in section.blocks:
        said = block.to_dict()
        parts += [str(said.get(key, "")) for key in ("title", "text", "caption", "alt")]
        if isinstance(block, Items):
            parts += block.sentences
        if isinstance(block, Facts):
            parts += [cell for row in block.rows for cell in row]
        if isinstance(block, Table):
            parts += [column.title for column in block.columns] + [cell for row in block.rows for cell in row]
    return "\n".join(parts)


def everything(report: Report) -> str:
    facts = [" ".join(fact) for fact in (*report.head, *report.signatures)]
    return "\n".join([report.title, *facts, *map(words, report.sections)])


def section(report: Report, title: str) -> Section:
    return next(one for one in report.sections if one.title == title)


def test_a_report_has_what_a_calibration_report_must_carry(report: Report) -> None:
    """ISO/IEC 17025, 7.8.2 and 7.8.4: identification, item, method, conditions, results, decision rule, limits."""
    titles = [one.title for one in report.sections]
    for needed in ("Result", "Item", "Method", "Instruments and conditions", "Runs", "Regression on load",
                   "Path deviation", "Residual checks", "Coefficients", "Uncertainty budget", "Decision rule",
                   "What this report does not cover", "Files"):  # fmt: skip
        assert needed in titles
    assert {"Report", "Date of issue"} <= set(dict(report.head))
    # what the campaign does not state is asked for once, as a list to be filled in
    missing = next(block for block in section(report, "Not stated").blocks if isinstance(block, Table))
    assert {key for key in STATED if key not in OPTIONAL} == {row[1] for row in missing.rows}
    text = everything(report)
    for phrase in ("The results relate only to", "coverage of 95 %", "Student's t", "traceability",
                   "No tolerance on radius or slope was agreed", "may be passed on in full only"):  # fmt: skip
        assert phrase in text, phrase


def test_a_report_never_claims_an_accreditation(report: Report, measured: Source) -> None:
    for one in (report, compose(measured)):
        assert "accredit" not in everything(one).lower()


def test_every_page_of_the_registry_speaks(report: Report) -> None:
    """Of a campaign that was not imported and without a diagnosis all pages but these have something to say."""
    assert len(report.sections) == len(PAGES) - 2


def test_what_the_import_did_stands_in_the_report(campaign: Campaign, tmp_path: Path) -> None:
    """From the record that the import leaves in the campaign, where a result folder is reported, too."""
    notes = [{"where": f"log{k}.csv", "text": f"{k} repeated samples removed"} for k in range(MOST_NOTES + 2)]
    (tmp_path / "ingest.json").write_text(json.dumps({"sources": [], "notes": notes}), encoding="utf-8")
    source = source_of(replace(campaign, root=tmp_path), issued="2025-03-31")
    write_result(source.fit, tmp_path / "result")
    again = source_of(opened(tmp_path / "result"), issued="2025-03-31")
    for one in (source, again):
        text = words(section(compose(one), "Preparation of the data"))
        assert "log3.csv: 3 repeated samples removed" in text
        assert "and 2 more, in ingest.json" in text
    (tmp_path / "ingest.json").write_text('{"notes": 3}', encoding="utf-8")
    with pytest.raises(BadFileError, match=r"ingest\.json"):
        source_of(replace(campaign, root=tmp_path), issued="2025-03-31")


@pytest.mark.parametrize(("drive", "wheels"), [("tricycle", "the free rear"), ("differential", "the two driven")])
def test_a_wheel_is_driven_where_the_drive_drives_it(campaign: Campaign, drive: Drive, wheels: str) -> None:
    other = replace(campaign, vehicle=replace(campaign.vehicle, drive=drive))
    assert f"the encoders of {wheels} wheels" in words(
        section(compose(source_of(other, issued="2025-03-31")), "Method")
    )


def test_coefficients_are_those_of_the_fit_with_k_from_students_t(report: Report, source: Source) -> None:
    from scipy.stats import t

    table = next(block for block in section(report, "Coefficients").blocks if isinstance(block, Table))
    for (wheel, fit), rows in zip(source.fit.wheels.items(), (table.rows[:2], table.rows[2:]), strict=True):
        assert rows[0][0] == wheel
        values = (1e3 * fit.law.radius_ref_m, 1e6 * fit.law.slope_m_per_N)
        stds = np.array([1e3, 1e6]) * np.sqrt(np.diag(fit.law.covariance))
        for row, value, std, dof in zip(rows, values, stds, (fit.dof_radius_ref, fit.dof_slope), strict=True):
            shown = [float(cell.strip().replace("−", "-")) for cell in row[3:]]
            # atol: half of the last printed digit
            np.testing.assert_allclose(shown[0], value, rtol=0, atol=0.5 * 10.0 ** -decimals(row[3]) * 1.001)
            np.testing.assert_allclose(shown[1], std, rtol=0.051)  # two significant digits
            np.testing.assert_allclose(shown[3], t.ppf(0.975, dof), rtol=0, atol=0.0051)  # two decimals
            np.testing.assert_allclose(shown[4], t.ppf(0.975, dof) * std, rtol=0.051)  # two significant digits


def test_each_range_of_loads_is_said_for_what_it_is(source: Source) -> None:
    """Loads measured of each wheel; the valid range as the attached file has it."""
    left, right = source.fit.left, source.fit.right
    on = right.load_N < 950.0
    runs = {name: getattr(right, name)[on] for name in ("load_N", "radius_m", "residual_m", "leverage", "cook")}
    uneven = replace(source, fit=replace(source.fit, right=replace(right, **runs)))
    result = words(result_section(uneven))
    assert f"{left.load_N.min():.0f} to {left.load_N.max():.0f} N (left wheel)" in result
    assert f"{runs['load_N'].min():.0f} to {runs['load_N'].max():.0f} N (right wheel)" in result
    coefficients = words(coefficients_section(source))
    valid = source.coefficients.wheels.left.valid_load
    assert f"{valid.min.value:.1f} to {valid.max.value:.1f} N (left)" in coefficients
    assert f"measured at {left.load_N.min():.1f} to {left.load_N.max():.1f} N" in coefficients


def decimals(text: str) -> int:
    return len(text.strip().partition(".")[2])


def test_uncertainties_have_two_significant_digits(report: Report) -> None:
    table = next(block for block in section(report, "Coefficients").blocks if isinstance(block, Table))
    for row in table.rows:
        for cell in (row[4], row[7]):
            assert len(re.sub(r"^0*", "", cell.strip().replace(".", ""))) == 2, cell


def test_every_run_of_the_fit_stands_in_the_table(report: Report, source: Source) -> None:
    table = next(block for block in section(report, "Runs").blocks if isinstance(block, Table))
    assert [row[0] for row in table.rows] == source.fit.radii.run_id.tolist()


def test_a_long_campaign_is_told_by_session(source: Source) -> None:
    """Thousands of runs do not become dozens of pages; the sessions' counts add up to all runs."""
    radii = source.fit.radii
    n = 5 * len(radii)
    arrays = {
        name: np.tile(getattr(radii, name), 5)
        for name in radii.__slots__
        if isinstance(getattr(radii, name), np.ndarray)
    }
    wheels = {
        name: replace(wheel, residual_m=np.tile(wheel.residual_m, 5), load_N=np.tile(wheel.load_N, 5),
                      radius_m=np.tile(wheel.radius_m, 5))
        for name, wheel in source.fit.wheels.items()
    }  # fmt: skip
    long = replace(source, fit=replace(source.fit, radii=replace(radii, **arrays), **wheels))
    table = next(block for block in section(compose(long), "Runs").blocks if isinstance(block, Table))
    assert table.columns[0].title == "Session"
    assert sum(int(row[1]) for row in table.rows) == n


def test_every_check_ends_in_its_sentence(report: Report, source: Source) -> None:
    text = words(section(report, "Residual checks"))
    for wheel in source.fit.wheels.values():
        for check in wheel.checks:
            assert check.sentence.split(":")[0].split(" um")[0] in text


def test_a_failed_check_is_said_on_the_first_page(source: Source) -> None:
    left = source.fit.left
    checks = tuple(replace(check, level="failed") if check.name == "curvature" else check for check in left.checks)
    failed = compose(replace(source, fit=replace(source.fit, left=replace(left, checks=checks))))
    notice = next(block for block in section(failed, "Result").blocks if isinstance(block, Notice))
    assert notice.level == "bad"
    assert "left wheel, curvature" in notice.text
    assert not failed.passed


def test_what_the_campaign_states_is_carried_over(campaign: Campaign) -> None:
    keys = [key for key in STATED if key != "logo"]
    stated = {key: f"text of {key}" for key in keys} | {"instruments": ["laser, certificate 1", "scale, certificate 2"]}
    made = compose(source_of(replace(campaign, extra={"report": stated}), issued="2025-03-31"))
    text = everything(made)
    for key in keys:
        assert (f"text of {key}" if key != "instruments" else "laser, certificate 1; scale, certificate 2") in text, key
    assert "not stated" not in text
    # a default that no result depends on is nothing stated
    assert "permissible wheel load" not in text
    assert made.to_dict()["author"] == "text of laboratory"


@pytest.mark.parametrize("section", [{"costumer": "X"}, {"customer": {"name": "X"}}, "X"])
def test_a_report_section_that_cannot_be_used_is_refused(campaign: Campaign, section: object) -> None:
    with pytest.raises(CalibError, match="report"):
        source_of(replace(campaign, extra={"report": section}), issued="2025-03-31")


def test_the_identification_follows_the_inputs_alone(source: Source, campaign: Campaign) -> None:
    """Same inputs, same identification, for any date; a changed input file changes it."""
    assert source_of(campaign, issued="2031-01-01").report_id == source.report_id
    hashes = {**campaign.hashes, "runs.csv": "0" * 64}
    assert source_of(replace(campaign, hashes=hashes), issued=source.issued).report_id != source.report_id
    assert source.report_id in dict(compose(source).head)["Report"]


def test_the_example_is_the_report_of_this_version(project_root: Path) -> None:
    """Its identification follows inputs, version and coefficients; `reports/README.md` has the command to make it."""
    made = source_of(read_campaign(project_root / "sample_runs" / "corridor_crossed"), issued="2025-03-31")
    example = (project_root / "reports" / "example" / "corridor_crossed.pdf").read_bytes()
    assert made.report_id.encode() in example


def test_simulated_data_are_marked_and_measured_ones_are_not(report: Report, measured: Source) -> None:
    assert report.to_dict()["simulated"] is True
    assert compose(measured).to_dict()["simulated"] is False


@pytest.mark.parametrize("text", ["2025-3-1", "31.03.2025", "2025-02-30", "today", "", "20250331", "0001-01-01"])
def test_a_date_of_issue_is_a_real_day(text: str) -> None:
    with pytest.raises(CalibError, match="YYYY-MM-DD"):
        issue_date(text)


def test_texts_never_speak_as_terminals_do(report: Report) -> None:
    """Units and signs are those of print: no ``um``, no hyphen for minus, no ``S_O``."""
    text = everything(report)
    for pattern in (r"\bum\b", r"\bS_O\b", r"\bdegC\b", r"(?<![\w.])-\d"):
        found = [line for line in text.splitlines() if re.search(pattern, line) and "sha256" not in line]
        assert not found, (pattern, found[:3])


def test_rows_and_columns_agree() -> None:
    with pytest.raises(ValueError, match="2 cells in a row of 1 columns"):
        from calib.reporting import Column

        Table("t", (Column("a"),), (("1", "2"),))


def test_text_blocks_are_plain_values() -> None:
    assert Text("a").to_dict() == {"kind": "text", "text": "a", "small": False}


def test_what_nobody_stated_stands_in_the_report(source: Source) -> None:
    """Small assumptions beside the instruments; those that every result scales with on the first page, too."""
    assert source.fit.setup is not None
    told = "none is assumed"
    assert told in words(section(compose(source), "Instruments and conditions"))
    assumed = {"rangefinder.sigma_m": "0.0015", "vehicle.track_m": "0.7"}
    fit = replace(source.fit, setup=replace(source.fit.setup, assumed=assumed))
    report = compose(replace(source, fit=fit))
    conditions, first = words(section(report, "Instruments and conditions")), words(section(report, "Result"))
    assert "rangefinder.sigma_m = 0.0015, vehicle.track_m = 0.7" in conditions
    assert "as stated by the campaign where none is assumed" in conditions
    assert "vehicle.track_m = 0.7" in first
    assert "rangefinder.sigma_m" not in first


def test_assumptions_survive_the_result_folder(source: Source) -> None:
    """A report on a result folder has no campaign to ask."""
    assert source.fit.setup is not None
    fit = replace(source.fit, setup=replace(source.fit.setup, assumed={"vehicle.track_m": "0.7"}))
    again = Fit.from_dict(fit.to_dict())
    assert again.setup is not None
    assert dict(again.setup.assumed) == {"vehicle.track_m": "0.7"}


def test_page_one_agrees_with_the_diagnosis_of_radii_that_follow_the_temperature(project_root: Path) -> None:
    """The yard's radii follow the temperature: `calib diagnose` names it, and the law alone is not called usable."""
    fit = fit_campaign(read_campaign(project_root / "sample_runs" / "yard"))
    notice = usable_notice(fit)
    assert notice.level == "bad"
    assert notice.title == "The law is doubtful"
    assert "temperature" in notice.text


def test_every_sentence_of_the_catalogue_is_used(project_root: Path) -> None:
    """What no page, certificate or line of the terminal names is dead text; rules and pictures are named by parts."""
    code = "".join(path.read_text(encoding="utf-8") for path in (project_root / "calib").rglob("*.py"))
    for section in ("report", "caption"):
        parts = {name: name.removeprefix("decision_").removeprefix("fleet-") for name in catalogue()[section]}
        assert {name for name, part in parts.items() if f'"{name}"' not in code and f'"{part}"' not in code} == set()


def test_path_and_slope_are_told_as_they_were_had(source: Source) -> None:
    """A path that nothing told is not corrected; two wheels' designs that differ are told by wheel."""
    radii, left = source.fit.radii, source.fit.left
    told = words(deviation_section(source))
    assert f"{len(radii)} of the {len(radii)} runs are corrected" in told
    none = replace(radii, path_source=np.full(len(radii), "none"), path_left=0 * radii.path_left)
    untold = words(deviation_section(replace(source, fit=replace(source.fit, radii=none))))
    assert f". 0 of the {len(radii)} runs are corrected" in untold
    apart = replace(source.fit, left=replace(left, design="mixed"))
    method = words(method_section(replace(source, fit=apart)))
    assert "Left wheel: The slope combines" in method
    assert "Right wheel: The slope comes from" in method
    assert "wheel: The slope" not in words(method_section(source))


def test_the_table_of_the_law_has_the_ends_of_the_measured_loads(source: Source) -> None:
    wheels = (replace(one, load_N=np.clip(one.load_N, 301.0, 1097.0)) for one in source.fit.wheels.values())
    fit = replace(source.fit, **dict(zip(("left", "right"), wheels, strict=True)))
    shown = next(one for one in regression_section(replace(source, fit=fit)).blocks if isinstance(one, Table))
    assert [row[0] for row in shown.rows] == ["301", *map(str, range(400, 1100, 100)), "1097"]


def test_the_residuals_of_one_session_promise_no_colours_of_sessions(source: Source) -> None:
    fit, radii = source.fit, source.fit.radii
    alone = replace(fit, radii=replace(radii, session=np.full_like(radii.session, "s1")))
    assert "sessions as above" in residuals_picture(fit).caption
    assert "sessions" not in residuals_picture(alone).caption
