"""The driver for Micro-Manager, with its simulated devices."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
import unittest
from importlib.util import find_spec
from pathlib import Path

from pictures import grab, middle, reduced, shift_px
from support import PACKAGE_FOLDER, Client, DriverProcess

from scopeservo_driver import translation
from scopeservo_driver.micromanager import MicroManagerStage

MODULE = "scopeservo_driver.pymmcore"
CONFIG = """\
Device,Cam,DemoCamera,DCam
Device,Table,DemoCamera,DXYStage
Device,Focus,DemoCamera,DStage
Device,Turret,DemoCamera,DObjective
Property,Core,Initialize,1
Property,Core,Camera,Cam
Property,Cam,Mode,Fluorescent Beads
Property,Cam,PixelType,16bit
Label,Turret,0,Nikon: 10X
Label,Turret,1,Nikon: 40X
"""
LIMITS = ["--x-um", "-5000", "5000", "--y-um", "-4000", "4000", "--z-um", "-50", "50", "--positive-z", "apart"]


def installed(*modules: str) -> bool:
    return all(find_spec(module) is not None for module in modules)


class RoundingCore:
    """As much of a core as a stage needs. Rounds every place down to steps of 0.3 um and reports it a little short."""

    def __init__(self) -> None:
        self.place_um = (0.0, 0.0)

    def setXYPosition(self, label: str, x_um: float, y_um: float) -> None:
        self.place_um = (x_um // 0.3 * 0.3 - 0.01, y_um // 0.3 * 0.3 - 0.01)

    def getXPosition(self, label: str) -> float:
        return self.place_um[0]

    def getYPosition(self, label: str) -> float:
        return self.place_um[1]

    def deviceBusy(self, label: str) -> bool:
        return False


class Creeping(unittest.TestCase):
    def test_one_axis_at_a_time_does_not_make_the_other_creep(self) -> None:
        axes = [translation(axis, min_um=0, max_um=100, repeatability_um=1) for axis in "xy"]
        stage = MicroManagerStage(RoundingCore(), "XY", None, axes, None, "specimen_xy_on_top", 5.0, 0.0)
        stage.move_and_wait({"x_um": 0, "y_um": 33.333})
        y_um = stage.position()["y_um"]
        for x_um in range(1, 9):
            stage.move_and_wait({"x_um": x_um})
        self.assertEqual(stage.position()["y_um"], y_um)


@unittest.skipUnless(installed("pymmcore", "mm_test_adapters"), "pymmcore and mm-test-adapters are not installed")
class MicroManager(unittest.TestCase):
    def start(self, *args: str) -> Client:
        self.driver = DriverProcess("-m", MODULE, *args)
        self.addCleanup(self.driver.__exit__)
        return self.driver.client

    def start_with_config(self, *args: str) -> Client:
        from mm_test_adapters import device_adapter_path

        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        config = Path(folder.name) / "demo.cfg"
        config.write_text(CONFIG, encoding="utf-8")
        return self.start("--config", str(config), "--adapters", str(device_adapter_path()), *args)

    def error_of(self, *args: str) -> str:
        """What the driver says when it refuses to start."""
        done = subprocess.run(
            [sys.executable, "-m", MODULE, *args],
            cwd=PACKAGE_FOLDER,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
        )
        self.assertEqual(done.returncode, 2, done.stderr)
        self.assertEqual(done.stdout, "")
        self.assertNotIn("Traceback", done.stderr)
        return done.stderr

    def test_the_picture_follows_the_stage_and_returns(self) -> None:
        client = self.start("--demo", "beads")
        client.hello()
        first = grab(client)
        place = client.go(x_um=100, y_um=-40)
        self.assertAlmostEqual(place["x_um"], 100, delta=0.05)
        self.assertAlmostEqual(place["y_um"], -40, delta=0.05)
        shift, certainty = shift_px(first, grab(client))
        self.assertEqual(shift, (100, -40))
        self.assertGreater(certainty, 0.2)
        client.go(x_um=0, y_um=0)
        shift, certainty = shift_px(first, grab(client))
        self.assertEqual(shift, (0, 0))
        self.assertGreater(certainty, 0.9)

    def test_focus_blurs(self) -> None:
        client = self.start("--demo", "beads")
        client.hello()
        sharp = grab(client)
        self.assertAlmostEqual(client.go(z_um=5)["z_um"], 5, delta=0.05)
        self.assertLess(abs(shift_px(sharp, grab(client))[1]), 0.6)
        client.go(z_um=0)
        self.assertGreater(shift_px(sharp, grab(client))[1], 0.9)

    def test_stop_on_the_way_and_during_a_long_exposure_of_the_same_library(self) -> None:
        client = self.start("--demo", "beads")
        client.hello()
        client.go(x_um=-10000)
        client.do("exposure", exposure_ms=3000)
        client.do("move", x_um=10000)
        self.assertEqual(client.ask("move", x_um=0)["error"], "busy")
        grabbed = client.send("grab")
        time.sleep(0.3)
        asked_s = time.monotonic()
        client.do("stop")
        self.assertLess(time.monotonic() - asked_s, 2)
        self.assertEqual(client.wait_until_still()["motion"], "stopped")
        x_um = client.do("position")["x_um"]
        self.assertTrue(-9999 < x_um < 9999, x_um)
        self.assertLess(time.monotonic() - asked_s, 2.5)
        frame = client.answer(grabbed)
        self.assertGreaterEqual(frame["age_ms"], 3000)
        self.assertEqual(len(frame["samples"]), 512 * 512)

    def test_long_and_short_exposures_show_the_present_place(self) -> None:
        client = self.start("--demo", "beads")
        client.hello()
        first = grab(client)
        for exposure_ms in (150, 20):
            client.go(x_um=50, y_um=0)
            client.do("exposure", exposure_ms=exposure_ms)
            self.assertEqual(shift_px(first, grab(client))[0], (50, 0))
            client.go(x_um=0, y_um=0)
            self.assertEqual(shift_px(first, grab(client))[0], (0, 0))

    def test_a_configuration_file(self) -> None:
        client = self.start_with_config(
            *LIMITS, "--objective", "Nikon: 10X:100:0.25:1.0", "--objective", "Nikon: 40X:400:0.8:0.25"
        )
        said = client.hello()
        self.assertEqual(said["stage"]["positive_z"], "apart")
        self.assertEqual([axis["min_um"] for axis in said["stage"]["axes"]], [-5000, -4000, -50])
        self.assertEqual((said["camera"]["bits"], said["camera"]["channels"]), (16, 1))
        self.assertEqual(client.ask("move", y_um=4001)["error"], "outside_limits")
        self.assertEqual(client.do("objective")["objective"], "Nikon: 10X")
        reached = client.change("Nikon: 40X")
        self.assertEqual((reached["objective"], reached["motion"]), ("Nikon: 40X", "settled"))
        self.assertEqual(client.ask("change", objective="Objective-C")["error"], "no_such_objective")
        self.assertEqual(client.go(x_um=15, z_um=3)["z_um"], 3)
        self.assertEqual(grab(client).shape, (512, 512))
        client.do("bye")
        self.assertEqual(self.driver.wait(), 0)

    def test_colour(self) -> None:
        client = self.start_with_config(
            *LIMITS, "--property", "Cam", "PixelType", "32bitRGB", "--property", "Cam", "Mode", "Color Test Pattern"
        )
        self.assertEqual(client.hello()["camera"]["channels"], 3)
        frame = client.do("grab")
        self.assertEqual(len(frame["samples"]), 3 * 512 * 512)
        # The pattern's first stripes ramp the bytes of a pixel in turn; Micro-Manager has blue first, then green, then red.
        last = [frame["samples"][3 * (512 * row + 511) :][:3] for row in (0, 64, 128)]
        level = last[0][2]
        self.assertGreater(level, 200)
        self.assertEqual(last, [bytes([0, 0, level]), bytes([0, level, 0]), bytes([level, 0, 0])])

    def test_devices_one_by_one(self) -> None:
        from mm_test_adapters import device_adapter_path

        client = self.start(
            "--adapters", str(device_adapter_path()), "--device", "Table", "DemoCamera", "DXYStage",
            "--x-um", "0", "100", "--y-um", "0", "100",
        )  # fmt: skip
        said = client.hello()
        self.assertNotIn("camera", said)
        self.assertEqual(len(said["stage"]["axes"]), 2)
        self.assertAlmostEqual(client.go(x_um=60)["x_um"], 60, delta=0.05)

    def test_what_is_missing_is_said(self) -> None:
        from mm_test_adapters import device_adapter_path

        adapters = ["--adapters", str(device_adapter_path())]
        table = [*adapters, "--device", "Table", "DemoCamera", "DXYStage", "--x-um", "0", "90"]
        focus = [*adapters, "--device", "Focus", "DemoCamera", "DStage", "--z-um", "0", "90"]
        turret = [*adapters, "--device", "Turret", "DemoCamera", "DObjective"]
        for args, words in (
            ([], "one of the arguments"),
            (table, "--y-um MIN MAX"),
            (focus, "--positive-z"),
            ([*table, "--y-um", "90", "0"], "min of axis y"),
            ([*table, "--xy-stage", "Tisch"], "there are Table"),
            ([*turret, "--objective", "10x:1:1:1"], "Objective-A"),
            ([*turret, "--objective", "10x"], "UM_PER_PX"),
            ([*adapters, "--device", "A", "DemoCamera", "None such"], "None such"),
            ([*adapters, "--config", "/none/such.cfg"], "such.cfg"),
            (["--demo", "beads", "--listen", "0.0.0.0:0"], "--secret-file"),
        ):
            with self.subTest(args=args):
                self.assertIn(words, self.error_of(*args))

    @unittest.skipUnless(installed("pymmcore_plus"), "pymmcore-plus is not installed")
    def test_the_sample_follows_stage_and_objective(self) -> None:
        client = self.start("--demo", "sample")
        client.hello()
        first = grab(client)
        client.go(x_um=100, y_um=30)
        shift, certainty = shift_px(first, grab(client))
        self.assertEqual(shift, (100, 30))
        self.assertGreater(certainty, 0.2)
        client.go(x_um=0, y_um=0)
        self.assertEqual(shift_px(first, grab(client))[0], (0, 0))
        # A pixel of the 20x is half as large: its view, at half the size, is the middle of that of the 10x.
        self.assertEqual(client.change("20x")["objective"], "20x")
        at_20x = grab(client)
        self.assertLess(shift_px(first, at_20x)[1], 0.1)
        shift, certainty = shift_px(middle(first, 2), reduced(at_20x, 2))
        self.assertLessEqual(max(abs(shift[0]), abs(shift[1])), 1)
        self.assertGreater(certainty, 0.1)
        client.go(x_um=25)
        self.assertEqual(shift_px(at_20x, grab(client))[0], (50, 0))
        client.go(x_um=0)
        self.assertEqual(client.change("10x")["objective"], "10x")
        shift, certainty = shift_px(first, grab(client))
        self.assertEqual(shift, (0, 0))
        self.assertGreater(certainty, 0.5)

    @unittest.skipUnless(installed("pymmcore_plus"), "pymmcore-plus is not installed")
    def test_the_end_of_the_input_ends_it_cleanly_whatever_its_threads_do(self) -> None:
        client = self.start("--demo", "sample")
        client.hello()
        client.do("exposure", exposure_ms=100)
        client.do("move", x_um=900)
        client.send("grab")
        time.sleep(0.02)
        self.driver.close_input()
        self.assertEqual(self.driver.wait(), 0, self.driver.errors())

    @unittest.skipUnless(installed("pymmcore_plus"), "pymmcore-plus is not installed")
    def test_the_sample_is_everywhere_the_same_for_every_driver(self) -> None:
        client = self.start("--demo", "sample")
        client.hello()
        client.go(x_um=1000, y_um=-1000)
        corner = grab(client)
        # Every part of the view has something to see.
        parts = corner.reshape(4, 128, 4, 128).std(axis=(1, 3))
        self.assertGreater(parts.min(), 5)
        self.driver.close_input()
        self.driver.wait()
        again = self.start("--demo", "sample")
        again.hello()
        again.go(x_um=1000, y_um=-1000)
        shift, certainty = shift_px(corner, grab(again))
        self.assertEqual(shift, (0, 0))
        self.assertGreater(certainty, 0.5)


if __name__ == "__main__":
    unittest.main()
