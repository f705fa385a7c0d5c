from __future__ import annotations

import json
import unittest

import support  # noqa: F401

from scopeservo_driver.errors import BadRequest
from scopeservo_driver.messages import MAX_LINE_BYTES, LineSplitter, NotUnderstood, parse_request


def lines(*parts: bytes) -> list[bytes | None]:
    splitter = LineSplitter()
    return [line for part in parts for line in splitter.feed(part)]


class Lines(unittest.TestCase):
    def test_any_cut_gives_the_same_lines(self) -> None:
        text = b'{"id":1}\r\n{"id":2}\n\n{"half'
        wanted = [b'{"id":1}', b'{"id":2}', b""]
        self.assertEqual(lines(text), wanted)
        self.assertEqual(lines(*[bytes([byte]) for byte in text]), wanted)

    def test_the_longest_line_passes_and_one_byte_more_does_not(self) -> None:
        longest = b"a" * (MAX_LINE_BYTES - 1)
        self.assertEqual(lines(longest + b"\nb\n"), [longest, b"b"])
        self.assertEqual(lines(longest + b"a\nb\n"), [None, b"b"])
        self.assertEqual(lines(longest, b"a", b"a" * 200000, b"\n", b"b\n"), [None, b"b"])

    def test_an_endless_line_takes_no_memory(self) -> None:
        splitter = LineSplitter()
        seen = [line for _ in range(100) for line in splitter.feed(b"a" * 65536)]
        self.assertEqual(seen, [None])
        self.assertLess(len(splitter._buffer), MAX_LINE_BYTES)


class Requests(unittest.TestCase):
    def id_of_refusal(self, line: bytes) -> int | None:
        with self.assertRaises(NotUnderstood) as caught:
            parse_request(line)
        return caught.exception.id

    def test_what_is_no_request(self) -> None:
        for line in (
            b"",
            b"hello",
            b"[1]",
            b"null",
            b'{"call":"stop"}',
            b'{"id":0,"call":"stop"}',
            b'{"id":-1,"call":"stop"}',
            b'{"id":9007199254740993,"call":"stop"}',
            b'{"id":1.5,"call":"stop"}',
            b'{"id":true,"call":"stop"}',
            b'{"id":"1","call":"stop"}',
            b'{"id":1,"call":"move","x_um":NaN}',
            b'{"id":1,"call":"move","x_um":-Infinity}',
            b'{"id":1,"call":"\xff"}',
            b"[" * 60000,
            b'{"id":' + b"1" * 5000 + b"}",
        ):
            with self.subTest(line=line[:40]):
                self.assertIsNone(self.id_of_refusal(line))
        self.assertEqual(self.id_of_refusal(b'{"id":7}'), 7)
        self.assertEqual(self.id_of_refusal(b'{"id":7,"call":3}'), 7)

    def test_numbers_are_finite_numbers(self) -> None:
        for text in ("1e999", "-1e999", "1" + "0" * 400, "true", "null", '"1"', "[1]"):
            request = parse_request(f'{{"id":1,"call":"move","x_um":{text}}}'.encode())
            with self.subTest(text=text[:10]), self.assertRaises(BadRequest):
                request.number("x_um")
        self.assertEqual(parse_request(b'{"id":1,"call":"move","x_um":3}').number("x_um"), 3.0)

    def test_unknown_fields_are_ignored(self) -> None:
        request = parse_request(json.dumps({"id": 2**53, "call": "stop", "later": [1]}).encode())
        self.assertEqual((request.id, request.call), (2**53, "stop"))


if __name__ == "__main__":
    unittest.main()
