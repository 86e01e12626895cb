"""Damage to bytes, documents and words: the same for the same generator."""

from __future__ import annotations

import json
import random
import re
from typing import Any

#: pieces that have hurt programs before
NASTY = (
    b"", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"9" * 400, b"-1e308", b"1e400", b"nan", b"inf", b"-inf", b"1_000",
    b"0x1p-1074", b'"', b"'", b"\\", b"\n", b"\r", b"\r\n", b",", b";", b"\t", b"[", b"]", b"{", b"}", b"=", b"#",
    b"../../etc/passwd", b"/dev/zero", b"[/red]", b"[link=file:///]x[/link]", b"\x1b[2J", b"\xe2\x80\xae", b"=1+1",
    b"null", b"true", b"[[[[[[[[[[", b"a.b.c.d.e.f.g.h = 1\n", b"%s%n", b"1970-01-01", b"\xed\xa0\x80", b"1e-320",
    b"a." * 2000 + b"a = 1\n", b"x" * 20000,
)  # fmt: skip
#: values that nobody means, for options and arguments
WORDS = (
    "-1", "0", "1e15", "1e300", "1e-300", "nan", "inf", "9" * 400, "", " ", "x" * 300, "[/red]", "\x1b[2J", "\u202e",
    "a\x00b", "../..", "/dev/null", "--help", "-", "300,", "300,300,300", "\udcff", "\u4e2d\u6587", "2025-02-30", "0.5",
)  # fmt: skip


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return bytes with one to four damages: bits, cuts, doublings, nasty pieces, numbers put for numbers."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(out) + 1)
        kind = rng.randrange(7)
        if kind == 0 and out:
            out[at % len(out)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del out[at : at + rng.choice((1, 3, 20, 400))]
        elif kind == 2:
            out[at:at] = out[at : at + rng.choice((1, 10, 200))]
        elif kind in (3, 4):
            out[at : at + rng.choice((0, 0, 1, 5))] = rng.choice(NASTY)
        elif kind == 5 and out:
            out[at % len(out)] = rng.randrange(256)
        else:
            _other_cell(out, rng)
    return bytes(out)


def _other_cell(out: bytearray, rng: random.Random) -> None:
    """Put a nasty piece in place of what stands between two separators."""
    marks = [found.start() for found in re.finditer(rb"[,=\n:]", out)]
    if len(marks) > 1:
        number = rng.randrange(len(marks) - 1)
        out[marks[number] + 1 : marks[number + 1]] = rng.choice(NASTY)


def resealed(data: bytes, rng: random.Random) -> bytes | None:
    """Return a sealed document with a part of it changed and a checksum that fits, so that it passes the seal."""
    from calib.documents import checksum

    document = json.loads(data)
    _change(document, rng)
    document.pop("checksum", None)
    try:
        return json.dumps(document | {"checksum": checksum(document)}).encode()
    except (ValueError, OverflowError, TypeError):
        return None


def _change(value: Any, rng: random.Random) -> None:
    while isinstance(value, dict | list) and value:
        key = rng.choice(list(value)) if isinstance(value, dict) else rng.randrange(len(value))
        if not isinstance(value[key], dict | list) or not value[key] or rng.random() < 0.15:
            kind = rng.randrange(4)
            if kind == 0:
                del value[key]
            elif kind == 1 and isinstance(value, list):
                value.append(value[key])
            else:
                value[key] = rng.choice([None, "x", -1, 0, 1e308, -1e-308, [], {}, True, 10**400, "\x1b[2J"])
            return
        value = value[key]
