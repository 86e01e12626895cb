"""The JSON Schema of the coefficient file, generated from its model and committed beside it."""

from __future__ import annotations

from importlib.resources import files
from typing import Any, Final

from calib.coefficients.file import CoefficientFile
from calib.files import to_json

SCHEMA_NAME: Final = "coefficients.schema.json"


def fresh_schema() -> dict[str, Any]:
    """Return the schema (2020-12) as generated from the model now."""
    generated = CoefficientFile.model_json_schema(mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:calib:coefficients:1",
        "title": "calib coefficient file, format 1",
        **{key: value for key, value in generated.items() if key != "title"},
    }


def fresh_schema_text() -> str:
    """Return the fresh schema as the text that is committed.

    ``python -c "from calib.coefficients.schema import *; print(fresh_schema_text(), end='')"`` renews the file.
    """
    return to_json(fresh_schema())


def committed_schema_text() -> str:
    """Return the schema that the package carries."""
    return files("calib.coefficients").joinpath(SCHEMA_NAME).read_text(encoding="utf-8")
