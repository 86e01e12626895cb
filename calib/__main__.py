"""Run the command line as ``python -m calib`` or ``calib``; an interruption during the imports is one line, too."""

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit with its status."""
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _stop)
    from calib.cli.main import run

    try:
        status = _status(run) if ours else run()
    except KeyboardInterrupt:
        _stop()
    if status == _INTERRUPTED:
        # through an exec(), as of a dataclass, the interpreter would end by the signal, not by a status
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        os._exit(_INTERRUPTED)
    sys.exit(status)


def _status(run: Callable[..., int]) -> Any:
    interruptions = []

    def interrupt(*_: Any) -> NoReturn:
        interruptions.append(True)
        raise KeyboardInterrupt

    def settle() -> bool:
        # what is written is whole: an interruption changes nothing any more
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return bool(interruptions)

    def unraisable(ignored: Any) -> None:
        # one that falls into a callback of the interpreter is heeded by `interrupted`, and need not be shown
        if not issubclass(ignored.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(ignored)

    try:
        sys.unraisablehook = unraisable
        signal.signal(signal.SIGINT, interrupt)
        return run(settle=settle, interrupted=lambda: bool(interruptions))
    except SystemExit as error:
        return error.code
    finally:
        settle()


def _stop(*_: Any) -> NoReturn:
    os.write(2, b"calib: interrupted; nothing half-written is left\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
