"""Lines in, requests out; replies in, lines out."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from .errors import BadRequest

MAX_LINE_BYTES = 65536
MAX_ID = 2**53


class LineSplitter:
    """Cuts a stream of bytes into lines. A line that is too long comes out as None, and its rest is skipped."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        """The lines that `data` completes, without their line feed and a carriage return before it."""
        self._buffer += data
        while True:
            end = self._buffer.find(b"\n")
            if end < 0:
                break
            line = bytes(self._buffer[:end])
            del self._buffer[: end + 1]
            if self._skipping:
                self._skipping = False
            elif end + 1 > MAX_LINE_BYTES:
                yield None
            else:
                yield line.removesuffix(b"\r")
        if len(self._buffer) >= MAX_LINE_BYTES:
            self._buffer.clear()
            if not self._skipping:
                self._skipping = True
                yield None


class Request:
    """One request that was understood as far as its id and its call."""

    def __init__(self, id: int, call: str, fields: dict[str, Any]) -> None:
        self.id = id
        self.call = call
        self.fields = fields

    def __contains__(self, field: str) -> bool:
        return field in self.fields

    def number(self, field: str) -> float:
        """A finite number, or BadRequest."""
        value = self.fields.get(field)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise BadRequest(f"{field} must be a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise BadRequest(f"{field} must be finite")
        return number

    def text(self, field: str) -> str:
        """A string, or BadRequest."""
        value = self.fields.get(field)
        if not isinstance(value, str):
            raise BadRequest(f"{field} must be a string")
        return value


class NotUnderstood(BadRequest):
    """A line that is no request; `id` is its id when that could be read."""

    def __init__(self, id: int | None, message: str) -> None:
        super().__init__(message)
        self.id = id


def _refuse_constant(word: str) -> None:
    raise ValueError(f"{word} is not allowed in JSON")


def parse_request(line: bytes) -> Request:
    """The request on a line, or NotUnderstood."""
    try:
        fields = json.loads(line.decode("utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise NotUnderstood(None, f"a request must be one line of JSON: {error}") from None
    if not isinstance(fields, dict):
        raise NotUnderstood(None, "a request must be a JSON object")
    id = fields.get("id")
    if isinstance(id, bool) or not isinstance(id, int) or not 1 <= id <= MAX_ID:
        raise NotUnderstood(None, "a request needs an id, a whole number from 1 to 2^53")
    call = fields.get("call")
    if not isinstance(call, str):
        raise NotUnderstood(id, "a request needs call, a string")
    return Request(id, call, fields)


def encode(fields: dict[str, Any]) -> bytes:
    """A reply as its line."""
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode("ascii") + b"\n"


def encode_error(id: int | None, code: str, message: str, **more: str) -> bytes:
    """An error as its line; an overlong message is cut."""
    return encode({"id": id, "error": code, "message": message[:4000], **more})
