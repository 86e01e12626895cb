from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from pydantic import ValidationError

from calib.coefficients.file import CoefficientFile
from calib.documents import to_json

COMMITTED = Path(__file__).resolve().parents[2] / "docs" / "coefficients.schema.json"


def fresh_schema_text() -> str:
    """Return the schema (2020-12) that the model makes now.

    ``python -c "from tests.coefficients.test_schema import *; COMMITTED.write_text(fresh_schema_text())"`` renews it.
    """
    generated = CoefficientFile.model_json_schema(mode="validation")
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:calib:coefficients:1",
        "title": "calib coefficient file, format 1",
    }
    return to_json(head | {key: value for key, value in generated.items() if key != "title"})


@pytest.fixture(scope="module")
def validator() -> Draft202012Validator:
    schema = json.loads(COMMITTED.read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def test_the_committed_schema_is_the_one_the_model_makes() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == fresh_schema_text()


def test_a_file_satisfies_the_schema(file: CoefficientFile, validator: Draft202012Validator) -> None:
    assert list(validator.iter_errors(json.loads(file.to_bytes()))) == []


def _without(*path: str) -> Any:
    def damage(document: dict[str, Any]) -> None:
        at = document
        for key in path[:-1]:
            at = at[key]
        del at[path[-1]]

    return damage


def _with(value: Any, *path: str) -> Any:
    def damage(document: dict[str, Any]) -> None:
        at = document
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = value

    return damage


DAMAGES = {
    "unit missing": _without("vehicle", "track", "unit"),
    "unit wrong": _with("mm", "vehicle", "track", "unit"),
    "value as text": _with("0.7", "vehicle", "track", "value"),
    "value negative": _with(-0.7, "vehicle", "track", "value"),
    "wheel missing": _without("wheels", "left"),
    "rule unknown": _with("extrapolate", "outside"),
    "key unknown": _with(1, "vehicle", "colour"),
    "checksum short": _with("sha256:00", "checksum"),
    "flag as number": _with(1, "simulated"),
    "date as text": _with("today", "created"),
    "hash missing": _with([{"path": "runs.csv"}], "inputs"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_schema_and_model_refuse_the_same_damage(
    file: CoefficientFile, validator: Draft202012Validator, name: str
) -> None:
    document = copy.deepcopy(json.loads(file.to_bytes()))
    DAMAGES[name](document)
    assert not validator.is_valid(document)
    with pytest.raises(ValidationError):
        CoefficientFile.model_validate(document)
