"""Pictures of a driver compared with each other. Needs numpy, which every library with a ready driver brings along."""

from __future__ import annotations

from typing import Any

from support import Client


def grab(client: Client) -> Any:
    """A frame as an array of floats, the mean of its channels."""
    import numpy

    frame = client.do("grab")
    kind = "u1" if frame["bits"] == 8 else "<u2"
    shape = (frame["height_px"], frame["width_px"], frame["channels"])
    return numpy.frombuffer(frame["samples"], kind).reshape(shape).astype(float).mean(axis=2)


def shift_px(before: Any, after: Any) -> tuple[tuple[int, int], float]:
    """How far the content went from `after` to `before`, right and down, and how sure that is (1 for equal pictures)."""
    import numpy

    product = numpy.fft.fft2(before - before.mean()) * numpy.fft.fft2(after - after.mean()).conj()
    peaks = numpy.fft.ifft2(product / (abs(product) + 1e-9)).real
    row, column = numpy.unravel_index(peaks.argmax(), peaks.shape)
    height, width = before.shape
    right, down = (column + width // 2) % width - width // 2, (row + height // 2) % height - height // 2
    return (int(right), int(down)), float(peaks.max())


def reduced(picture: Any, by: int) -> Any:
    """The picture with blocks of `by` times `by` pixels averaged."""
    height, width = picture.shape
    return picture.reshape(height // by, by, width // by, by).mean(axis=(1, 3))


def middle(picture: Any, part: int) -> Any:
    """The middle of the picture, a `part`-th of its width and height."""
    height, width = picture.shape
    top, left = (height - height // part) // 2, (width - width // part) // 2
    return picture[top : top + height // part, left : left + width // part]
