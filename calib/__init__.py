"""Calibrate a vehicle's wheel odometry, and find out why its simulation is wrong.

The way in from Python:

>>> import calib
>>> campaign = calib.read("sample_runs/corridor_crossed")
>>> fit = calib.fit(campaign)
>>> diagnosis = calib.diagnose(campaign)
>>> print(diagnosis.summary())
>>> diagnosis.plot()

Nothing heavy is imported until one of these functions is called. The folders show the data's way: ``campaign`` (what
was driven and measured) -> ``radius`` (effective radius and load law) -> ``coefficients`` (the law as the vehicle gets
it) -> ``motion`` (odometry, routes, simulation) -> ``gap`` (simulated against real) -> ``report``. A folder imports
only folders before it.
"""

from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calib.api import diagnose, export, fit, geometry, plan, read, replay, report, simulate
    from calib.campaign.model import Campaign
    from calib.results import Diagnosis, Fit, Geometry, Plan, Replay, Simulation

__version__ = "0.1.0"

__all__ = [
    "Campaign",
    "Diagnosis",
    "Fit",
    "Geometry",
    "Plan",
    "Replay",
    "Simulation",
    "__version__",
    "diagnose",
    "export",
    "fit",
    "geometry",
    "plan",
    "read",
    "replay",
    "report",
    "simulate",
]

#: folders of this package that bear the name of a function of `calib.api`
_ALSO_FOLDERS = ("geometry", "report")


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from calib import api

    value = globals()[name] = getattr(api, name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)


class _CallableFolder(ModuleType):
    """A folder that can be called by its name: importing one binds it here, where the function would stand."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self.__wrapped__(*args, **options)

    @property
    def __wrapped__(self) -> Any:
        from calib import api

        return getattr(api, self.__name__.rpartition(".")[2])


def _make_callable(name: str) -> None:
    from importlib import import_module

    import_module(f"{__name__}.{name}").__class__ = _CallableFolder


for _name in _ALSO_FOLDERS:
    _make_callable(_name)
