"""A driver's conversation over pipes within this process, for the tests of it."""

from __future__ import annotations

import contextlib
import io
import os
import threading
import unittest
from typing import Any

from support import Client

from scopeservo_driver.instrument import Instrument
from scopeservo_driver.serving import PipeChannel
from scopeservo_driver.session import Session


class Conversing(unittest.TestCase):
    def talk(self, **devices: Any) -> Client:
        """A client that has said hello to a driver of `devices`."""
        client = self.connect(**devices)
        client.hello()
        return client

    def connect(self, **devices: Any) -> Client:
        to_driver, from_client = os.pipe()
        to_client, from_driver = os.pipe()
        all_devices = {"stage": None, "camera": None, "nosepiece": None, "light": None, **devices}
        self.session = Session(Instrument(**all_devices, name="test"), PipeChannel(to_driver, from_driver))
        thread = threading.Thread(target=self.session.run)
        thread.start()
        self.input = from_client

        def end() -> None:
            with contextlib.suppress(OSError):
                os.close(self.input)
            thread.join(10)
            os.close(from_driver)
            client.ended.wait(10)
            os.close(to_driver)
            os.close(to_client)

        self.addCleanup(end)
        client = Client(lambda size: os.read(to_client, size), lambda data: os.write(from_client, data))
        return client

    def error(self, reply: dict[str, Any]) -> str:
        self.assertNotIn("ok", reply)
        self.assertTrue(reply["message"])
        return reply["error"]

    def quietly(self) -> contextlib.AbstractContextManager[Any]:
        return contextlib.redirect_stderr(io.StringIO())
