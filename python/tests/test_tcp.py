"""A driver that listens on a TCP port."""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import io
import re
import socket
import time
import unittest
from pathlib import Path
from unittest import mock

from support import Client, DriverProcess, Lamp

from scopeservo_driver import serve_tcp, serving

EXAMPLE = str(Path(__file__).with_name("example_driver.py"))
SECRET = "ein sehr geheimes Wörtchen"


class Tcp(unittest.TestCase):
    def start(self, secret: str) -> DriverProcess:
        driver = DriverProcess(EXAMPLE, "--tcp", "127.0.0.1", secret)

        def end() -> None:
            driver._process.terminate()
            driver.__exit__()

        self.addCleanup(end)
        deadline = time.monotonic() + 10
        while not (found := re.search(r"port (\d+)", driver.errors())):
            self.assertLess(time.monotonic(), deadline, driver.errors())
            time.sleep(0.02)
        self.port = int(found.group(1))
        return driver

    def connect(self) -> Client:
        connection = socket.create_connection(("127.0.0.1", self.port), timeout=20)
        client = Client(connection.recv, connection.sendall)
        client.close = connection.close  # type: ignore[attr-defined]

        def end() -> None:
            try:
                connection.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            client.ended.wait(5)
            connection.close()

        client.disconnect = end  # type: ignore[attr-defined]
        self.addCleanup(end)
        return client

    def proof(self, nonce: str, secret: str) -> str:
        return hmac.new(secret.encode(), nonce.encode(), hashlib.sha256).hexdigest()

    def nonce(self, client: Client) -> str:
        reply = client.ask("hello", protocol=1)
        self.assertEqual(reply["error"], "secret")
        self.assertRegex(reply["nonce"], r"^[0-9a-f]{32,}$")
        return reply["nonce"]

    def test_the_right_secret(self) -> None:
        self.start(SECRET)
        client = self.connect()
        nonce = self.nonce(client)
        for call in ("stop", "light", "position", "bye"):
            self.assertEqual(client.ask(call)["error"], "refused")
        said = client.do("hello", protocol=1, proof=self.proof(nonce, SECRET))
        self.assertEqual(said["name"], "example")
        client.do("light", level=0.5)
        self.assertNotEqual(self.nonce(self.connect()), nonce)

    def test_wrong_and_missing_proofs_close_the_connection(self) -> None:
        self.start(SECRET)
        right_elsewhere = self.proof(self.nonce(self.connect()), SECRET)
        for fields in (
            {"proof": "wrong"},
            {"proof": "wröng"},
            {"proof": "\udcff"},
            {"proof": 5},
            {},
            {"proof": right_elsewhere},
        ):
            client = self.connect()
            self.nonce(client)
            self.assertEqual(client.ask("hello", protocol=1, **fields)["error"], "refused")
            self.assertTrue(client.ended.wait(5))
        client = self.connect()
        upper = self.proof(self.nonce(client), SECRET).upper()
        self.assertEqual(client.ask("hello", protocol=1, proof=upper)["error"], "refused")

    def test_no_secret_is_asked_for_on_this_machine_alone(self) -> None:
        self.start("")
        self.connect().hello()

    def test_other_addresses_need_a_secret(self) -> None:
        for host in ("0.0.0.0", "", "192.0.2.1"):
            with self.subTest(host=host), self.assertRaisesRegex(ValueError, "secret"):
                serve_tcp(light=Lamp(), host=host, port=0)
        with self.assertRaisesRegex(ValueError, "empty"):
            serve_tcp(light=Lamp(), port=0, secret="")

    def test_disconnecting_stops_and_the_next_program_may_come(self) -> None:
        driver = self.start("")
        client = self.connect()
        client.hello()
        client.do("move", x_um=40000)
        second = self.connect()
        self.assertEqual(second.ask("hello", protocol=1)["error"], "busy")
        self.assertTrue(second.ended.wait(5))
        self.assertEqual(client.do("motion")["motion"], "moving")
        client.disconnect()  # type: ignore[attr-defined]
        deadline = time.monotonic() + 5
        while "told to stop" not in driver.errors():
            self.assertLess(time.monotonic(), deadline)
            time.sleep(0.02)
        time.sleep(0.1)
        third = self.connect()
        third.hello()
        self.assertEqual(third.do("motion")["motion"], "stopped")
        third.do("bye")
        self.assertTrue(third.ended.wait(5))

    def test_a_stranger_stops_nothing(self) -> None:
        driver = self.start(SECRET)
        client = self.connect()
        client.do("hello", protocol=1, proof=self.proof(self.nonce(client), SECRET))
        client.do("move", x_um=40000)
        stranger = self.connect()
        self.nonce(stranger)
        stranger.disconnect()  # type: ignore[attr-defined]
        time.sleep(0.3)
        self.assertEqual(client.do("motion")["motion"], "moving")
        self.assertNotIn("told to stop", driver.errors())

    def test_strangers_take_nobodys_place_and_the_longest_there_go(self) -> None:
        self.start(SECRET)
        silent = [socket.create_connection(("127.0.0.1", self.port), timeout=20) for _ in range(serving.STRANGERS + 4)]
        for stranger in silent:
            self.addCleanup(stranger.close)
        client = self.connect()
        client.do("hello", protocol=1, proof=self.proof(self.nonce(client), SECRET))
        for stranger in silent[:4]:
            self.assertEqual(stranger.recv(1), b"")
        more = [socket.create_connection(("127.0.0.1", self.port), timeout=20) for _ in range(serving.STRANGERS + 4)]
        for stranger in more:
            self.addCleanup(stranger.close)
        self.assertEqual(more[0].recv(1), b"")
        self.assertEqual(client.do("motion")["motion"], "settled")


def connected() -> tuple[socket.socket, socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        theirs = socket.create_connection(listener.getsockname())
        return listener.accept()[0], theirs


class Hello(unittest.TestCase):
    def test_it_has_one_deadline_however_slowly_it_is_said(self) -> None:
        for drip in (b" ", b"x", b"{"):
            ours, theirs = connected()
            with ours, theirs, mock.patch.object(serving, "HELLO_WAIT_S", 0.2):
                channel = serving.SocketChannel(ours)
                with self.assertRaises(TimeoutError):
                    while True:
                        theirs.sendall(drip)
                        channel.read()
                        time.sleep(0.01)

    def test_who_is_in_has_as_long_as_he_likes(self) -> None:
        ours, theirs = connected()
        with ours, theirs, mock.patch.object(serving, "HELLO_WAIT_S", 0.1):
            channel = serving.SocketChannel(ours)
            channel.accepted()
            time.sleep(0.2)
            theirs.sendall(b"x")
            self.assertEqual(channel.read(), b"x")

    def test_a_connection_that_cannot_be_taken_does_not_end_the_driver(self) -> None:
        class Ended(BaseException):
            pass

        outcomes = [OSError("too many files"), OSError("too many files"), ConnectionAbortedError("gone"), Ended()]
        listener = mock.Mock()
        listener.accept.side_effect = outcomes
        with contextlib.redirect_stderr(io.StringIO()) as said, self.assertRaises(Ended):
            serving._receive(listener, mock.Mock(), None)
        self.assertEqual(said.getvalue().count("too many files"), 1)
        self.assertEqual(said.getvalue().count("gone"), 1)


if __name__ == "__main__":
    unittest.main()
