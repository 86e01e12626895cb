"""The entry point: help, version, suggestions, interruptions, closed pipes, completion."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from calib import __version__
from calib.cli import COMMANDS
from calib.cli.main import as_typed, run


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help_has_a_short_form_everywhere(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["fit"], ["simulate"], ["simulate", "replay"]):
        assert run([*words, flag]) == 0
        assert "Usage: calib" in capsys.readouterr().out


@pytest.mark.parametrize("flag", ["-V", "--version"])
def test_the_version_has_a_short_form(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([flag]) == 0
    assert capsys.readouterr().out == f"calib {__version__}\n"


@pytest.mark.parametrize(
    ("words", "suggestion"),
    [
        (["diagnos"], "'diagnose'"),
        (["simulate", "replai"], "'replay'"),
        (["fit", "x", "--forse"], "--force"),
        (["challenge", "scor"], "'score'"),
    ],
)
def test_what_is_misspelled_gets_a_suggestion(
    words: list[str], suggestion: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == 2
    error = capsys.readouterr().err
    assert suggestion in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("message", "typed"),
    [
        ("draws: found 3; expected more", "--draws: found 3; expected more"),
        ("payload_at: found x", "--payload-at: found x"),
        ("path: found x", "path: found x"),
        (
            "a.csv: found an existing file; give force=True to replace it",
            "a.csv: found an existing file; give --force to replace it",
        ),
    ],
)
def test_arguments_of_the_library_become_options(message: str, typed: str) -> None:
    assert as_typed(message, {"--draws", "--payload-at", "--force"}) == typed


def test_a_loop_of_links_is_said_to_be_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert run(["check", str(tmp_path / "loop")]) == 2
    error = capsys.readouterr().err
    assert "a symbolic link that leads nowhere" in error
    assert "did you mean" not in error


def test_an_effect_that_is_misspelled_gets_a_suggestion(project_root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", str(project_root / "sample_runs/corridor"), "--exclude", "load_radus"]) == 2
    error = capsys.readouterr().err
    assert "did you mean 'load_radius'" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("name", ["check", "fit", "deviation", "diagnose", "report", "simulate replay", "export"])
def test_a_target_that_exists_is_refused_before_the_work(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The campaign is not even looked for."""
    target = tmp_path / "there.json"
    target.write_text("kept")
    extra = ["--to", "json"] if name == "export" else []
    assert run([*name.split(), str(tmp_path / "absent"), "--json", str(target), *extra]) == 2
    assert "existing file" in capsys.readouterr().err
    assert target.read_text() == "kept"


