"""The script that takes every command into every odd world knows every command, and its worlds can fail."""

from __future__ import annotations

import contextlib
import io
import subprocess
from pathlib import Path

import pytest

from calib.cli import COMMANDS
from calib.cli.main import run
from tests.robust import every


def test_every_command_has_a_sound_call() -> None:
    """A command that is added later is taken along, under its own name."""
    assert set(every.SOUND) == set(COMMANDS)
    assert all(call.split()[: len(name.split())] == name.split() for name, call in every.SOUND.items())


@pytest.fixture(autouse=True, scope="module")
def _imported() -> None:
    """Import what the command takes once, and not in each process forked off."""
    with contextlib.redirect_stdout(io.StringIO()):
        assert run(["loads", "--payload", "20"]) == 0


@pytest.mark.parametrize("world", ["closed", "unread", "full", "ascii", "fifo", "bare", "clock"])
def test_a_quick_command_in_an_odd_world(world: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No input but its options: ends as usual, as 141, or in one line."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(every.SOUND, "loads", "loads --payload 20")
    assert list(every.faults_of(world, ["loads"])) == []


def test_a_fault_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that ends otherwise than usual is named with its status."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(every.SOUND, "loads", "loads --no-such-option")
    Path("out").mkdir()
    [fault] = every.closed("loads", 0)
    assert "loads: status 2" in fault


def test_a_world_that_hinders_nothing_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that writes nothing is not hindered by small files: the world must say that it showed nothing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(every.SOUND, "loads", "loads --payload 20")
    [fault] = every.faults_of("small-files", ["loads"])
    assert "no command was hindered" in fault
    monkeypatch.setitem(every.SOUND, "init", "init out/new")
    assert list(every.faults_of("small-files", ["init"])) == []


@pytest.mark.parametrize("world", ["killed", "full-disk", "read-only-disk"])
def test_kills_and_disks_hinder_a_command_that_writes(
    world: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk can be mounted by few users: elsewhere the script alone tries it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(every.SOUND, "loads", "loads --payload 20 --json out/loads.json")
    if "disk" in world and subprocess.run(["mount", "-t", "tmpfs", "none", str(tmp_path)], check=False).returncode:
        pytest.skip("no right to mount a disk")
    if "disk" in world:
        subprocess.run(["umount", str(tmp_path)], check=True)
    faults = list(every.faults_of(world, ["loads"]))
    # a quick command may be through before it is killed, and its file fit on a small disk
    assert [fault for fault in faults if "no command was hindered" not in fault] == []
    assert not faults or world != "read-only-disk"
