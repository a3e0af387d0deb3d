"""Reading MATLAB's .mat files strictly, versions 4 to 7.2: scipy's reader ends the process on damaged ones."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..errors import UnreadableFile

MATRIX, COMPRESSED, HEADER = 14, 15, 128
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
OLD_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")  # of version 4
OTHERS = {1: "a cell array", 2: "a struct", 3: "an object", 4: "text", 16: "a function", 17: "an object"}
SPARSE, NUMERIC = 5, range(6, 16)
IS_COMPLEX, IS_LOGICAL = 0x0800, 0x0200
ENOUGH = 1024  # bytes of a compressed matrix in which its name stands
NEWER = 'is of version 7.3 (HDF5); in MATLAB write save("{0}", "M", "q", "-v7")'


def read_mat(source: Path, wanted: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """Return those of the wanted matrices that the file holds, 2-D ndarrays or CSC arrays, and all names in it.

    Numbers only: whatever else has another name is passed over unread, and nothing is executed.

    Raises
    ------
    UnreadableFile
        Where the file is missing, damaged, of another version, or a wanted name is no real matrix.
    """
    found, names = {}, []
    try:
        content = memoryview(source.read_bytes())
        for name, matrix in _matrices(content, wanted, source.name):
            names.append(name)
            if name in wanted:
                found[name] = matrix
    except FileNotFoundError as error:
        raise UnreadableFile(f"no such file: {source}") from error
    except UnreadableFile as error:
        raise UnreadableFile(f"cannot read {source}: {error}") from None
    except (OSError, ValueError, OverflowError, MemoryError, struct.error, zlib.error) as error:
        raise UnreadableFile(f"cannot read {source}: it is damaged or no .mat file of numbers ({error})") from error
    return found, names


def _matrices(content: memoryview, wanted: Collection[str], name: str) -> Iterator[tuple[str, Any]]:
    if len(content) < 20:
        raise ValueError("it is too short")
    if 0 in content[:4]:  # the text at the head of a newer file has no zeros
        return _old_matrices(content, wanted)
    version, mark = bytes(content[124:126]), bytes(content[126:HEADER])
    if mark not in (b"IM", b"MI"):
        raise ValueError("its head is none of MATLAB's")
    order = "<" if mark == b"IM" else ">"
    if struct.unpack(order + "H", version)[0] == 0x0200:
        raise UnreadableFile("it " + NEWER.format(name))
    return _new_matrices(content, order, wanted)


# --- version 5 and later ------------------------------------------------------------------------------------


class _Element(NamedTuple):
    kind: int
    data: memoryview
    end: int

    @classmethod
    def at(cls, content: memoryview, start: int, order: str, *, may_end_early: bool = False) -> _Element:
        """Return the data element at a place; short ones stand in their own tag."""
        first, size = struct.unpack_from(order + "II", content, start)
        place = start + 8
        if first >> 16:
            first, size, place = first & 0xFFFF, first >> 16, start + 4
            if size > 4:
                raise ValueError(f"a short element of {size} bytes")
        data = content[place : place + size]
        if len(data) < size and not may_end_early:
            raise ValueError(f"{size} bytes are announced where {len(data)} follow")
        if first == COMPRESSED:
            return cls(first, data, place + size)
        return cls(first, data, start + 8 if place == start + 4 else place + size + -size % 8)

    def numbers(self, order: str) -> Any:
        """Return the numbers as they are stored."""
        if self.kind not in TYPES:
            raise ValueError(f"numbers of the unknown type {self.kind}")
        return np.frombuffer(self.data, order + TYPES[self.kind])


def _new_matrices(content: memoryview, order: str, wanted: Collection[str]) -> Iterator[tuple[str, Any]]:
    place = HEADER
    while place < len(content):
        element = _Element.at(content, place, order)
        place = element.end
        if element.kind == COMPRESSED:
            unpacking = zlib.decompressobj()
            head = unpacking.decompress(element.data, ENOUGH)
            whole = _Element.at(memoryview(head), 0, order, may_end_early=True)
            if whole.kind == MATRIX and _Head.of(whole.data, order).name in wanted:
                size = struct.unpack_from(order + "I", head, 4)[0] + 8
                rest = unpacking.decompress(unpacking.unconsumed_tail, max(size - len(head), 0) + 1)
                if not unpacking.eof:
                    raise ValueError("a compressed matrix ends too early or too late")
                whole = _Element.at(memoryview(head + rest), 0, order)
        else:
            whole = element
        if whole.kind == MATRIX and len(whole.data):
            head_of = _Head.of(whole.data, order)
            yield head_of.name, head_of.matrix(whole.data, order) if head_of.name in wanted else None


class _Head(NamedTuple):
    name: str
    bits: int
    shape: tuple[int, ...]
    end: int

    @classmethod
    def of(cls, data: memoryview, order: str) -> _Head:
        flags = _Element.at(data, 0, order)
        sizes = _Element.at(data, flags.end, order)
        name = _Element.at(data, sizes.end, order)
        if flags.kind != 6 or len(flags.data) != 8 or sizes.kind not in (5, 6):
            raise ValueError("a matrix without its kind or its shape")
        bits, shape = int(flags.numbers(order)[0]), tuple(sizes.numbers(order).tolist())
        return cls(bytes(name.data).decode("latin-1"), bits, shape, name.end)

    @property
    def kind(self) -> int:
        """The class of the array."""
        return self.bits & 0xFF

    def matrix(self, data: memoryview, order: str) -> Any:
        """Return the matrix whose numbers follow."""
        if self.kind != SPARSE and self.kind not in NUMERIC:
            raise UnreadableFile(f"{self.name} is {OTHERS.get(self.kind, 'no array')}; save a matrix of numbers")
        if self.bits & IS_COMPLEX:
            raise UnreadableFile(f"{self.name} is complex; save real numbers")
        if len(self.shape) != 2 or min(self.shape) < 0:
            raise UnreadableFile(f"{self.name} has the shape {self.shape}; save a matrix or a vector")
        first = _Element.at(data, self.end, order)
        if self.kind in NUMERIC:
            return _dense(self.name, first.numbers(order), self.shape)
        columns = _Element.at(data, first.end, order)
        values = _Element.at(data, columns.end, order)
        if self.bits & IS_LOGICAL:  # bytes, which MATLAB calls doubles
            values = values._replace(kind=2)
        return _sparse(self.name, values.numbers(order), first.numbers(order), columns.numbers(order), self.shape)


def _dense(name: str, numbers: Any, shape: tuple[int, ...]) -> Any:
    if numbers.size != shape[0] * shape[1]:
        raise ValueError(f"{name} is {shape[0]} × {shape[1]}, but has {numbers.size} numbers")
    return numbers.astype(numbers.dtype.newbyteorder("=")).reshape(shape, order="F")


def _sparse(name: str, values: Any, rows: Any, ends: Any, shape: tuple[int, ...]) -> sp.csc_array:
    """Return the matrix by columns; room that was kept for more entries is left out."""
    if ends.size != shape[1] + 1 or ends.dtype.kind not in "iu" or rows.dtype.kind not in "iu":
        raise ValueError(f"{name} has {ends.size} ends of columns, and {shape[1]} columns")
    count = int(ends[-1])
    if not 0 <= count <= min(values.size, rows.size):
        raise ValueError(f"{name} has {values.size} numbers at {rows.size} places, but {count} entries")
    parts = values[:count], rows[:count], ends
    found = sp.csc_array(tuple(part.astype(part.dtype.newbyteorder("=")) for part in parts), shape=shape)
    found.check_format(full_check=True)
    return found


# --- version 4 ----------------------------------------------------------------------------------------------


def _old_matrices(content: memoryview, wanted: Collection[str]) -> Iterator[tuple[str, Any]]:
    place, order = 0, "<" if struct.unpack_from("<I", content)[0] < 5000 else ">"
    while place < len(content):
        code, rows, columns, is_complex, length = struct.unpack_from(order + "5i", content, place)
        machine, number, form = code // 1000, code // 10 % 10, code % 10
        if machine != (order == ">") or code // 100 % 10 or number >= len(OLD_TYPES) or form > 2:
            raise ValueError(f"a matrix of the unknown type {code}")
        if min(rows, columns, length) < 0 or is_complex not in (0, 1):
            raise ValueError(f"a matrix of {rows} × {columns} numbers, with a name of {length} bytes")
        kind = np.dtype(order + OLD_TYPES[number])
        start = place + 20 + length
        name = bytes(content[place + 20 : start]).rstrip(b"\0").decode("latin-1")
        size = rows * columns * kind.itemsize
        data = content[start : start + size]
        if len(data) < size:
            raise ValueError(f"{size} bytes are announced where {len(data)} follow")
        place = start + size * (1 + is_complex)
        if name not in wanted:
            yield name, None
            continue
        if form == 1 or is_complex or (form == 2 and columns != 3):
            raise UnreadableFile(f"{name} is {'text' if form == 1 else 'complex'}; save a matrix of real numbers")
        numbers = _dense(name, np.frombuffer(data, kind), (rows, columns))
        yield name, _listed(name, numbers) if form == 2 else numbers


def _listed(name: str, listed: Any) -> sp.csc_array:
    """Return the sparse matrix of rows (i, j, m_ij), the last of which gives the shape."""
    given = listed[:, :2].astype(np.float64)
    if not len(given) or not ((given >= 0.0) & (given < 2**31)).all() or (np.floor(given) != given).any():
        raise ValueError(f"{name} has no whole numbers for places")
    places = given.astype(np.int64)
    shape, inner = tuple(places[-1].tolist()), places[:-1] - 1
    if min(shape) < 0 or max(shape) > len(listed) + 2**24 or (inner < 0).any() or (inner >= shape).any():
        raise ValueError(f"{name} has entries outside of {shape[0]} × {shape[1]}")
    return sp.csc_array(sp.coo_array((listed[:-1, 2], inner.T), shape=shape))
