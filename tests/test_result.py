"""What all results have in common: one serialiser, one presentation."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest

from calib.documents import PAGES, PRESENTATION, Result, plain, plain_fields


class _Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class _Inner:
    values: np.ndarray = field(default_factory=lambda: np.array([1.0, np.nan, np.inf]))
    hidden: int = field(default=3, metadata={"json": False})
    renamed: Path = field(default=Path("a") / "b", metadata={"json": "path"})


@dataclass(frozen=True)
class _Outer(Result):
    colour: _Colour = _Colour.RED
    inner: _Inner = field(default_factory=_Inner)
    many: tuple[_Inner, ...] = ()
    counts: np.int64 = field(default=np.int64(3))
    flag: np.bool_ = field(default=np.bool_(True))


def test_every_kind_of_field_has_its_form_in_json() -> None:
    """Numbers that are not finite are null; fields are renamed and omitted as their metadata say."""
    expected = {"colour": "red", "inner": {"values": [1.0, None, None], "path": "a/b"}, "many": []}
    expected |= {"counts": 3, "flag": True}
    assert _Outer().to_dict() == expected
    assert json.loads(json.dumps(_Outer().to_dict(), allow_nan=False)) == expected


def test_changes_replace_a_field_or_follow_the_fields() -> None:
    assert list(plain_fields(_Inner(), values="none", extra=np.float64(2.0)).items()) == [
        ("values", "none"),
        ("path", "a/b"),
        ("extra", 2.0),
    ]


def test_what_has_no_form_in_json_is_refused() -> None:
    with pytest.raises(TypeError, match="object has no form in JSON"):
        plain(object())


def test_the_presentation_is_there() -> None:
    """It is looked up by name; a typing error would show at the first summary only."""
    from importlib import import_module

    module = import_module(PRESENTATION)
    assert all(callable(getattr(module, name)) for name in ("summary", "brief", "figure"))
    assert callable(import_module(PAGES).brief_html)
