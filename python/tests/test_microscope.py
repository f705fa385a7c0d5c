"""The driver for python-microscope, in process and behind its device server."""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
import time
import unittest
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pictures import grab, shift_px
from support import PACKAGE_FOLDER, Client, DriverProcess

from scopeservo_driver import Fault, translation
from scopeservo_driver.python_microscope import MicroscopeStage

MODULE = "scopeservo_driver.microscope"
INSTALLED = find_spec("microscope") is not None
WIDTH_PX, HEIGHT_PX = 1600, 1200


def write_image(path: Path) -> None:
    """Smooth noise, different in each channel."""
    import numpy
    from PIL import Image

    chance = numpy.random.default_rng(5)
    coarse = chance.integers(0, 256, (HEIGHT_PX // 8, WIDTH_PX // 8, 3), dtype=numpy.uint8)
    Image.fromarray(coarse).resize((WIDTH_PX, HEIGHT_PX), Image.Resampling.BICUBIC).save(path)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@unittest.skipUnless(INSTALLED, "python-microscope is not installed")
class PythonMicroscope(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = Path(folder.name)
        cls.image = cls.folder / "specimen.png"
        write_image(cls.image)

    def start(self, *args: str) -> Client:
        self.driver = DriverProcess("-m", MODULE, *args)
        self.addCleanup(self.driver.__exit__)
        return self.driver.client

    def check_picture_follows(self, client: Client) -> None:
        """Move, look, return; change, look, return."""
        place = client.do("position")
        x_um, y_um = place["x_um"], place["y_um"]
        first = grab(client)
        moved = client.go(x_um=x_um + 200, y_um=y_um - 40)
        self.assertEqual((moved["x_um"], moved["y_um"]), (x_um + 200, y_um - 40))
        self.assertEqual(shift_px(first, grab(client))[0], (-200, 40))
        client.go(x_um=x_um + 100, y_um=y_um)
        self.assertEqual(shift_px(first, grab(client))[0], (-100, 0))
        client.go(x_um=x_um)
        self.assertTrue((grab(client) == first).all())
        self.assertEqual(client.change("1")["objective"], "1")
        self.assertLess(shift_px(first, grab(client))[1], 0.3)
        self.assertEqual(client.change("0")["objective"], "0")
        self.assertTrue((grab(client) == first).all())

    def test_over_an_image(self) -> None:
        client = self.start("--image", str(self.image), "--objective", "0:10:0.25:1.0", "--objective", "1:20:0.5:1.0")
        said = client.hello()
        ends = [(axis["min_um"], axis["max_um"]) for axis in said["stage"]["axes"]]
        self.assertEqual(ends, [(0, WIDTH_PX), (0, HEIGHT_PX), (-50, 50)])
        self.check_picture_follows(client)
        # The simulated stage would clip these in silence.
        for goal in ({"x_um": -1}, {"x_um": WIDTH_PX + 0.5}, {"z_um": 51}):
            before = client.do("position")
            self.assertEqual(client.ask("move", **goal)["error"], "outside_limits")
            after = client.do("position")
            self.assertEqual(
                [before[f] for f in ("x_um", "y_um", "z_um")], [after[f] for f in ("x_um", "y_um", "z_um")]
            )
        sharp = grab(client)
        client.go(z_um=30)
        self.assertLess(grab(client).std(), 0.8 * sharp.std())

    def test_stop_during_a_long_exposure(self) -> None:
        client = self.start("--image", str(self.image))
        client.hello()
        self.assertEqual(client.do("exposure", exposure_ms=3000)["exposure_ms"], 3000)
        grabbed = client.send("grab")
        time.sleep(0.2)
        asked_s = time.monotonic()
        client.do("stop")
        self.assertLess(time.monotonic() - asked_s, 2)
        self.assertGreaterEqual(client.answer(grabbed)["age_ms"], 3000)
        client.do("bye")
        self.assertEqual(self.driver.wait(), 0)

    def serve_devices(self) -> int:
        """Run python-microscope's own device server; its port."""
        port = free_port()
        config = self.folder / f"devices_{port}.py"
        config.write_text(
            "from microscope.device_server import device\n"
            "from microscope.simulators.stage_aware_camera import simulated_setup_from_image\n"
            f"DEVICES = [device(simulated_setup_from_image, '127.0.0.1', {port}, conf={{'filepath': {str(self.image)!r}}})]\n",
            encoding="utf-8",
        )
        server = subprocess.Popen(
            [sys.executable, "-m", "microscope.device_server", str(config)],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

        def end() -> None:
            server.terminate()
            try:
                server.wait(15)
            except subprocess.TimeoutExpired:
                server.kill()
                server.wait()

        self.addCleanup(end)
        deadline_s = time.monotonic() + 30
        while time.monotonic() < deadline_s:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                return port
            except OSError:
                time.sleep(0.1)
        raise TimeoutError("the device server did not start")

    def test_behind_its_device_server_twice(self) -> None:
        port = self.serve_devices()
        for _ in range(2):
            client = self.start(
                *[part for device in ("stage", "camera", "filterwheel")
                  for part in (f"--{device}", f"PYRO:{device}@127.0.0.1:{port}")],
                "--exposure-ms", "1", "1000", "--positive-z", "apart",
                "--objective", "0:10:0.25:1.0", "--objective", "1:20:0.5:1.0",
            )  # fmt: skip
            said = client.hello()
            self.assertEqual(said["stage"]["axes"][0]["max_um"], WIDTH_PX)
            self.assertEqual(said["stage"]["positive_z"], "apart")
            self.check_picture_follows(client)
            client.do("bye")
            self.assertEqual(self.driver.wait(), 0)

    def test_what_is_missing_is_said(self) -> None:
        uri = f"PYRO:stage@127.0.0.1:{free_port()}"
        for args, words in (
            ([], "give either"),
            (["--image", str(self.image), "--stage", uri], "give either"),
            (["--image", "/none/such.png"], "such.png"),
            (["--image", str(self.image), "--x-um", "-1", "100"], "within the stage's own limits"),
            (["--image", str(self.image), "--objective", "7:10:0.25:1.0"], "positions, 0, 1, 2"),
            (["--camera", uri], "--exposure-ms"),
            (["--stage", uri], "connect"),
        ):
            with self.subTest(args=args):
                done = subprocess.run(
                    [sys.executable, "-m", MODULE, *args],
                    cwd=PACKAGE_FOLDER,
                    stdin=subprocess.DEVNULL,
                    capture_output=True,
                    text=True,
                    timeout=60,
                )
                self.assertEqual((done.returncode, done.stdout), (2, ""), done.stderr)
                self.assertIn(words, done.stderr)
                self.assertNotIn("Traceback", done.stderr)


class FakeStage:
    """Behaves like a stage of python-microscope; moves at once, or in the background when `speed_um_per_s` is set."""

    def __init__(self, clips_at_um: float = 1e9, speed_um_per_s: float | None = None, homes: bool = False) -> None:
        self._begin_um = self._goal_um = 0.0
        self._began_s = 0.0
        self._clips_at_um = clips_at_um
        self._speed_um_per_s = speed_um_per_s
        self._homes = homes
        self.enabled = 0
        self.moves: list[float] = []

    def may_move_on_enable(self) -> bool:
        return self._homes

    def enable(self) -> None:
        self.enabled += 1

    @property
    def position(self) -> dict[str, float]:
        if self._speed_um_per_s is None:
            return {"X": self._goal_um}
        way_um = self._speed_um_per_s * (time.monotonic() - self._began_s)
        return {"X": min(self._begin_um + way_um, self._goal_um)}

    def move_to(self, position: Mapping[str, float]) -> None:
        self._begin_um = self.position["X"]
        self._began_s = time.monotonic()
        self._goal_um = min(position["X"], self._clips_at_um)
        self.moves.append(position["X"])


class SteppedMoves(unittest.TestCase):
    def stage(self, device: Any) -> MicroscopeStage:
        axes = [translation("x", min_um=0, max_um=10000, repeatability_um=1)]
        return MicroscopeStage(
            device, device, "fake", {"x": "X"}, axes, None, "specimen_xy_on_top", 5.0, 0.0, step_um=100.0
        )

    def wait(self, stage: MicroscopeStage) -> str:
        deadline_s = time.monotonic() + 10
        while (motion := stage.motion()) == "moving":
            self.assertLess(time.monotonic(), deadline_s)
            time.sleep(0.005)
        return motion

    def test_a_long_way_goes_in_steps_and_ends_exactly(self) -> None:
        device = FakeStage()
        stage = self.stage(device)
        stage.move({"x_um": 250.1})
        self.assertEqual(self.wait(stage), "settled")
        self.assertEqual(len(device.moves), 3)
        self.assertEqual(stage.position(), {"x_um": 250.1})

    def test_a_stage_that_does_not_wait_is_waited_for(self) -> None:
        stage = self.stage(FakeStage(speed_um_per_s=1000))
        begin_s = time.monotonic()
        stage.move({"x_um": 300})
        self.assertEqual(self.wait(stage), "settled")
        self.assertGreaterEqual(time.monotonic() - begin_s, 0.28)
        self.assertEqual(stage.position(), {"x_um": 300})

    def test_stop_ends_with_the_present_step(self) -> None:
        device = FakeStage(speed_um_per_s=1000)
        stage = self.stage(device)
        stage.move({"x_um": 5000})
        time.sleep(0.15)
        stage.stop()
        self.assertEqual(self.wait(stage), "stopped")
        place = stage.position()
        self.assertTrue(100 <= place["x_um"] < 5000, place)
        time.sleep(0.15)
        self.assertEqual(stage.position(), place)

    def test_a_stop_near_the_end_of_a_step_waits_until_the_stage_is_still(self) -> None:
        device = FakeStage(speed_um_per_s=100)
        stage = self.stage(device)
        stage.move({"x_um": 250})
        while not device.moves:
            time.sleep(0.005)
        stage.stop()
        self.assertEqual(self.wait(stage), "stopped")
        self.assertAlmostEqual(stage.position()["x_um"], 250 / 3, places=9)
        self.assertEqual(len(device.moves), 1)

    def test_clipping_is_a_fault(self) -> None:
        stage = self.stage(FakeStage(clips_at_um=150))
        stage.move({"x_um": 400})
        with self.assertRaisesRegex(Fault, "150"):
            self.wait(stage)
        self.assertEqual(stage.motion(), "stopped")

    def test_a_stage_that_moves_when_enabled_waits_for_home(self) -> None:
        device = FakeStage(homes=True)
        stage = self.stage(device)
        self.assertFalse(stage.homed)
        self.assertEqual(device.enabled, 0)
        stage.home()
        self.assertEqual(self.wait(stage), "settled")
        self.assertTrue(stage.homed)
        self.assertEqual(device.enabled, 1)


if __name__ == "__main__":
    unittest.main()
