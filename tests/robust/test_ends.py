"""Every way a command may end: outputs that are no files, machines that refuse, values that nobody means."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.documents import checksum
from tests.conftest import BLANK
from tests.fuzz.sound import ROOT, small_campaign

CORRIDOR = ROOT / "sample_runs" / "corridor"
BOTH_LOADS = "300,300"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign and its fit."""
    base = tmp_path_factory.mktemp("ends")
    small_campaign(base / "C")
    assert run(["fit", str(base / "C"), "--into", str(base / "result")]) in {0, 1}
    return base


def _environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def _calib(arguments: list[str], **more: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "calib", *arguments], env=_environment(**more), capture_output=True, check=False
    )


@pytest.mark.parametrize("force", [True, False])
def test_json_to_a_device_never_replaces_it(
    force: bool, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``--json /dev/null --force`` as root would put a file in its place."""
    before = os.stat("/dev/null")  # noqa: PTH116
    assert run(["check", str(made / "C"), "--json", os.devnull, *(["--force"] if force else [])]) == 0
    after = os.stat("/dev/null")  # noqa: PTH116
    assert (after.st_ino, after.st_rdev) == (before.st_ino, before.st_rdev)
    assert stat.S_ISCHR(after.st_mode)
    if os.geteuid() == 0:
        device = tmp_path / "null"
        try:
            os.mknod(device, 0o600 | stat.S_IFCHR, os.makedev(1, 3))
            with device.open("wb"):
                pass
        except OSError:
            # a machine that lets nobody make devices, or use them here
            return
        assert run(["check", str(made / "C"), "--json", str(device), *(["--force"] if force else [])]) == 0
        assert device.is_char_device()
    capsys.readouterr()


@pytest.mark.parametrize("target", ["/dev/stdout", "/dev/fd/1"])
def test_json_to_standard_output_by_its_name_is_written_there(target: str, made: Path, tmp_path: Path) -> None:
    """Also where standard output is a file, which keeps what it holds and its identity."""
    out = tmp_path / "out.txt"
    out.write_text("kept\n")
    number = out.stat().st_ino
    with out.open("ab") as stream:
        done = subprocess.run(
            [sys.executable, "-m", "calib", "loads", "--payload", "20", "--json", target, "--force"],
            env=_environment(),
            stdout=stream,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert out.stat().st_ino == number
    text = out.read_text(encoding="utf-8")
    assert text.startswith("kept\n")
    assert '"load_left_N"' in text or "{" in text


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "C", "--into", "-"],
        ["geometry", "C", "--output", "-"],
        ["simulate", "route", "square_cw", "--real", "0.1,0.1", "--output", "-"],
        ["report", "result", "--html", "-"],
        ["diagnose", "C", "--apply", "-"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_a_dash_is_no_folder(
    arguments: list[str], made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert run(arguments) == 2
    assert "found '-'; expected a file or folder" in capsys.readouterr().err
    assert not (made / "-").exists()


def test_an_export_to_a_dash_is_standard_output(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert run(["export", "result", "--to", "json", "--output", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["format"] == "calib-coefficients/1"
    assert not (made / "-").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "arguments", [["loads", "--payload", "20"], ["--help"], ["loads", "--payload", "9", "--json", "-"]]
)
def test_a_full_standard_output_is_one_line(arguments: list[str]) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "calib", *arguments],
            env=_environment(),
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr.count(b"\n") == 1
    assert b"No space left" in done.stderr


def test_a_standard_output_that_is_closed_is_no_fault() -> None:
    """``calib ... >&-``: 0 or 141, never 1, and no traceback."""
    done = subprocess.run(
        ["sh", "-c", f'"{sys.executable}" -m calib loads --payload 20 >&-'],
        env=_environment(),
        stderr=subprocess.PIPE,
        check=False,
    )
    assert done.returncode in {0, 141}
    assert b"Traceback" not in done.stderr


def test_a_wrong_window_system_changes_nothing(made: Path, tmp_path: Path) -> None:
    done = _calib(["loads", "--payload", "20", "--figures", str(tmp_path / "f")], MPLBACKEND="no such backend")
    assert done.returncode == 0, done.stderr


def test_a_temporary_folder_that_is_full_or_absent_is_one_line_or_no_matter(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The report is set in a temporary folder; where there is none, one line says so and nothing is left."""

    def full(*_: object, **__: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "mkdtemp", full)
    assert run(["report", str(made / "result"), "--into", str(tmp_path / "r.pdf")]) == 2
    err = capsys.readouterr().err
    assert "No space left on device" in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_may_not_be_read_is_said_with_its_cure(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another place or more room would be no help."""

    def refused(*_: object, **__: object) -> str:
        raise PermissionError(13, "Permission denied", "logs")

    monkeypatch.setattr(tempfile, "mkdtemp", refused)
    assert run(["report", str(made / "result"), "--into", str(tmp_path / "r.pdf")]) == 2
    err = capsys.readouterr().err
    assert "logs: found Permission denied" in err and "may read" in err and "change its rights" in err
    assert "more room" not in err


@pytest.mark.parametrize(
    "words",
    [
        ["geometry", "C", "--figures", "C/runs.csv"],
        ["geometry", "C", "--figures", "C/runs.csv/below"],
        ["fit", "C", "--figures", "result/fit.json", "--force"],
        ["fit", "C", "--json", "result", "--force"],
        ["fit", "C", "--json", "n" * 300],
        ["report", "result", "--html", "result/fit.json/page.html"],
    ],
    ids=lambda words: " ".join(words)[:40],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    words: list[str], made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file where a folder should be, a folder where a file should be, a name too long: one line, nothing before."""
    monkeypatch.chdir(made)
    assert run(words) == 2
    shown = capsys.readouterr()
    assert (shown.out, shown.err.count("\n")) == ("", 1)
    assert sorted(path.name for path in made.iterdir()) == ["C", "result"]


MISMATCHED: dict[str, Callable[[dict[str, object]], None]] = {
    "a run too many": lambda fit: fit["runs"].append(fit["runs"][-1]),  # type: ignore[attr-defined,index]
    "a run too few": lambda fit: fit["runs"].pop(),  # type: ignore[attr-defined]
    "no runs": lambda fit: fit["runs"].clear(),  # type: ignore[attr-defined]
    "half a covariance": lambda fit: fit["wheels"]["right"]["covariance"].pop(),  # type: ignore[index]
    "a negative variance": lambda fit: fit["wheels"]["left"]["covariance"][1].__setitem__(1, -1.0),  # type: ignore[index]
}


@pytest.mark.parametrize("seal", [True, False])
@pytest.mark.parametrize("name", list(MISMATCHED))
def test_a_fit_whose_parts_do_not_belong_together_is_refused(
    name: str, seal: bool, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By its checksum, and where that was computed anew, by the number of runs and the shape of its matrices."""
    document = json.loads((made / "result" / "fit.json").read_text(encoding="utf-8"))
    MISMATCHED[name](document)
    if seal:
        del document["checksum"]
        document["checksum"] = checksum(document)
    path = tmp_path / "fit.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    for arguments in (
        ["export", str(path), "--to", "json", "--output", str(tmp_path / "c.json")],
        ["report", str(path), "--into", str(tmp_path / "r.pdf")],
    ):
        assert run(arguments) == 2, arguments
        assert capsys.readouterr().err.count("\n") == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["fit.json"]


def test_a_fit_with_one_digit_changed_is_refused(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By export and report alike; spacing and order of the keys may change."""
    text = (made / "result" / "fit.json").read_text(encoding="utf-8")
    document = json.loads(text)
    same = tmp_path / "same.json"
    same.write_text(json.dumps(dict(reversed(document.items()))), encoding="utf-8")
    assert run(["export", str(same), "--to", "json", "--output", str(tmp_path / "c.json")]) == 0
    value = document["wheels"]["left"]["radius_ref_m"]
    changed = tmp_path / "changed.json"
    changed.write_text(text.replace(repr(value), repr(value + 1e-6)), encoding="utf-8")
    assert changed.read_text() != text
    for arguments in (
        ["export", str(changed), "--to", "c"],
        ["report", str(changed), "--into", str(tmp_path / "r.pdf")],
    ):
        assert run(arguments) == 2
        assert "checksum" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["diagnose", "C", "--seed", "-1"],
        ["simulate", "replay", "C", "--seed", "-1"],
        ["challenge", "own", "C", "--seed", "-1"],
        ["fit", "C", "--reference-load", "1e15"],
        ["fit", "C", "--reference-load", "1e300"],
        ["fit", "C", "--reference-load", "9" * 400],
        ["loads", "--payload", "9" * 400],
        ["plan", "C", "--most", "9" * 400],
        ["fit", "C", "--into", "n" * 300],
        ["fit", "n" * 300],
        ["check", "C", "--json", "/".join(["n" * 200] * 30)],
        ["export", "C", "--to", "json", "--output", "a\0b"],
    ],
    ids=lambda arguments: f"{arguments[0]} {arguments[-1][:6]!r}",
)
def test_no_bug_in_calib_for_what_the_user_typed(
    arguments: list[str], made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert run(arguments) in {1, 2}
    err = capsys.readouterr().err
    assert "bug in calib" not in err
    assert err.count("\n") <= 1


@pytest.mark.parametrize("key", ["counts_per_rev", "wrap_bits"])
def test_an_integer_of_400_digits_in_the_settings_is_one_line(
    key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = small_campaign(tmp_path / "C")
    path = folder / "campaign.toml"
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith(key)]
    at = lines.index("[encoder]") + 1
    path.write_text("\n".join([*lines[:at], f"{key} = {'9' * 400}", *lines[at:]]) + "\n", encoding="utf-8")
    assert run(["check", str(folder)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_names_outside_the_font_and_the_encoding_reach_every_output(tmp_path: Path) -> None:
    """In an ASCII locale, in a folder whose name is no UTF-8: export, check, PDF, page; JSON stays JSON."""
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/hall-\xff"))
    try:
        small_campaign(folder)
    except OSError:
        pytest.skip("this file system takes no names that are no UTF-8")
    path = folder / "campaign.toml"
    text = path.read_text(encoding="utf-8").replace('name = "', 'name = "中文 \\U0001F916 ', 1)
    path.write_text(text, encoding="utf-8")
    ascii_only = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    at = os.fsencode(folder)
    # one process for all three: the statuses stand last, and each output is told from the next by a NUL; no figure
    # has the name of the campaign
    code = (
        "import sys; from calib.cli.main import run; from calib.reporting import pages; at = sys.argv[1]; ended = []\n"
        f"pages.Picture.svg = {BLANK!r}\n"
        "for words in (['check', at, '--json', '-'], ['export', at, '--to', 'json'],\n"
        "    ['report', at, '--into', at + '/r.pdf', '--html', at + '/r.html', '--date', '2025-01-01']):\n"
        "    ended.append(run(words)); print(end=chr(0))\n"
        "print(ended)"
    )
    done = subprocess.run(
        [os.fsencode(sys.executable), b"-c", code.encode(), at],
        env=_environment(**ascii_only),
        capture_output=True,
        check=False,
    )
    assert done.stdout.isascii()
    assert b"bug in calib" not in done.stderr
    checked, exported, _, ended = done.stdout.split(b"\0")
    assert ended.split() in ([b"[0,", b"0,", b"0]"], [b"[0,", b"0,", b"1]"]), (ended, done.stderr)
    for document in (checked, exported):
        assert "中文" in json.dumps(json.loads(document), ensure_ascii=False)
    assert (folder / "r.pdf").stat().st_size > 10_000
    assert "中文" in (folder / "r.html").read_text(encoding="utf-8")
