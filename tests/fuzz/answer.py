"""What a command answers to an input, and what is wrong with the answer."""

from __future__ import annotations

import contextlib
import functools
import io
import signal
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from unittest import mock

from calib import cli as commands
from calib.cli import main

ALLOWED = {0, 1, 2, 130}
LONGEST_S = 10.0


@dataclass
class Outcome:
    """What a command answered."""

    arguments: list[str]
    status: int | str
    out: str
    error: str
    seconds: float

    @property
    def fault(self) -> str:
        """What is wrong with the answer; empty where nothing is."""
        if self.status not in ALLOWED:
            return f"status {self.status}: {self.error[-300:]}"
        if "Traceback" in self.error or "bug in calib" in self.error:
            return f"no helpful line: {self.error[-300:]}"
        if "\x1b" in self.out or "\x1b" in self.error:
            return "an escape sequence was sent"
        if self.status == 2 and not self.error.strip():
            return "no line at all"
        lines = [line for line in self.error.splitlines() if not line.startswith("calib: note:")]
        if self.status == 2 and len(lines) != 1 and "Usage" not in self.error:
            return f"{len(lines)} lines instead of one: {self.error[:300]!r}"
        return f"{self.seconds:.1f} s" if self.seconds > LONGEST_S else ""


@functools.cache
def _command(words: tuple[str, ...]) -> object:
    return _UNCACHED(list(words))


_UNCACHED, _OPTIONS = main.command_of, functools.cache(main.options_of)


@contextlib.contextmanager
def built_once() -> Iterator[None]:
    """Keep the parsers of commands, which are the same for every call and take longer to make than most calls."""

    def command(arguments: list[str]) -> object:
        name = commands.command_called(arguments)
        return _command(tuple((name or " ".join(arguments[:1])).split()))

    with mock.patch.object(main, "command_of", command), mock.patch.object(main, "options_of", _OPTIONS):
        yield


def outcome(arguments: list[str]) -> Outcome:
    """Run a command in this process, and no longer than the longest time allowed."""
    out, err = io.StringIO(), io.StringIO()
    # the processor's time: a busy machine is no fault of the code; a wait that never ends meets the alarm
    started = time.process_time()
    previous = signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, 6 * LONGEST_S)
    status: int | str
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings(), built_once():
            # as a user's Python has them: what is not about code is shown
            warnings.simplefilter("default")
            for about_code in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
                warnings.simplefilter("ignore", about_code)
            status = main.run(arguments)
    except BaseException as error:
        status = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
    return Outcome(arguments, status, out.getvalue(), err.getvalue(), time.process_time() - started)


class Hangs(BaseException):
    """Raised where a command takes too long; nothing in it catches this."""


def _too_long(*_: object) -> None:
    raise Hangs
