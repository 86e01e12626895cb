from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.coefficients.file import load_coefficients
from calib.radius.fit import fit_campaign
from calib.radius.result import provenance, write_result
from calib.runtime import Odometer

SAMPLE = Path(__file__).parents[2] / "sample_runs" / "corridor"


@pytest.fixture(scope="module")
def campaign(project_root: Path) -> Path:
    return project_root / "sample_runs" / "corridor"


@pytest.fixture(scope="module")
def result(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder as ``calib fit --into`` leaves it."""
    from dataclasses import replace

    read = read_campaign(campaign)
    made = replace(fit_campaign(read), provenance=provenance(read, {}))
    folder = tmp_path_factory.mktemp("result")
    write_result(made, folder, force=True)
    return folder


@pytest.fixture(scope="module")
def coefficients(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("coefficients") / "c.json"
    assert run(["export", str(campaign), "--to", "json", "--date", "2025-03-31", "--output", str(path)]) == 0
    return path


def test_a_campaign_ends_as_a_file_that_the_vehicle_drives_with(campaign: Path, coefficients: Path) -> None:
    """The radii are those of the fit, at the loads of the campaign."""
    law = fit_campaign(read_campaign(campaign)).law
    odometer = Odometer.from_file(coefficients)
    for name, (left, right) in odometer.coefficients.load_table.items():
        odometer.set_load_point(name)
        assert odometer.radii_m == pytest.approx((float(law.left.radius_m(left)), float(law.right.radius_m(right))))
    odometer.set_payload(0.0)  # the unladen vehicle was measured, so it must not be refused for a tenth of a newton
    file = load_coefficients(coefficients)
    assert file.simulated and file.created == "2025-03-31"
    assert {"campaign.toml", "runs.csv"} <= {one.path for one in file.inputs}


def test_campaign_result_folder_and_coefficient_file_give_the_same_bytes(
    campaign: Path, result: Path, coefficients: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = []
    for source in (campaign, result, result / "fit.json", coefficients):
        assert run(["export", str(source), "--to", "json", "--date", "2025-03-31"]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0] == texts[1] == texts[2] == texts[3] == coefficients.read_text(encoding="utf-8")


@pytest.mark.parametrize("to", ["json", "ros2", "c", "csv"])
def test_json_on_standard_output_stands_there_alone(
    coefficients: Path, to: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run(["export", str(coefficients), "--to", to, "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["checksum"] == load_coefficients(coefficients).checksum
    assert run(["export", str(coefficients), "--to", to, "--json", "-", "--output", str(tmp_path / "out")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert all(Path(one["path"]).is_file() for one in told["files"])


def test_nothing_is_replaced_without_force(
    coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "h.h"
    arguments = ["export", str(coefficients), "--to", "c", "--output", str(target)]
    assert run(arguments) == 0
    target.write_text("mine")
    assert run(arguments) == 2
    assert target.read_text() == "mine" and "--force" in capsys.readouterr().err
    assert run([*arguments, "--force"]) == 0
    assert target.read_text() != "mine"


def test_the_rule_outside_the_range_can_be_chosen(coefficients: Path, capsys: pytest.CaptureFixture[str]) -> None:
    far = ["export", str(coefficients), "--to", "ros2", "--load", "4000"]
    assert run(far) == 2
    assert run([*far, "--outside", "clamp"]) == 0
    assert "CLAMPED" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["--to", "xml"],
        ["--to", "json", "--date", "31.03.2025"],
        ["--to", "json", "--outside", "extrapolate"],
        ["--to", "ros2", "--load", "heavy"],
        ["--to", "dcc", "--date", "2025-03-31"],
        ["--to", "nav2", "--open-loop"],
        ["--to", "json", "--left", "left"],
        [],
    ],
)
def test_bad_arguments_end_in_one_line_and_status_2(
    coefficients: Path, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["export", str(coefficients), *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and len(captured.err.splitlines()) == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_json_that_cannot_be_written_ends_in_one_line(
    coefficients: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is assumed is no second line beside the error."""
    assert run(["export", str(coefficients), "--to", "json", "--json", "/dev/full"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert run(["export", str(coefficients), "--to", "json", "--json", str(tmp_path / "y.json")]) == 0
    assert "assumed, not measured" in capsys.readouterr().err


@pytest.mark.parametrize("content", [None, "", "{}", '{"format": "calib-coefficients/1"}', '{"format": "calib-fit/1"}'])
def test_a_source_that_is_none_ends_in_one_line_and_status_2(
    tmp_path: Path, content: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "x.json"
    if content is not None:
        source.write_text(content)
    assert run(["export", str(source), "--to", "json"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_header_of_a_campaign_compiles(coefficients: Path, tmp_path: Path) -> None:
    import shutil

    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    assert run(["export", str(coefficients), "--to", "c", "--output", str(tmp_path / "c.h")]) == 0
    (tmp_path / "m.c").write_text('#include "c.h"\nint main(void) { return 0; }\n')
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "m.c", "-o", "m", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", "--help"]) == 0
    assert "Example: calib export" in capsys.readouterr().out


def test_each_format_says_what_to_do_next() -> None:
    from calib.coefficients.formats import FORMATS
    from calib.reporting import next_step
    from calib.reporting.exports import FORMATS as FROM_CAMPAIGNS

    for name in (*FORMATS, *FROM_CAMPAIGNS):
        assert next_step(f"export {name}", c="campaign", file=Path("a file")).startswith("Next: ")


@pytest.mark.parametrize("to", ["json", "mjcf", "urdf", "sdf", "c_effects"])
def test_a_file_of_coefficients_is_not_said_to_be_diagnosed(to: str) -> None:
    """A diagnosis takes a campaign: where the source is none, the next step leaves its name open."""
    from calib.reporting import next_step

    assert "diagnose CAMPAIGN" in next_step(f"export {to}", c=Path("coefficients.json"), file=Path("file"))
    assert f"diagnose {SAMPLE}" in next_step(f"export {to}", c=SAMPLE, file=Path("file"))


def test_an_unknown_format_is_answered_with_all_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    """Before the source is looked for."""
    assert run(["export", "absent", "--to", "yaml"]) == 2
    error = capsys.readouterr().err
    assert all(name in error for name in ("json", "ros2", "dcc", "mcap", "nav2"))
    assert run(["export", "absent", "--to", "dcc", "--load", "500"]) == 2
    assert "--load: found it with 'dcc'" in capsys.readouterr().err
