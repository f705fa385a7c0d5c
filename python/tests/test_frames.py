from __future__ import annotations

import array
import unittest

import support  # noqa: F401

from scopeservo_driver.errors import Fault
from scopeservo_driver.frames import pack


class Described:
    """Has tobytes(), shape and dtype, but no buffer, as arrays of some libraries."""

    def __init__(self, data: bytes, shape: tuple[int, ...], dtype: str) -> None:
        self._data = data
        self.shape = shape
        self.dtype = dtype

    def tobytes(self) -> bytes:
        return self._data


class Frames(unittest.TestCase):
    def test_bytes_pass_as_they_are(self) -> None:
        for pixels in (b"abcdef", bytearray(b"abcdef"), memoryview(b"abcdef"), array.array("B", b"abcdef")):
            with self.subTest(kind=type(pixels)):
                self.assertEqual(pack(pixels, "rgb", 3, 2, 1, 8), b"abcdef")

    def test_shape_is_rows_by_pixels(self) -> None:
        view = memoryview(b"abcdef").cast("B", (2, 3))
        self.assertEqual(pack(view, "rgb", 3, 2, 1, 8), b"abcdef")
        self.assertEqual(pack(memoryview(b"abcdef").cast("B", (2, 3, 1)), "rgb", 3, 2, 1, 8), b"abcdef")
        with self.assertRaises(Fault):
            pack(view, "rgb", 2, 3, 1, 8)

    def test_views_with_gaps(self) -> None:
        every_second = memoryview(b"a-b-c-d-e-f-")[::2]
        self.assertEqual(pack(every_second, "rgb", 3, 2, 1, 8), b"abcdef")

    def test_sixteen_bits_have_the_low_byte_first(self) -> None:
        wanted = b"\x01\x02\x03\x04"
        self.assertEqual(pack(Described(b"\x01\x02\x03\x04", (1, 2), "<u2"), "rgb", 2, 1, 1, 12), wanted)
        self.assertEqual(pack(Described(b"\x02\x01\x04\x03", (1, 2), ">u2"), "rgb", 2, 1, 1, 12), wanted)
        numbers = array.array("H", [0x0201, 0x0403])
        self.assertEqual(pack(numbers, "rgb", 2, 1, 1, 16), wanted)

    def test_colour_loses_its_alpha_and_gets_its_order(self) -> None:
        rgb = b"RGBrgb"
        self.assertEqual(pack(rgb, "rgb", 2, 1, 3, 8), rgb)
        self.assertEqual(pack(b"BGRbgr", "bgr", 2, 1, 3, 8), rgb)
        self.assertEqual(pack(b"RGBArgba", "rgb", 2, 1, 3, 8), rgb)
        self.assertEqual(pack(b"BGRAbgra", "bgr", 2, 1, 3, 8), rgb)
        self.assertEqual(pack(Described(b"BGRAbgra", (1, 2), "uint32"), "bgr", 2, 1, 3, 8), rgb)
        self.assertEqual(pack(b"BbGgRrAa", "bgr", 1, 1, 3, 16), b"RrGgBb")

    def test_what_does_not_fit_is_a_fault(self) -> None:
        for pixels, bits in (
            (b"abcde", 8),
            (b"abcdef", 12),
            (array.array("f", [1.0] * 6), 8),
            (array.array("h", [1] * 6), 16),
            (Described(b"abcdef", (2, 3), "bool"), 8),
            (Described(b"abcdefabcdef", (2, 3), "<u2"), 8),
            (memoryview(b"abcdefabcdef").cast("B", (2, 6)), 12),
            ("abcdef", 8),
            (None, 8),
        ):
            with self.subTest(pixels=pixels), self.assertRaises(Fault):
                pack(pixels, "rgb", 3, 2, 1, bits)
        with self.assertRaises(Fault):
            pack(b"RGBrgb", "grb", 2, 1, 3, 8)


if __name__ == "__main__":
    unittest.main()
