"""A scheduler that is none, is silent, dies or stops answering ends in one line and never in a wait without end."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib.cli.main import run
from calib.errors import BadInputError, RefusedError
from calib.fleet import workers as engine_module
from calib.fleet.workers import engine
from tests.fleet.slow import doubled

pytest.importorskip("distributed", reason="the extra fleet is not installed")


@pytest.mark.parametrize("address", ["foo", "tcp://", "http://localhost:8080", "inproc://x", "tcp://a", "x.json"])
def test_what_is_no_address_is_refused_at_once(address: str) -> None:
    with pytest.raises(BadInputError, match=r"expected tcp://host:port"), engine(scheduler=address):
        pass


def test_a_port_that_answers_nothing_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Something listens there, and never speaks."""
    monkeypatch.setattr(engine_module, "ANSWER_S", 2.0)
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen(8)
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        (tmp_path / "fleet").mkdir()
        assert (
            run(["fleet", "run", str(tmp_path / "fleet"), "--into", str(tmp_path / "out"), "--scheduler", address]) == 2
        )
    (line,) = capsys.readouterr().err.splitlines()
    assert "found no answer" in line


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler and one worker, in processes of their own."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    base = [sys.executable, "-m", "distributed.cli"]
    of_scheduler = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    of_worker = [address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    first = subprocess.Popen([*base[:2], "distributed.cli.dask_scheduler", *of_scheduler], **quiet)
    second = subprocess.Popen([*base[:2], "distributed.cli.dask_worker", *of_worker], **quiet)
    try:
        yield address, first
    finally:
        for process in (first, second):
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["dies", "stops answering"])
def test_a_scheduler_that_is_gone_in_the_middle_ends_the_run(
    how: signal.Signals, scheduler: tuple[str, subprocess.Popen[bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What came back before was given on; then one error says that the scheduler is gone."""
    monkeypatch.setattr(engine_module, "QUIET_S", 1.0)
    monkeypatch.setattr(engine_module.DaskEngine, "batch", (1, 1))
    monkeypatch.setattr(engine_module, "ANSWER_S", 4.0)
    address, process = scheduler
    _wait_for(address)
    with engine(scheduler=address) as opened:
        results = opened.run(doubled, list(range(200)), lambda item, _why: -item)
        assert next(results) in range(0, 400, 2)
        process.send_signal(how)
        with pytest.raises(RefusedError, match="found no answer"):
            list(results)


def _wait_for(address: str) -> None:
    """Wait until the scheduler has its worker."""
    from distributed import Client

    deadline = time.monotonic() + 30.0
    while time.monotonic() < deadline:
        try:
            with Client(address, timeout=2.0, set_as_default=False) as client:
                client.wait_for_workers(1, timeout=20.0)
                return
        except (OSError, TimeoutError):
            time.sleep(0.2)
    pytest.fail("no scheduler could be started")
