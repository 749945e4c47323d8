"""Reads glTF 2.0 as a document: the container, its JSON, buffers, accessors and pictures.

.glb holds JSON and one buffer; .gltf is JSON with its buffers beside it or inside as data URIs. What a file says of its
own sizes is checked against what is there, so that a cut file is an error and not a wrong picture.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from raygrid.host.scene.builder import shown
from raygrid.host.scene.file_access import read_bytes
from raygrid.host.text.clean_text import unreadable
from raygrid.node.errors import SceneError
from raygrid.node.geometry import F64

COMPONENTS: dict[int, str] = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MAX_VALUES = 2**31  # of one accessor
MAX_ZEROS = 2**24  # of one that has no bytes of its own, but what it is sparse in: the file's length is no bound for it
MOST_JSON = 2**24  # values of the document, each of which takes a hundred bytes
LONGEST_NAME = 2**14  # of a file
LONGEST_PLAIN = 2**24  # of a data URI without base64, a hundred bytes each in turn


JsonObject = dict[str, Any]  # free-form: `gltf.load_gltf` turns what its use raises into an error of the file
Values = NDArray[Any]  # of the type that the file names


class Document:
    """One glTF file. Raises SceneError with the file and the place in it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text, self._binary = self._container(read_bytes(path))
        values = sum(text.count(mark) for mark in (b",", b"[", b"{"))
        if values > MOST_JSON:
            raise self.error(f"the JSON has {values:,} values or so, wanted at most {MOST_JSON:,}")
        try:
            self.json = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise self.error(f"the JSON cannot be read ({unreadable(error)})") from None
        if not isinstance(self.json, dict) or not isinstance(self.json.get("asset"), dict):
            raise self.error("the JSON has no asset, wanted a glTF document")
        version = str(self.json["asset"].get("version", ""))
        if not version.startswith("2."):
            raise self.error(f"the file is of glTF version {shown(version)}, wanted 2.0")
        self._buffers: dict[object, bytes] = {}

    def error(self, message: str) -> SceneError:
        """An error about this file."""
        return SceneError(f"{self.path}: {message}")

    def item(self, table: str, number: object) -> JsonObject:
        """Entry `number` of a top-level list; raises SceneError if there is none."""
        rows = self.json.get(table, [])
        if not isinstance(number, int) or not isinstance(rows, list) or not 0 <= number < len(rows):
            raise self.error(f"came {table}[{shown(number)}], but there are {len(rows)}")
        row = rows[number]
        if not isinstance(row, dict):
            raise self.error(f"{table}[{number}] is {shown(row)}, wanted an object")
        return row

    def accessor(self, number: object) -> Values:
        """The values of an accessor, (count, width); normalised integers as float64."""
        row = self.item("accessors", number)
        where = f"accessors[{number}]"
        dtype, width = np.dtype(COMPONENTS[row["componentType"]]), WIDTHS[row["type"]]
        count = self._size(row, "count", where)
        if count * width > MAX_VALUES:
            raise self.error(f"{where} has {count} values, wanted at most {MAX_VALUES // width}")
        in_view = "bufferView" in row
        if not in_view and count * width > MAX_ZEROS:
            raise self.error(f"{where} has {count} values and no bufferView, wanted at most {MAX_ZEROS // width}")
        values = self._strided(row, dtype, width, count, where) if in_view else np.zeros((count, width), dtype)
        if "sparse" in row:
            values = self._with_exceptions(values, row["sparse"], where)
        if row.get("normalized") and dtype.kind in "iu":
            scaled: F64 = np.maximum(values / np.iinfo(dtype).max, -1.0)
            return scaled
        return values

    def picture(self, number: object) -> tuple[bytes, str]:
        """The bytes of an image, and what to call it."""
        row = self.item("images", number)
        where = f"{self.path}, images[{number}]"
        if "bufferView" in row:
            return self._view(row["bufferView"])[0], where
        return self._resource(row.get("uri"), f"images[{number}]"), where

    def _container(self, data: bytes) -> tuple[bytes, bytes | None]:
        """The JSON text and the binary chunk, if any."""
        if not data.startswith(b"glTF"):
            return data, None
        if len(data) < 20:
            raise self.error(f"the file ends inside its header, after {len(data)} bytes")
        length = int(struct.unpack_from("<I", data, 8)[0])
        if len(data) < length:
            raise self.error(f"the file has {len(data)} bytes, but says that it has {length}: it is cut")
        chunks: dict[int, bytes] = {}
        at = 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if at + 8 + size > length:
                raise self.error(f"a chunk of {size} bytes begins at byte {at}, but the file ends at {length}")
            chunks.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size + (-size) % 4
        if JSON_CHUNK not in chunks:
            raise self.error("the file has no JSON chunk, wanted one")
        return chunks[JSON_CHUNK], chunks.get(BINARY_CHUNK)

    def _size(self, row: JsonObject, key: str, where: str, default: int | None = None) -> int:
        value = row.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.error(f"{where}.{key} is {shown(value)}, wanted a whole number, not below 0")
        return value

    def _view(self, number: object) -> tuple[bytes, int]:
        """The bytes of a buffer view and its stride, 0 for none."""
        row = self.item("bufferViews", number)
        where = f"bufferViews[{number}]"
        data = self._buffer(row.get("buffer"))
        start, length = self._size(row, "byteOffset", where, 0), self._size(row, "byteLength", where)
        if start + length > len(data):
            raise self.error(f"{where} ends at byte {start + length} of a buffer of {len(data)} bytes")
        return data[start : start + length], self._size(row, "byteStride", where, 0)

    def _buffer(self, number: object) -> bytes:
        row = self.item("buffers", number)
        if number not in self._buffers:
            if "uri" in row:
                self._buffers[number] = self._resource(row["uri"], f"buffers[{number}]")
            elif number == 0 and self._binary is not None:
                self._buffers[number] = self._binary
            else:
                raise self.error(f"buffers[{number}] has no uri, and the file has no binary chunk for it")
        data, length = self._buffers[number], self._size(row, "byteLength", f"buffers[{number}]")
        if len(data) < length:
            raise self.error(f"buffers[{number}] has {len(data)} bytes, wanted {length}")
        return data

    def _resource(self, uri: object, where: str) -> bytes:
        if not isinstance(uri, str):
            raise self.error(f"{where}.uri is {shown(uri)}, wanted a text")
        if not uri.startswith("data:"):
            if len(uri) > LONGEST_NAME:
                raise self.error(f"{where}.uri has {len(uri):,} characters, wanted the name of a file")
            return read_bytes(self.path.parent / unquote(uri))
        head, _, body = uri.partition(",")
        if not head.endswith(";base64"):
            if len(body) > LONGEST_PLAIN:
                raise self.error(
                    f"{where}.uri has {len(body):,} characters, wanted base64 for more than {LONGEST_PLAIN:,}"
                )
            return unquote(body).encode("latin-1", "replace")
        try:
            return base64.b64decode(body, validate=True)
        except binascii.Error as error:
            raise self.error(f"{where}.uri is no base64 ({error})") from None

    def _strided(self, row: JsonObject, dtype: np.dtype[np.generic], width: int, count: int, where: str) -> Values:
        data, stride = self._view(row["bufferView"])
        start, size = self._size(row, "byteOffset", where, 0), dtype.itemsize * width
        stride = stride or size
        if stride < size:
            raise self.error(f"{where} has values of {size} bytes every {stride} bytes, wanted them apart")
        if count and start + (count - 1) * stride + size > len(data):
            needed = start + (count - 1) * stride + size
            raise self.error(f"{where} needs {needed} bytes of a buffer view of {len(data)}")
        return (
            np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize)).copy()
            if count
            else np.zeros((0, width), dtype)
        )

    def _with_exceptions(self, values: Values, sparse: JsonObject, where: str) -> Values:
        count = self._size(sparse, "count", f"{where}.sparse")
        kind = np.dtype(COMPONENTS[sparse["indices"]["componentType"]])
        rows = self._strided(sparse["indices"], kind, 1, count, f"{where}.sparse.indices")[:, 0]
        if count and int(rows.max()) >= len(values):
            raise self.error(f"{where}.sparse names the value {int(rows.max())} of {len(values)}")
        values[rows] = self._strided(sparse["values"], values.dtype, values.shape[1], count, f"{where}.sparse.values")
        return values
