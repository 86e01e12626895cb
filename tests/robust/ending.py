"""A command in a forked process of its own, hindered in some way, and how it ended."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from tests.fuzz.inputs import options

#: a sound call of each command on the inputs below the working folder; what it writes goes below ``out``
SOUND: dict[str, str] = {
    "check": "check C",
    "init": "init out/new",
    "ingest": "ingest C/runs.csv C/logs --into out/ingested --mapping mapping.toml",
    "fit": "fit C --into out/result",
    "deviation": "deviation C",
    "report": "report result --into out/r.pdf --date 2025-01-01",
    "export": "export result --to csv",
    "loads": "loads --vehicle coefficients.json --payload 20",
    "simulate route": "simulate route route.toml --real 0.1,0.099",
    "simulate journey": "simulate journey route.toml --law coefficients.json --load 400,500 --draws 200",
    "simulate study": "simulate study corrected --law coefficients.json --draws 200",
    "simulate replay": "simulate replay C --law coefficients.json",
    "geometry": "geometry C",
    "diagnose": "diagnose C --model coefficients.json",
    "effects": "effects",
    "plan": "plan --from plan.toml",
    "challenge make": "challenge make --seeds seeds.toml --into out/made --workers 1",
    "challenge own": "challenge own C --effects unequal_radii --planted 1 --workers 1",
    "challenge run": "challenge run set --workers 1",
    "challenge score": "challenge score set",
    "fleet run": "fleet run fleet --into out/fleet",
    "fleet simulate": "fleet simulate --into out/vehicles --vehicles 1 --runs 6 --seed 1",
}  # fmt: skip
LONGEST_S = 600.0
#: exit status of every command started, to be counted
TRIED: list[int] = []


@dataclass(frozen=True)
class End:
    """How a command ended."""

    status: int
    out: bytes
    error: str
    seconds: float
    #: the same of a second one that ran beside it
    beside: End | None = None

    @property
    def one_line(self) -> bool:
        """Whether standard error holds one line beside notes, and no traceback."""
        lines = [line for line in self.error.splitlines() if line and not line.startswith("calib: note:")]
        return len(lines) <= 1 and "Traceback" not in self.error and "bug in calib" not in self.error


def ended(
    words: list[str],
    stdout: int | None = None,
    *,
    closed: bool = False,
    encoding: str = "utf-8",
    before: Callable[[], None] | None = None,
    signalled: tuple[int, float] | None = None,
    beside: list[str] | None = None,
    piped: bool = False,
) -> End:
    """Run a command in a forked process and return how it ended.

    Parameters
    ----------
    words : list of str
        The command line.
    stdout : int, optional
        A descriptor for standard output; without it what is written is returned.
    closed : bool
        Standard output is closed.
    encoding : str
        Of standard output.
    before : callable, optional
        What hinders the process; called in it before the command.
    signalled : tuple of int and float, optional
        A signal, and after how many seconds it is sent.
    beside : list of str, optional
        A second command line, started at the same time.
    piped : bool
        Standard output is a pipe, even where files are hindered.
    """
    if piped:
        reading, writing = os.pipe()
        end = ended(words, writing, encoding=encoding, before=before)
        os.close(writing)
        with open(reading, "rb") as stream:  # noqa: PTH123
            return replace(end, out=stream.read())
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as error:
        started = time.monotonic()
        # a signal that comes before the command has begun waits for it
        kept = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        child = os.fork()
        if not child:
            os.dup2(out.fileno() if stdout is None else stdout, 1)
            os.dup2(error.fileno(), 2)
            sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
            if closed:
                os.close(1)
                sys.stdout = None  # type: ignore[assignment]
            else:
                sys.stdout = open(1, "w", encoding=encoding, closefd=False)  # noqa: SIM115
            _run_to_the_end(words, before)
        signal.pthread_sigmask(signal.SIG_SETMASK, kept)
        second = None if beside is None else ended(beside)
        if signalled is not None:
            time.sleep(signalled[1])
            os.kill(child, signalled[0])
        status = _waited_for(child)
        TRIED.append(status)
        for stream in (out, error):
            stream.seek(0)
        text = error.read().decode("utf-8", "replace")
        return End(status, out.read(), text, time.monotonic() - started, second)


def _run_to_the_end(words: list[str], before: Callable[[], None] | None) -> None:
    """End this process as ``python -m calib`` would."""
    from calib.__main__ import main

    sys.argv = ["calib", *words]
    try:
        if before is not None:
            before()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
        main()
    except KeyboardInterrupt:
        status = 130
    except SystemExit as ending:
        status = ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    except BaseException as error:
        sys.stderr.write(f"Traceback: {error!r}\n")
        status = 70
    # the command line flushes its output itself, so that the interpreter has nothing left to do
    with suppress(OSError):  # files of a few bytes: what cannot be told must not let this process go on as its parent
        sys.stderr.flush()
    os._exit(status)


def _waited_for(child: int) -> int:
    until = time.monotonic() + LONGEST_S
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return -9


def worded(command: str, *more: str) -> list[str]:
    """Return the sound call of a command, with further words."""
    return [*SOUND[command].split(), *more]


def forces(command: str) -> bool:
    """Return whether a command may be told to replace what exists."""
    return any(name == "--force" for name, _, _ in options(command))


def forced(command: str) -> list[str]:
    """Return the sound call of a command with the leave to replace, where there is one."""
    return worded(command, *(["--force"] if forces(command) else []))


def told(what: str, end: End, allowed: set[int]) -> Iterator[str]:
    """Yield what is wrong with an end: another status, or more than one line."""
    if end.status not in allowed or not end.one_line:
        yield f"{what}: status {end.status}, {end.seconds:.1f} s: {end.error[-300:]!r}"
