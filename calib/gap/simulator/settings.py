"""Read ``SIM.toml``: the command of the user's simulator and the parameters that it can be given."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, PrivateAttr, ValidationError

from calib.campaign.settings_file import load_toml
from calib.errors import BadFileError
from calib.gap.effects.effect import Family, Parameter
from calib.gap.effects.library import REGISTRY
from calib.gap.effects.simulator import SIMULATOR_PREFIX

#: what the command has to name: each is replaced by a path
PLACES: Final = ("{campaign}", "{parameters}", "{out}")
#: a parameter's typical deviation over the largest plausible one, as the library has it for radii and track
TYPICAL_SHARE: Final = 0.1
#: a simulator with more is told which of them matter: every one costs a run of it
MOST_PARAMETERS: Final = 200

Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_.:/\-]{0,79}$")]


class Declared(BaseModel):
    """A ``[[parameter]]`` table."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    nominal: FiniteFloat
    step: FiniteFloat
    largest: PositiveFloat
    unit: Annotated[str, Field(max_length=20)] = "1"
    sign: Literal[-1, 0, 1] = 0
    effect: str = ""

    @property
    def parameter(self) -> Parameter:
        """The deviation from the nominal value, as the inference takes it."""
        return Parameter(self.name, self.unit, TYPICAL_SHARE * self.largest, self.largest, self.sign)

    @property
    def family(self) -> Family:
        """That of the effect which it stands for: other laws of the family are then forms of one cause."""
        return REGISTRY[self.effect].family if self.effect else Family.SIMULATOR


class SimulatorSettings(BaseModel):
    """A simulator: its command and its parameters; the whole file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    #: arguments with the places of `PLACES`; no shell
    command: Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1)]
    timeout_s: PositiveFloat = 600.0  #: of one run
    inputs: tuple[str, ...] = ()  #: further files whose change makes results stale, relative to the file
    parameters: Annotated[tuple[Declared, ...], Field(min_length=1, max_length=MOST_PARAMETERS, alias="parameter")]
    _path: Path = PrivateAttr()

    @property
    def path(self) -> Path:
        """Path of the file; the command runs in its folder."""
        return self._path

    @property
    def by_cause(self) -> dict[str, Declared]:
        """The parameters by the id of the cause that they are."""
        return {SIMULATOR_PREFIX + each.name: each for each in self.parameters}

    @property
    def nominal(self) -> dict[str, float]:
        """Return each parameter's nominal value."""
        return {each.name: each.nominal for each in self.parameters}


def read_settings(path: Path) -> SimulatorSettings:
    """Read and check a ``SIM.toml``; BadFileError names the key and what to do."""
    try:
        settings = SimulatorSettings.model_validate(load_toml(path, str(path), remedy="give the path of SIM.toml"))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        found = "nothing" if first["type"] == "missing" else f"{first['input']!r}"[:60]
        expected = {"missing": "this key", "extra_forbidden": "no such key"}.get(first["type"], first["msg"])
        raise BadFileError(path, found, expected, "see the simulator page of the manual", column=key) from error
    settings._path = path
    for place in PLACES:
        if not any(place in part for part in settings.command):
            expected = f"an argument that holds {place}"
            raise BadFileError(path, f"no {place}", expected, "add it to the command", column="command")
    names: set[str] = set()
    for each in settings.parameters:
        wrong = _wrong(each, names)
        if wrong is not None:
            raise BadFileError(path, *wrong, column=f"parameter {each.name}")
        names.add(each.name)
    return settings


def _wrong(each: Declared, names: set[str]) -> tuple[str, str, str] | None:
    """Return what is found, expected and to be done where a parameter cannot be used."""
    if each.name in names:
        return "the name twice", "one table for each parameter", "remove one of them"
    if each.step == 0.0 or not math.isfinite(1.0 / each.step) or abs(each.step) > each.largest:
        return f"step = {each.step:g}", f"a step of {each.largest:g} (largest) at most, not 0", "choose a smaller step"
    if each.sign * each.step < 0.0:
        return f"step = {each.step:g}", "a step of the sign that is physical", "give the step the sign"
    if each.effect and each.effect not in REGISTRY:
        return f"effect = {each.effect!r}"[:60], "an effect of the library", "see 'calib effects', or leave it out"
    return None
