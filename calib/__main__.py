"""Run the command line as ``python -m calib`` or ``calib``; an interruption during the imports is one line, too."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

__all__ = ["main"]

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit with its status."""
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _stop)
    from calib.cli.main import run

    try:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        status: object = run()
    except SystemExit as error:
        status = error.code
    except KeyboardInterrupt:
        _stop()
    try:
        if ours:
            # what is written is whole: an interruption of the interpreter's own end changes nothing
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:
        _stop()
    sys.exit(status)  # type: ignore[arg-type]


def _stop(*_: Any) -> None:
    os.write(2, b"calib: interrupted; nothing half-written is left\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
