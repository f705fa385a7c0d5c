"""A driver as a process of its own, on standard input and output."""

from __future__ import annotations

import os
import re
import signal
import time
import unittest
from pathlib import Path

from support import DriverProcess

EXAMPLE = str(Path(__file__).with_name("example_driver.py"))


class Process(unittest.TestCase):
    def test_printing_does_not_break_it(self) -> None:
        with DriverProcess(EXAMPLE, "--chatty") as driver:
            client = driver.client
            client.hello()
            client.go(x_um=150)
            client.do("bye")
            self.assertEqual(driver.wait(), 0)
            self.assertTrue(client.ended.wait(5))
            self.assertEqual(client.not_messages, [])
            for text in (
                "printed before serve was called",
                "a library says hello",
                "straight to file descriptor 1",
                "a child process says hello",
                "cleaned up",
            ):
                self.assertIn(text, driver.errors())

    def test_the_end_of_the_input_stops_and_ends_also_during_a_long_grab(self) -> None:
        with DriverProcess(EXAMPLE) as driver:
            driver.client.hello()
            driver.client.do("exposure", exposure_ms=5000)
            driver.client.do("move", x_um=40000)
            driver.client.send("grab")
            time.sleep(0.1)
            closed_s = time.monotonic()
            driver.close_input()
            self.assertEqual(driver.wait(), 0)
            self.assertLess(time.monotonic() - closed_s, 3)
            self.assertIn("told to stop", driver.errors())
            self.assertIn("cleaned up", driver.errors())

    def test_a_hanging_thread_does_not_keep_it_alive(self) -> None:
        with DriverProcess(EXAMPLE, "--hanging-thread") as driver:
            driver.client.hello()
            driver.close_input()
            self.assertEqual(driver.wait(10), 0)

    def test_stop_is_answered_during_a_slow_grab(self) -> None:
        with DriverProcess(EXAMPLE) as driver:
            client = driver.client
            client.hello()
            client.do("exposure", exposure_ms=3000)
            grab = client.send("grab")
            time.sleep(0.2)
            asked_s = time.monotonic()
            client.do("stop")
            self.assertLess(time.monotonic() - asked_s, 2)
            self.assertEqual(client.answer(grab)["bytes"], 48)

    @unittest.skipUnless(os.name == "posix", "signals as POSIX has them")
    def test_termination_stops(self) -> None:
        with DriverProcess(EXAMPLE) as driver:
            driver.client.hello()
            driver.client.do("move", x_um=40000)
            driver.signal(signal.SIGTERM)
            self.assertEqual(driver.wait(), 128 + signal.SIGTERM)
            self.assertIn("told to stop", driver.errors())

    @unittest.skipUnless(os.name == "posix", "signals as POSIX has them")
    def test_an_interrupt_stops_and_leaves_the_end_to_the_program(self) -> None:
        with DriverProcess(EXAMPLE) as driver:
            client = driver.client
            client.hello()
            client.do("move", x_um=40000)
            driver.signal(signal.SIGINT)
            self.assertEqual(client.wait_until_still(timeout_s=3)["motion"], "stopped")
            client.do("bye")
            self.assertEqual(driver.wait(), 0)

    def test_the_example_of_the_readme_is_a_driver(self) -> None:
        readme = Path(__file__).parent.parent / "README.md"
        code = re.search(r"```python\n(.*?)```", readme.read_text(encoding="utf-8"), re.DOTALL)
        assert code is not None
        with DriverProcess("-c", code.group(1)) as driver:
            client = driver.client
            said = client.hello()
            self.assertIn("stage", said)
            x_axis = said["stage"]["axes"][0]
            self.assertEqual(client.ask("move", x_um=x_axis["max_um"] + 1)["error"], "outside_limits")
            self.assertEqual(client.go(x_um=123.5)["x_um"], 123.5)
            frame = client.do("grab")
            self.assertEqual(len(frame["samples"]), frame["width_px"] * frame["height_px"])
            client.do("bye")
            self.assertEqual(driver.wait(), 0)


if __name__ == "__main__":
    unittest.main()
