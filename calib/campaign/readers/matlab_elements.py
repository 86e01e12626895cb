"""The element tree of a MATLAB 5 file, checked before it is handed to a reader in C that trusts every tag."""

from __future__ import annotations

import struct
import zlib
from typing import Final

from calib.limits import MATLAB_UNPACKED_BYTES

_HEADER: Final = 128
_TAG: Final = 8
_INT32, _UINT32, _MATRIX, _COMPRESSED = 5, 6, 14, 15
#: types of data elements (MAT-File Format, table 1-1)
_TYPES: Final = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 15, 16, 17, 18})
#: classes of arrays (table 1-2, with function handles and opaque objects)
_CLASSES: Final = range(1, 18)
_CHARACTERS, _SPARSE, _LAST_NUMERIC = 4, 5, 15
#: bit of the flags: an imaginary part follows
_COMPLEX: Final = 0x800
#: cells, structures and objects hold arrays, one a place
_CONTAINERS: Final = range(1, 4)
#: structures in structures
_DEEPEST: Final = 32


class _Broken(Exception):
    """The tree breaks here; the text says how."""


def damage(data: bytes) -> str:
    """Return how the elements of a file break, empty where every tag, class and length is one that may be.

    `data`: the whole file, its header of 128 bytes included. A header that is not of version 5 is left to the reader.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        return "no header of version 5"
    if struct.unpack(f"{order}H", data[124:126])[0] >> 8 != 1:
        return ""
    try:
        _elements(memoryview(data)[_HEADER:], order, 0)
    except _Broken as broken:
        return str(broken)
    return ""


def _elements(data: memoryview, order: str, depth: int) -> list[tuple[int, memoryview]]:
    """Return type and content of the elements of one level, all below them checked."""
    if depth > _DEEPEST:
        raise _Broken(f"arrays more than {_DEEPEST} deep in one another")
    found, position = [], 0
    while position + _TAG <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, position)
        small = kind >> 16
        if small:
            kind, size, start = kind & 0xFFFF, small, position + 4
        else:
            start = position + _TAG
        if kind not in _TYPES or (kind == _COMPRESSED and depth) or (small and size > 4):
            raise _Broken(f"an element of type {kind} and {size} bytes")
        if start + size > len(data):
            raise _Broken(f"an element of {size} bytes where {len(data) - start} are left")
        content = data[start : start + size]
        if kind == _MATRIX:
            _array(content, order, depth)
        elif kind == _COMPRESSED:
            _elements(memoryview(_unpacked(content)), order, depth + 1)
        found.append((kind, content))
        # all but compressed elements end on eight bytes
        position = position + _TAG if small else start + (size if kind == _COMPRESSED else (size + 7) // 8 * 8)
    return found


def _array(content: memoryview, order: str, depth: int) -> None:
    """Check an array: its flags, its dimensions, and what it holds; nothing at all is an empty one."""
    if not len(content):
        return
    parts = _elements(content, order, depth + 1)
    if len(parts) < 2 or parts[0][0] != _UINT32 or len(parts[0][1]) != 8 or parts[1][0] != _INT32:
        raise _Broken("an array without flags and dimensions")
    flags = struct.unpack(f"{order}I", parts[0][1][:4])[0]
    kind, is_complex = flags & 0xFF, bool(flags & _COMPLEX)
    if kind not in _CLASSES:
        raise _Broken(f"an array of class {kind}")
    # flags, dimensions and name, then rows and columns of a sparse one, then real and imaginary numbers
    wanted = 3 + (2 if kind == _SPARSE else 0) + 1 + is_complex
    if _CHARACTERS <= kind <= _LAST_NUMERIC and len(parts) < wanted:
        raise _Broken(f"an array of class {kind} with {len(parts)} of {wanted} elements")
    # objects of MATLAB's own kind have a name where others have dimensions
    sizes = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1][: len(parts[1][1]) // 4 * 4])
    places = 1
    for size in sizes:
        places *= size
        if size < 0 or places > MATLAB_UNPACKED_BYTES:
            raise _Broken(f"an array of {'x'.join(map(str, sizes))}")
    if kind in _CONTAINERS and places > len(content):
        raise _Broken(f"{places} arrays in {len(content)} bytes")


def _unpacked(content: memoryview) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(content, MATLAB_UNPACKED_BYTES)
    except zlib.error as error:
        raise _Broken(str(error)) from error
    if unpacker.unconsumed_tail:
        raise _Broken(f"more than {MATLAB_UNPACKED_BYTES >> 20} MiB unpacked")
    return unpacked
