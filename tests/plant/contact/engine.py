"""The physics engine, loaded only when a run is driven."""

from __future__ import annotations

import importlib
from typing import Any

from calib.errors import CalibError

__all__ = ["engine"]


def engine() -> Any:
    """Return the module ``mujoco``.

    Raises
    ------
    CalibError
        Where it is not installed; the text names the extra to install.
    """
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise CalibError(
            "contact plant: found no MuJoCo; expected it beside the tests; install it with: pip install 'calib[test]'"
        ) from error
