"""What was read is kept while its bytes, its settings and calib stay the same, and while the kept line is whole."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.errors import BadInputError
from calib.fleet import store
from calib.fleet.run import fit_fleet, survey_fleet
from calib.fleet.store import SUMS
from calib.io import sha256_file
from calib.reporting.pages import write_fleet

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Two vehicles, each a campaign folder with logs."""
    for vehicle in ("v1", "v2"):
        shutil.copytree(ROOT / "sample_runs" / "corridor_crossed", tmp_path / "fleet" / vehicle)
    return tmp_path / "fleet"


def _same_time(path: Path, change: Callable[[str], str]) -> None:
    """Change a file's text, and neither its size nor its times."""
    before = path.stat()
    text = path.read_text()
    path.write_text(change(text))
    assert path.read_text() != text
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size


def _radius(text: str) -> str:
    """Return settings with another radius of as many digits."""
    pattern = r"(wheel_radius_m = 0\.\d*?)(\d)\b"
    return re.sub(pattern, lambda found: f"{found[1]}{(int(found[2]) + 1) % 10}", text, count=1)


def _last_digit(text: str) -> str:
    """Return a table whose last digit is another."""
    at = max(number for number, sign in enumerate(text) if sign.isdigit())
    return f"{text[:at]}{(int(text[at]) + 1) % 10}{text[at + 1 :]}"


@pytest.mark.parametrize("what", ["fit", "check"])
@pytest.mark.parametrize(
    ("file", "change"), [("campaign.toml", _radius), ("runs.csv", _last_digit), ("log", _last_digit)]
)
def test_a_corrected_file_is_read_again(
    what: str, file: str, change: Callable[[str], str], fleet: Path, tmp_path: Path
) -> None:
    """Settings, run table and log, of the same size and time; the other vehicle's are kept."""

    def run() -> tuple[int, int]:
        if what == "fit":
            fitted = fit_fleet(fleet, tmp_path / "out")
            return fitted.n_read, fitted.n_kept
        survey = survey_fleet(fleet, tmp_path / "out", what)
        return survey.n_done, survey.n_kept

    assert run() == (2, 0)
    assert run() == (0, 2)
    path = next((fleet / "v1").rglob("logs/*.csv")) if file == "log" else fleet / "v1" / file
    _same_time(path, change)
    assert run() == (1, 1)


def test_a_new_time_alone_reads_nothing_again(fleet: Path, tmp_path: Path) -> None:
    """Restored copies have other times and the same bytes."""
    fit_fleet(fleet, tmp_path / "out")
    for path in fleet.rglob("*.csv"):
        os.utime(path, (0, 0))
    assert fit_fleet(fleet, tmp_path / "out").n_read == 0


