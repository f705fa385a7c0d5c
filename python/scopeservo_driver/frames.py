"""Pixels of any kind to the bytes of the protocol, without numpy."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

from .errors import Fault

_UNSIGNED = ("B", "c", "H", "I", "L", "Q", "u1", "u2", "u4", "u8", "uint8", "uint16", "uint32", "uint64")


@dataclass(frozen=True)
class _Raw:
    """What a driver's class gave: bytes in C order, and, where it tells, shape, bytes of an element and their order."""

    data: bytes
    shape: tuple[int, ...] | None
    element_bytes: int | None
    big_endian: bool


def _read(pixels: Any) -> _Raw:
    try:
        view = memoryview(pixels)
    except (TypeError, ValueError):
        view = None
    if view is not None:
        data, shape, kind = view.tobytes(), view.shape, view.format
        if view.ndim == 1 and kind in ("B", "c"):
            return _Raw(data, None, None, False)
    elif hasattr(pixels, "tobytes"):
        data, shape = bytes(pixels.tobytes()), getattr(pixels, "shape", None)
        dtype = getattr(pixels, "dtype", None)
        if dtype is None:
            return _Raw(data, shape, None, False)
        kind = str(getattr(dtype, "str", dtype))
    else:
        raise Fault(f"the camera's class gave a {type(pixels).__name__} instead of pixels")
    if kind.lstrip("<>|=@!") not in _UNSIGNED:
        raise Fault(f"the camera's class gave samples of type {kind}; they must be unsigned, of 8 or 16 bits")
    big_endian = kind[0] in ">!" or (kind[0] not in "<|" and sys.byteorder == "big")
    if shape is None or len(shape) == 1:
        return _Raw(data, None, None, big_endian)
    shape = tuple(int(n) for n in shape)
    elements = math.prod(shape)
    return _Raw(data, shape, len(data) // elements if elements else None, big_endian)


def pack(pixels: Any, order: str, width_px: int, height_px: int, channels: int, bits: int) -> bytes:
    """The samples as the protocol wants them, or Fault when they do not fit what the camera said in hello."""
    if order not in ("rgb", "bgr"):
        raise Fault(f"the camera's class gave pixels in the order {order}; it must be rgb or bgr")
    raw = _read(pixels)
    if raw.shape is not None and (len(raw.shape) > 3 or raw.shape[:2] != (height_px, width_px)):
        raise Fault(f"the camera's class gave pixels of shape {raw.shape} instead of {height_px} rows of {width_px}")
    sample_bytes = 1 if bits <= 8 else 2
    count = width_px * height_px
    samples = channels
    allowed_element_bytes = [None, sample_bytes]
    if channels == 3 and len(raw.data) == count * 4 * sample_bytes:
        # A fourth sample that is not wanted; perhaps all four in one number.
        samples = 4
        allowed_element_bytes.append(4 * sample_bytes)
    elif len(raw.data) != count * channels * sample_bytes:
        raise Fault(f"the camera's class gave {len(raw.data)} bytes instead of {count * channels * sample_bytes}")
    if raw.element_bytes not in allowed_element_bytes:
        raise Fault(f"the camera's class gave samples of {raw.element_bytes} bytes, but said {bits} bits")
    data = raw.data
    if raw.big_endian and sample_bytes == 2:
        swapped = bytearray(len(data))
        swapped[0::2], swapped[1::2] = data[1::2], data[0::2]
        data = bytes(swapped)
    if channels == 1 or (samples == 3 and order == "rgb"):
        return data
    packed = bytearray(count * 3 * sample_bytes)
    for channel in range(3):
        source = channel if order == "rgb" else 2 - channel
        for byte in range(sample_bytes):
            packed[channel * sample_bytes + byte :: 3 * sample_bytes] = data[
                source * sample_bytes + byte :: samples * sample_bytes
            ]
    return bytes(packed)
