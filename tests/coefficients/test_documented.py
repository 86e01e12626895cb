"""docs/exports.md names every field of every format."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from calib.coefficients.build import export
from calib.coefficients.file import CoefficientFile
from calib.coefficients.formats import FORMATS, ExportOptions
from calib.coefficients.formats.for_vehicle import CONTROLLERS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "exports.md").read_text(encoding="utf-8")
#: what the page shows as code; the words of a command's output do not count
SHOWN = set(re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)))
#: keys of the number itself, which the page explains in a sentence
OF_A_NUMBER = {"value", "unit"}


def keys(value: Any) -> set[str]:
    """Return the names of all fields of a document, at any depth."""
    if isinstance(value, list):
        return set().union(*map(keys, value))
    if isinstance(value, dict):
        return set(value) | set().union(*map(keys, value.values()))
    return set()


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_has_its_line(to: str) -> None:
    assert to in SHOWN


def test_every_field_of_the_master_is_explained(file: CoefficientFile) -> None:
    document = file.to_dict()
    # sides and limits of a range stand under the name of their section
    unnamed = keys(document) - OF_A_NUMBER - {"wheels", "left", "right", "min", "max"}
    assert not {name for name in unnamed if name not in SHOWN}


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_parameter_of_a_controller_is_explained(file: CoefficientFile, controller: str) -> None:
    text = export(file, "ros2", options=ExportOptions(controllers=(controller,)))[0].data
    parameters = yaml.safe_load(text)[controller]["ros__parameters"]
    nested = {f"kinematics.{name}" for name in parameters.pop("kinematics", {})}
    assert {*parameters, *nested} <= SHOWN
    assert controller in SHOWN


def test_every_column_of_the_table_is_explained(file: CoefficientFile) -> None:
    columns = next(csv.reader(io.StringIO(export(file, "csv")[0].data.decode())))
    assert {name.replace("_right_", "_left_") for name in columns} <= SHOWN