def test_an_interruption_is_one_line_that_says_what_was_kept(
    project_root: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from calib import cli

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    arguments = ["fit", str(project_root / "sample_runs/corridor"), "--json", str(tmp_path / "fit.json")]
    monkeypatch.setattr(cli, "write_json", interrupted)
    assert run(arguments) == 130
    assert capsys.readouterr().err == "calib: interrupted; nothing was written, and nothing half-written is left\n"
    monkeypatch.setattr("calib.radius.result.write_result", lambda *_, **__: tmp_path / "result")
    assert run([*arguments, "--into", str(tmp_path / "result")]) == 130
    assert capsys.readouterr().err.startswith(f"calib: interrupted; kept: {tmp_path / 'result'}, and")


def test_an_interruption_that_a_library_let_pass_is_heeded(
    project_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a bare ``except`` around an import does: nothing is printed, one line, 130."""
    from calib.campaign import read

    stopped: list[bool] = []
    once = read.read_or_ingest

    def let_pass(*given: object, **named: object) -> object:
        stopped.append(True)
        return once(*given, **named)

    monkeypatch.setattr(read, "read_or_ingest", let_pass)
    arguments = ["check", str(project_root / "sample_runs/corridor")]
    assert run(arguments, settle=lambda: bool(stopped), interrupted=lambda: bool(stopped)) == 130
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == (
        "",
        "calib: interrupted; nothing was written, and nothing half-written is left\n",
    )


def test_control_c_ends_a_process_with_130(project_root: Path) -> None:
    """As soon as the diagnosis has begun, however fast the machine; one line, and nothing on standard output."""
    program = (
        # a suite that runs in the background hands on that interruptions are ignored
        "import os, signal, sys, threading, time\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from calib.__main__ import main\n"
        "def press():\n"
        "    while 'calib.gap.diagnose' not in sys.modules:\n"
        "        time.sleep(0.01)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "threading.Thread(target=press, daemon=True).start()\n"
        "main()"
    )
    command = [sys.executable, "-c", program, "diagnose", "sample_runs/corridor"]
    done = subprocess.run(command, cwd=project_root, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 130
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "interrupted" in done.stderr


@pytest.mark.parametrize("arguments", [["check", "sample_runs/corridor"], ["--help"], ["loads", "--json", "-"]])
def test_a_closed_standard_output_is_no_failure(arguments: list[str], project_root: Path) -> None:
    """As with ``calib check C | head -0``: 141 or 0, no traceback."""
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "calib", *arguments]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, cwd=project_root, text=True, check=False)
    os.close(write)
    assert done.returncode in {0, 141}
    assert done.stderr == ""


def test_files_are_written_although_nobody_reads_the_output(
    project_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with ``calib fit C --into F --json J | head -1``."""
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w", encoding="utf-8") as closed:
        monkeypatch.setattr(sys, "stdout", closed)
        arguments = ["--into", str(tmp_path / "fit"), "--json", str(tmp_path / "fit.json")]
        assert run(["fit", str(project_root / "sample_runs" / "corridor"), *arguments]) == 141
    assert {path.name for path in tmp_path.rglob("*")} == {"fit", "fit.json", "runs.csv"}


@pytest.mark.parametrize(
    "words",
    [
        ["report", "C", "--into", "x.pdf", "--html", "x.pdf"],
        ["diagnose", "C", "--apply", "x.json", "--json", "./x.json"],
        ["fit", "C", "--into", "x", "--json", "x/fit.json"],
        ["export", "C", "--to", "json", "--output", "x.json", "--json", "x.json"],
    ],
)
def test_two_outputs_of_one_name_are_refused_before_the_work(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The campaign is not even looked for."""
    monkeypatch.chdir(tmp_path)
    assert run([*words, "--force"]) == 2
    assert "two outputs" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_can_complete_commands_and_options(shell: str) -> None:
    program = [sys.executable, "-c", "import sys; from calib.cli.main import main; main(sys.argv[1:])"]
    typed = {"_TYPER_COMPLETE_ARGS": "calib diag", "COMP_WORDS": "calib diag", "COMP_CWORD": "1"}
    asked = {"_CALIB_COMPLETE": f"complete_{shell}", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
    environment = {**os.environ, **asked, **typed}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert "diagnose" in done.stdout
    environment |= {"_TYPER_COMPLETE_ARGS": "calib fit --ref", "COMP_WORDS": "calib fit --ref", "COMP_CWORD": "2"}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert "--reference-load" in done.stdout


def test_output_without_unicode_is_still_output(project_root: Path) -> None:
    """A C locale cannot show a micro sign; the numbers stand all the same."""
    command = [sys.executable, "-m", "calib", "loads"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, env=environment, cwd=project_root, capture_output=True, text=True, check=True)
    assert "1" in done.stdout
    assert done.stdout.isascii()


def test_no_line_of_a_screen_is_wider_than_80_columns(
    project_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    campaign = str(project_root / "sample_runs/corridor_crossed")
    for arguments in (["check", campaign], ["fit", campaign, "--runs"], ["deviation", campaign], ["deviation"],
                      ["loads"], ["simulate", "study", "asymmetric", "--law", campaign, "--draws", "200"]):  # fmt: skip
        run(arguments)
        out = capsys.readouterr().out
        # the next step is one line, so that its command can be copied
        lines = [line for line in out.splitlines() if not line.startswith("Next: ")]
        assert max(map(len, lines)) <= 80, arguments
        assert "…" not in out


def test_every_command_is_registered_under_a_summary(capsys: pytest.CaptureFixture[str]) -> None:
    for group in ("simulate", "challenge"):
        assert run([group, "--help"]) == 0
        out = capsys.readouterr().out
        assert all(name.split()[1] in out for name in COMMANDS if name.startswith(f"{group} "))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (["ingest", "{s}/runs.csv", "--into", "{t}/made", "--mapping", "{t}/none.toml"], "the path of the mapping"),
        (["diagnose", "{s}", "--journeys", "{t}/none.toml"], "the path of the plan"),
        (["plan", "{s}", "--candidates", "{t}/none.toml"], "the path of the plan"),
    ],
)
def test_a_missing_file_is_answered_with_what_it_would_be(
    call: list[str], words: str, project_root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not with how to make a campaign, which is there."""
    sample = project_root / "sample_runs" / "corridor_crossed"
    assert run([part.format(s=sample, t=tmp_path) for part in call]) == 2
    told = capsys.readouterr().err
    assert words in told and "campaign.toml" not in told
