"""A hash is known again only where nothing can have been written since it was taken."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from calib.campaign import known_hashes
from calib.campaign.known_hashes import KnownHashes

pytestmark = pytest.mark.skipif(os.name != "posix", reason="times of change are the system's own on POSIX only")


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file that counts as settled at once."""
    monkeypatch.setattr(known_hashes, "SETTLED_NS", -(10**12))
    (tmp_path / "logs").mkdir()
    path = tmp_path / "logs" / "r0.csv"
    path.write_bytes(b"one")
    return path


def _kept(tmp_path: Path, log: Path) -> KnownHashes:
    """Hash the file, keep that, and return what a later reading knows."""
    first = KnownHashes.read(tmp_path / "cache", log.parent)
    assert first.content(log).sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    first.keep()
    return KnownHashes.read(tmp_path / "cache", log.parent)


def test_an_untouched_file_is_not_read_again(tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    later = _kept(tmp_path, log)
    monkeypatch.setattr(known_hashes, "sha256_file", None)
    assert later.content(log).sha256 == hashlib.sha256(b"one").hexdigest()


@pytest.mark.parametrize("replaced", [False, True], ids=["in place", "by a rename"])
def test_other_bytes_of_the_same_length_and_time_are_seen(tmp_path: Path, log: Path, replaced: bool) -> None:
    """Size and time of modification are as before: the time of change is not, or it is another file."""
    later, status = _kept(tmp_path, log), log.stat()
    target = log.with_name("new") if replaced else log
    target.write_bytes(b"two")
    os.utime(target, ns=(status.st_atime_ns, status.st_mtime_ns))
    target.replace(log)
    assert log.stat().st_mtime_ns == status.st_mtime_ns
    assert later.content(log).sha256 == hashlib.sha256(b"two").hexdigest()


def test_a_file_that_has_just_changed_is_not_kept(tmp_path: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second change within the clock's tick would leave its times as they are."""
    monkeypatch.setattr(known_hashes, "SETTLED_NS", 10**15)
    assert not _kept(tmp_path, log).known


@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "text"])
def test_damaged_hashes_are_none(tmp_path: Path, log: Path, damage: str) -> None:
    """A bit turned over in a hash, half a file, none, and something else."""
    _kept(tmp_path, log)
    place = next((tmp_path / "cache").rglob("*.hashes"))
    data = bytearray(place.read_bytes())
    data[-5] ^= 1
    place.write_bytes(
        {"flip": bytes(data), "cut": bytes(data[: len(data) // 2]), "empty": b"", "text": b"[1]\n{}"}[damage]
    )
    later = KnownHashes.read(tmp_path / "cache", log.parent)
    assert not later.known
    assert later.content(log).sha256 == hashlib.sha256(b"one").hexdigest()