def test_another_version_reads_anew(fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit_fleet(fleet, tmp_path / "out")
    monkeypatch.setattr(store, "VERSION", "0.0.1")
    assert fit_fleet(fleet, tmp_path / "out").n_read == 2


def test_a_kept_line_that_was_changed_is_read_anew(fleet: Path, tmp_path: Path) -> None:
    """One digit of a kept sum: the seal no longer fits, and the result is that of the files."""
    right = fit_fleet(fleet, tmp_path / "out").to_dict()
    kept = tmp_path / "out" / SUMS
    first, second = kept.read_text().splitlines(keepends=True)
    kept.write_text(re.sub(r'("loads_N": \[\d)', r"\g<1>9", first) + second)
    again = fit_fleet(fleet, tmp_path / "out")
    assert (again.n_read, again.n_kept) == (1, 1)
    assert again.to_dict() == right


def test_kept_lines_that_are_none_are_read_anew(fleet: Path, tmp_path: Path) -> None:
    """Bytes that are no UTF-8, a nesting beyond all bounds and other JSON between whole lines: these alone are kept."""
    right = fit_fleet(fleet, tmp_path / "out").to_dict()
    kept = tmp_path / "out" / SUMS
    kept.write_bytes(b"\xff\xfe{}\n" + b"[" * 100_000 + b"\nnull\n[1]\n" + kept.read_bytes())
    again = fit_fleet(fleet, tmp_path / "out")
    assert (again.n_read, again.n_kept) == (0, 2)
    assert again.to_dict() == right


def test_files_of_the_user_are_not_overwritten(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Their own table and lines under the name of the store are kept; --force alone replaces an earlier result."""
    own, command = tmp_path / "own", ["fleet", "run", str(fleet), "--into", str(tmp_path / "own")]
    own.mkdir()
    for name in ("vehicles.csv", SUMS):
        (own / name).write_text("id,hall\nv1,A\n")
        assert run([*command, *(["--force"] if name == SUMS else [])]) == 2
        assert (own / name).read_text() == "id,hall\nv1,A\n"
        assert name in capsys.readouterr().err
        (own / name).unlink()
    assert [run(command), run(command), run([*command, "--force"])] == [0, 2, 0]
    assert json.loads((own / "fleet.json").read_text(encoding="utf-8"))["simulated"] is True
    assert "SIMULATED DATA" in capsys.readouterr().out


def test_a_store_that_is_a_pipe_is_refused_and_never_waited_for(fleet: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out" / SUMS)
    with pytest.raises(BadInputError, match="no regular file"):
        fit_fleet(fleet, tmp_path / "out")


def test_a_fleet_of_which_nothing_can_be_fitted_has_its_pages(fleet: Path, tmp_path: Path) -> None:
    """Settings that are a folder in every vehicle: each is listed, no figure is drawn, the pages are written."""
    for vehicle in ("v1", "v2"):
        (fleet / vehicle / "campaign.toml").unlink()
        (fleet / vehicle / "campaign.toml").mkdir()
    fitted = fit_fleet(fleet, tmp_path / "out")
    assert fitted.view.n_failed == 2
    written = write_fleet(fitted, tmp_path / "out", name="fleet", issued="2026-01-31")
    assert {path.name for path in written} == {"fleet.json", "vehicles.csv", "fleet.pdf", "fleet.html"}


def test_links_and_special_files_of_a_vehicle_leave_the_others_alone(fleet: Path, tmp_path: Path) -> None:
    """A table that leads out of the fleet, a table that is a pipe, settings that lead nowhere: each is listed."""
    outside = tmp_path / "outside.csv"
    outside.write_text((fleet / "v1" / "runs.csv").read_text())
    for vehicle in ("linked", "pipe", "nowhere"):
        shutil.copytree(fleet / "v1", fleet / vehicle)
    (fleet / "linked" / "runs.csv").unlink()
    (fleet / "linked" / "runs.csv").symlink_to(outside)
    (fleet / "pipe" / "runs.csv").unlink()
    os.mkfifo(fleet / "pipe" / "runs.csv")
    (fleet / "nowhere" / "campaign.toml").unlink()
    (fleet / "nowhere" / "campaign.toml").symlink_to("missing.toml")
    found = {vehicle["id"]: vehicle for vehicle in fit_fleet(fleet, tmp_path / "out").to_dict()["vehicles"]}
    assert {vehicle for vehicle, record in found.items() if record["status"] == "failed"} == {
        "linked",
        "nowhere",
        "pipe",
    }
    for vehicle in ("linked", "pipe", "nowhere"):
        assert found[vehicle]["why"]
    assert found["v1"]["status"] == found["v2"]["status"] == "fitted"


@pytest.mark.parametrize("endless", ["device", "pipe"])
def test_settings_without_an_end_are_not_read(fleet: Path, endless: str) -> None:
    """A link to an endless device was read for ever, a pipe waited for; the vehicle is none that was simulated."""
    settings = fleet / "v1" / "campaign.toml"
    settings.unlink()
    settings.symlink_to("/dev/zero") if endless == "device" else os.mkfifo(settings)
    simulated = (fleet / "v2" / "campaign.toml").read_text().count("simulated = true")
    assert store.any_simulated(fleet) == bool(simulated)
    with pytest.raises(OSError, match="a regular file was expected"):
        sha256_file(settings)
