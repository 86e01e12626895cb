"""``calib report`` from the command line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from calib.campaign.read import read_campaign
from calib.cli.main import run
from calib.radius.fit import fit_campaign
from calib.radius.result import provenance, write_result

DATE = ["--date", "2025-03-31"]


@pytest.fixture(scope="module")
def sample(project_root: Path) -> Path:
    return project_root / "sample_runs" / "corridor_crossed"


@pytest.mark.usefixtures("undrawn")
def test_it_writes_where_it_says(
    sample: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without --into the PDF is reports/<campaign>.pdf of the working directory; a second time needs --force."""
    monkeypatch.chdir(tmp_path)
    assert run(["report", str(sample), *DATE]) == 0
    out = capsys.readouterr().out
    assert str(Path("reports") / "corridor_crossed.pdf") in out
    first = (tmp_path / "reports" / "corridor_crossed.pdf").read_bytes()
    assert first.startswith(b"%PDF")
    assert run(["report", str(sample), *DATE]) == 2
    assert "--force" in capsys.readouterr().err
    assert run(["report", str(sample), *DATE, "--force"]) == 0
    assert (tmp_path / "reports" / "corridor_crossed.pdf").read_bytes() == first


@pytest.mark.usefixtures("undrawn")
def test_a_result_folder_gives_the_same_report_as_its_campaign(
    sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Same identification, same sections: the result folder holds all that is said."""
    stated = shutil.copytree(sample, tmp_path / "stated")
    with (stated / "campaign.toml").open("a", encoding="utf-8") as stream:
        stream.write('\n[report]\ncustomer = "Example Ltd, 1 Long Road"\nmeasured = [2025-03-03, 2025-03-05]\n')
    read = read_campaign(stated)
    fit = fit_campaign(read)
    write_result(replace(fit, provenance=provenance(read, {})), tmp_path / "result")
    said = []
    for source, name in ((stated, "a.pdf"), (tmp_path / "result", "b.pdf")):
        assert run(["report", str(source), "--into", str(tmp_path / name), *DATE, "--json", "-"]) == 0
        captured = capsys.readouterr()
        document = json.loads(captured.out)
        assert document.pop("file") == str(tmp_path / name)
        assert document["simulated"] is True
        said.append(document)
    assert said[0] == said[1]
    assert ["Customer", "Example Ltd, 1 Long Road"] in said[0]["head"]
    assert ["Dates of measurement", "2025-03-03; 2025-03-05"] in said[0]["head"]


@pytest.mark.usefixtures("files_alone", "undrawn")
def test_figures_go_where_asked(sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["report", str(sample), "--into", str(tmp_path), "--figures", str(tmp_path / "figures"), *DATE]) == 0
    assert (tmp_path / "corridor_crossed.pdf").is_file()
    names = {path.suffix for path in (tmp_path / "figures").iterdir()}
    assert names == {".png", ".svg", ".pdf"}
    assert "figure files" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "a campaign folder or a result folder"),
        (["SAMPLE", "--date", "31.3.2025"], "YYYY-MM-DD"),
        (["SAMPLE", "--into", "SAMPLE/runs.csv"], "ending in .pdf"),
        (["SAMPLE/runs.csv"], ""),
    ],
)
def test_bad_input_is_one_line(
    sample: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["report", *(text.replace("SAMPLE", str(sample)) for text in arguments)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert said in captured.err


def test_a_name_becomes_a_file_name_inside_the_folder() -> None:
    from calib.reporting.content import file_name

    assert file_name("corridor") == "corridor.pdf"
    for name in ("../../etc/passwd", "a/b\\c", "...", "", " ", "x" * 500, "#$*<>|"):
        made = file_name(name)
        assert "/" not in made
        assert "\\" not in made
        assert not made.startswith(".")
        assert made.endswith(".pdf")
        assert len(made) <= 84


def test_a_diagnosis_needs_the_campaign(sample: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read = read_campaign(sample)
    fit = fit_campaign(read)
    write_result(replace(fit, provenance=provenance(read, {})), tmp_path / "result")
    assert run(["report", str(tmp_path / "result"), "--into", str(tmp_path), "--diagnosis"]) == 2
    assert "campaign folder" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_runs_without_a_law_give_a_report_of_geometry_and_diagnosis(
    project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Loops alone: no effective radius, but radii and track together, and with --diagnosis the gap."""
    loops = shutil.copytree(project_root / "sample_runs" / "yard", tmp_path / "loops")
    rows = (loops / "runs.csv").read_text(encoding="utf-8").splitlines()
    kept = [row for number, row in enumerate(rows) if number == 0 or "corridor" not in row]
    (loops / "runs.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    target = tmp_path / "loops.pdf"
    options = ["--into", str(target), *DATE, "--json", "-", "--force"]
    assert run(["report", str(loops), *options]) == 0
    titles = [section["title"] for section in json.loads(capsys.readouterr().out)["sections"]]
    own = ["Result", "Residuals", "Correlation of the parameters"]
    assert titles == [*own, "Radius law", "What this report does not cover", "Not stated"]
    assert run(["report", str(loops), "--diagnosis", *options]) == 0
    titles = [section["title"] for section in json.loads(capsys.readouterr().out)["sections"]]
    assert titles == [*own, "Diagnosis of the gap", "Radius law", "What this report does not cover", "Not stated"]
    assert target.read_bytes().startswith(b"%PDF")
    assert b"diagnosis.json" in target.read_bytes()
    assert str(tmp_path).encode() not in target.read_bytes()
