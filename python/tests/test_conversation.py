"""The conversation itself, over pipes within this process."""

from __future__ import annotations

import os
import threading
import time
import unittest
from typing import Any

from conversing import Conversing
from support import Lamp, SlowCamera, SlowNosepiece, SteppingStage, TimedStage

from scopeservo_driver import Busy, Frame, NotHomed, Objective, Refused, translation
from scopeservo_driver.instrument import Instrument
from scopeservo_driver.options import objective

STOP_S = 1.0


class Conversation(Conversing):
    def test_hello_tells_everything(self) -> None:
        client = self.connect(stage=TimedStage(), camera=SlowCamera(), nosepiece=SlowNosepiece(), light=Lamp())
        self.assertEqual(
            client.hello(),
            {
                "id": 1,
                "ok": True,
                "protocol": 1,
                "name": "test",
                "stage": {
                    "name": "timed stage",
                    "moves": "specimen_xy_on_top",
                    "positive_z": "closer",
                    "axes": [
                        {"axis": "x", "min_um": 0, "max_um": 50000, "repeatability_um": 0.5},
                        {"axis": "z", "min_um": -100, "max_um": 100, "repeatability_um": 0.1},
                        {"axis": "rz", "min_deg": -180, "max_deg": 180, "repeatability_deg": 0.01},
                    ],
                },
                "camera": {
                    "name": "slow camera",
                    "width_px": 6,
                    "height_px": 4,
                    "channels": 1,
                    "bits": 12,
                    "min_exposure_ms": 1,
                    "max_exposure_ms": 5000,
                },
                "nosepiece": {
                    "name": "slow nosepiece",
                    "objectives": [
                        {"id": "10x", "magnification": 100, "numerical_aperture": 0.25, "um_per_px": 2.2},
                        {"id": "20x", "magnification": 200, "numerical_aperture": 0.5, "um_per_px": 1.1},
                    ],
                },
                "light": {"name": "lamp"},
            },
        )
        self.assertEqual(self.error(client.ask("hello", protocol=1)), "bad_request")

    def test_a_stated_arrival_tolerance_is_told(self) -> None:
        x = translation("x", min_um=0, max_um=100, repeatability_um=1, arrival_tolerance_um=3)
        client = self.connect(stage=type("Stated", (TimedStage,), {"axes": [x]})())
        axes = client.hello()["stage"]["axes"]
        self.assertEqual(
            axes, [{"axis": "x", "min_um": 0, "max_um": 100, "repeatability_um": 1, "arrival_tolerance_um": 3}]
        )

    def test_what_an_objective_works_in_is_told_where_it_is_not_air(self) -> None:
        oil = Objective("100x", 1000, 1.25, 0.1, immersion="oil")
        self.assertEqual(objective("100x:1000:1.25:0.1:oil"), oil)
        self.assertEqual(objective("oil:100:0.25:2.2").immersion, "air")
        dry = objective("10x:100:0.25:2.2")
        client = self.connect(nosepiece=type("Wet", (SlowNosepiece,), {"objectives": [dry, oil]})())
        told = client.hello()["nosepiece"]["objectives"]
        self.assertEqual([one.get("immersion") for one in told], [None, "oil"])
        with self.assertRaisesRegex(ValueError, "immersion of objective 10x"):
            castor = Objective("10x", 100, 0.25, 2.2, immersion="castor oil")
            self.connect(nosepiece=type("Odd", (SlowNosepiece,), {"objectives": [castor]})())

    def test_hello_comes_first_and_speaks_the_version(self) -> None:
        client = self.connect(light=Lamp())
        self.assertEqual(self.error(client.ask("light")), "bad_request")
        self.assertEqual(self.error(client.ask("hello", protocol=2)), "unsupported")
        self.assertEqual(self.error(client.ask("hello")), "bad_request")
        client.hello()
        client.do("light")

    def test_a_move_is_started_polled_and_reached(self) -> None:
        client = self.talk(stage=TimedStage())
        self.assertEqual(client.do("motion")["motion"], "settled")
        client.do("move", x_um=300, rz_deg=-1.5)
        self.assertEqual(client.do("motion")["motion"], "moving")
        self.assertEqual(self.error(client.ask("move", x_um=0)), "busy")
        self.assertEqual(client.wait_until_still()["motion"], "settled")
        place = client.do("position")
        self.assertEqual((place["x_um"], place["z_um"], place["rz_deg"]), (300, 0, -1.5))

    def test_refused_moves_begin_nothing(self) -> None:
        stage = TimedStage()
        client = self.talk(stage=stage)
        for goal, code in (
            ({}, "bad_request"),
            ({"w_um": 1}, "bad_request"),
            ({"x_um": "1"}, "bad_request"),
            ({"x_um": True}, "bad_request"),
            ({"x_um": None}, "bad_request"),
            ({"x_um": 1, "y_um": 1}, "no_such_axis"),
            ({"x_um": 50000.001}, "outside_limits"),
            ({"x_um": 5, "z_um": -101}, "outside_limits"),
            ({"rz_deg": 181}, "outside_limits"),
        ):
            with self.subTest(goal=goal):
                self.assertEqual(self.error(client.ask("move", **goal)), code)
        self.assertEqual(stage.moves_begun, 0)
        client.do("move", x_um=0, z_um=100)
        self.assertEqual(stage.moves_begun, 1)

    def test_stop_on_the_way(self) -> None:
        client = self.talk(stage=TimedStage())
        client.do("move", x_um=40000)
        time.sleep(0.1)
        client.do("stop")
        self.assertEqual(client.do("motion")["motion"], "stopped")
        first = client.do("position")["x_um"]
        time.sleep(0.05)
        self.assertEqual(client.do("position")["x_um"], first)
        self.assertTrue(100 < first < 40000)

    def test_stop_is_answered_during_a_slow_grab(self) -> None:
        stage = TimedStage()
        client = self.talk(stage=stage, camera=SlowCamera())
        client.do("exposure", exposure_ms=2500)
        client.do("move", x_um=40000)
        grab = client.send("grab")
        time.sleep(0.2)
        asked_s = time.monotonic()
        client.do("stop")
        self.assertLess(time.monotonic() - asked_s, STOP_S)
        self.assertEqual(client.do("motion")["motion"], "stopped")
        self.assertLess(time.monotonic() - asked_s, 2.0)
        frame = client.answer(grab)
        self.assertTrue(frame["ok"])
        self.assertGreaterEqual(frame["age_ms"], 2500)

    def test_stop_reaches_a_stage_whose_own_call_is_slow(self) -> None:
        class SlowToAnswer(TimedStage):
            def position(self) -> dict[str, float]:
                time.sleep(2.0)
                return super().position()

        stage = SlowToAnswer()
        client = self.talk(stage=stage)
        client.do("move", x_um=40000)
        position = client.send("position")
        late_move = client.send("move", x_um=1)
        time.sleep(0.05)
        asked_s = time.monotonic()
        client.do("stop")
        self.assertLess(time.monotonic() - asked_s, STOP_S)
        self.assertEqual(stage.stops, 1)
        self.assertTrue(client.answer(position)["ok"])
        self.assertEqual(self.error(client.answer(late_move)), "refused")
        self.assertEqual(stage.moves_begun, 1)

    def test_a_move_that_stop_overtook_is_stopped_too(self) -> None:
        class SlowToStart(TimedStage):
            def move(self, goal: Any) -> None:
                time.sleep(0.4)
                super().move(goal)

        client = self.talk(stage=SlowToStart())
        move = client.send("move", x_um=40000)
        time.sleep(0.1)
        client.do("stop")
        self.assertTrue(client.answer(move)["ok"])
        self.assertEqual(client.do("motion")["motion"], "stopped")
        self.assertLess(client.do("position")["x_um"], 200)

    def test_frames(self) -> None:
        client = self.talk(camera=SlowCamera())
        self.assertEqual(client.do("exposure", exposure_ms=20.3)["exposure_ms"], 20)
        for count in (1, 2):
            frame = client.do("grab")
            size = [frame[name] for name in ("width_px", "height_px", "channels", "bits", "bytes")]
            self.assertEqual(size, [6, 4, 1, 12, 48])
            self.assertEqual(frame["samples"], bytes([count, 0]) * 24)
            self.assertEqual((frame["sequence"], frame["exposure_ms"]), (count, 20))
            self.assertTrue(20 <= frame["age_ms"] < 1000)
        for exposure_ms, code in ((0.9, "outside_limits"), (5001, "outside_limits"), ("1", "bad_request")):
            self.assertEqual(self.error(client.ask("exposure", exposure_ms=exposure_ms)), code)
        self.assertEqual(client.do("exposure")["exposure_ms"], 20)

    def test_a_camera_may_tell_more_of_its_frame(self) -> None:
        class Knowing(SlowCamera):
            width_px, height_px, channels, bits = 1, 1, 3, 8

            def grab(self) -> Frame:
                began_s = time.monotonic() - 1
                return Frame(b"BGRA", order="bgr", exposure_ms=7.5, sequence=41, began_s=began_s)

        frame = self.talk(camera=Knowing()).do("grab")
        self.assertEqual((frame["samples"], frame["exposure_ms"], frame["sequence"]), (b"RGB", 7.5, 41))
        self.assertTrue(1000 <= frame["age_ms"] < 2000)

    def test_nosepiece(self) -> None:
        client = self.talk(nosepiece=SlowNosepiece())
        self.assertEqual(client.do("objective")["objective"], "10x")
        self.assertEqual(self.error(client.ask("change", objective="30x")), "no_such_objective")
        self.assertEqual(self.error(client.ask("change")), "bad_request")
        client.do("change", objective="20x")
        self.assertEqual(self.error(client.ask("change", objective="10x")), "busy")
        turning = client.do("objective")
        self.assertEqual((turning["objective"], turning["motion"]), (None, "moving"))
        reached = client.wait_until_still("objective")
        self.assertEqual((reached["objective"], reached["motion"]), ("20x", "settled"))
        client.do("change", objective="10x")
        client.do("stop")
        ended = client.wait_until_still("objective")
        self.assertEqual((ended["objective"], ended["motion"]), (None, "stopped"))

    def test_light(self) -> None:
        client = self.talk(light=Lamp())
        self.assertEqual(client.do("light", level=0.25)["level"], 0.25)
        self.assertEqual(self.error(client.ask("light", level=1.01)), "outside_limits")
        self.assertEqual(client.do("light")["level"], 0.25)

    def test_blocking_stage(self) -> None:
        stage = SteppingStage()
        client = self.talk(stage=stage)
        client.do("move", y_um=1000)
        self.assertEqual(client.do("motion")["motion"], "moving")
        client.do("stop")
        self.assertEqual(client.wait_until_still()["motion"], "stopped")
        self.assertLess(stage.y_um, 900)
        self.assertEqual(client.go(y_um=50)["y_um"], 50)
        self.assertEqual(self.error(client.ask("home")), "unsupported")

    def test_blocking_stage_stopped_before_the_librarys_move_began(self) -> None:
        stage = SteppingStage()
        stage.delay_before_move_s = 0.25
        client = self.talk(stage=stage)
        client.do("move", y_um=1000)
        client.do("stop")
        self.assertEqual(client.wait_until_still()["motion"], "stopped")
        self.assertLess(stage.y_um, 300)

    def test_blocking_stage_that_ended_elsewhere_is_a_fault(self) -> None:
        stage = SteppingStage()
        stage.jammed_at_um = 30
        client = self.talk(stage=stage)
        client.do("move", y_um=100)
        while (reply := client.ask("motion")).get("motion") == "moving":
            time.sleep(0.01)
        self.assertEqual(self.error(reply), "fault")
        self.assertIn("ended at 30", reply["message"])
        self.assertEqual(client.do("motion")["motion"], "stopped")

    def test_homing(self) -> None:
        class Lost(SteppingStage):
            homed = False

            def home_and_wait(self) -> None:
                time.sleep(0.1)
                self.homed = True

        client = self.connect(stage=Lost())
        self.assertIs(client.hello()["stage"]["homed"], False)
        self.assertEqual(self.error(client.ask("move", y_um=1)), "not_homed")
        self.assertEqual(self.error(client.ask("position")), "not_homed")
        client.do("home")
        self.assertEqual(self.error(client.ask("home")), "busy")
        self.assertEqual(client.wait_until_still()["motion"], "settled")
        self.assertEqual(client.go(y_um=20)["y_um"], 20)

    def test_exceptions_become_codes(self) -> None:
        class Moody(TimedStage):
            error: BaseException = Refused("the door is open")

            def position(self) -> dict[str, float]:
                raise self.error

        stage = Moody()
        client = self.talk(stage=stage)
        for error, code, message in (
            (Refused("the door is open"), "refused", "the door is open"),
            (NotHomed("home me"), "not_homed", "home me"),
            (Busy("wait"), "busy", "wait"),
            (RuntimeError("cable fell out"), "fault", "cable fell out"),
            (KeyError(), "fault", "KeyError"),
            (SystemExit(3), "fault", "3"),
        ):
            stage.error = error
            with self.quietly():
                reply = client.ask("position")
            self.assertEqual((reply["error"], reply["message"]), (code, message))

    def test_wrong_answers_of_the_class_are_faults(self) -> None:
        class Wrong(TimedStage):
            place: dict[str, Any] = {}

            def position(self) -> dict[str, Any]:
                return self.place

            def motion(self) -> str:
                return "idle"

        stage = Wrong()
        client = self.talk(stage=stage, camera=type("Short", (SlowCamera,), {"grab": lambda self: b"1"})())
        for x_um in (float("nan"), None, "far"):
            stage.place = {"x_um": x_um, "z_um": 0, "rz_deg": 0}
            self.assertEqual(self.error(client.ask("position")), "fault")
        stage.place = {"x_um": 1}
        self.assertEqual(self.error(client.ask("position")), "fault")
        self.assertEqual(self.error(client.ask("motion")), "fault")
        self.assertEqual(self.error(client.ask("move", x_um=1)), "fault")
        self.assertEqual(stage.moves_begun, 0)
        self.assertEqual(self.error(client.ask("grab")), "fault")

    def test_missing_devices_and_unknown_calls(self) -> None:
        client = self.talk(light=Lamp())
        for call in ("position", "move", "home", "grab", "exposure", "objective", "change", "dance"):
            self.assertEqual(self.error(client.ask(call)), "unsupported")
        client.do("stop")

    def test_garbage_is_answered_and_survived(self) -> None:
        client = self.talk(light=Lamp())
        for garbage in (
            b"garbage\n",
            b"\xff\xfe\n",
            b'{"id":5}{"id":6}\n',
            b"a" * 70000 + b"\n",
            b'{"id":2,"level":NaN}\n',
        ):
            client.send_raw(garbage)
            self.assertEqual(self.error(client.answer(None)), "bad_request")
        client.send_raw(b'{"id":50,"call":"light"}\r\n')
        self.assertTrue(client.answer(50)["ok"])
        client.send_raw(b'{"id":50,"call":"light"}\n')
        self.assertEqual(self.error(client.answer(50)), "bad_request")
        client.send_raw(b'{"call":"light"}\n')
        self.assertEqual(self.error(client.answer(None)), "bad_request")

    def test_one_byte_at_a_time(self) -> None:
        client = self.talk(light=Lamp())
        for byte in b'{"id":2,"call":"light","level":0.5}\r\n{"id":3,"call":"stop"}\n':
            client.send_raw(bytes([byte]))
        self.assertEqual(client.answer(2)["level"], 0.5)
        self.assertTrue(client.answer(3)["ok"])

    def test_bye_stops_replies_and_ends(self) -> None:
        stage = TimedStage()
        client = self.talk(stage=stage)
        client.do("move", x_um=40000)
        client.do("bye")
        self.assertTrue(self.session.over.wait(5))
        self.assertEqual(stage.motion(), "stopped")

    def test_the_end_of_the_input_stops_also_with_half_a_line(self) -> None:
        stage = TimedStage()
        client = self.talk(stage=stage)
        client.do("move", x_um=40000)
        client.send_raw(b'{"id":9,"call":"mo')
        os.close(self.input)
        self.assertTrue(self.session.over.wait(5))
        self.assertEqual(stage.motion(), "stopped")

    def test_wrong_declarations_are_refused_at_the_start(self) -> None:
        def stage(**attributes: Any) -> TimedStage:
            return type("Wrong", (TimedStage,), attributes)()

        x = translation("x", min_um=0, max_um=100, repeatability_um=1)
        for devices in (
            {},
            {"stage": stage(axes=[])},
            {"stage": stage(axes=[x, x])},
            {"stage": stage(axes=[translation("w", min_um=0, max_um=100, repeatability_um=1)])},
            {"stage": stage(axes=[translation("x", min_um=0, max_um=1, repeatability_um=1)])},
            {"stage": stage(axes=[translation("x", min_um=0, max_um=1e4, repeatability_um=51)])},
            {"stage": stage(axes=[translation("x", min_um=0, max_um=1e4, repeatability_um=1, arrival_tolerance_um=0)])},
            {"stage": stage(axes=[translation("x", min_um=1, max_um=1, repeatability_um=1)])},
            {"stage": stage(axes=[translation("x", min_um=0, max_um=float("inf"), repeatability_um=1)])},
            {"stage": stage(positive_z=None)},
            {"stage": stage(moves="everything")},
            {"camera": type("Wrong", (SlowCamera,), {"channels": 4})()},
            {"camera": type("Wrong", (SlowCamera,), {"max_exposure_ms": 0})()},
            {"nosepiece": type("Wrong", (SlowNosepiece,), {"objectives": []})()},
        ):
            with self.subTest(devices=devices), self.assertRaises(ValueError):
                Instrument(**{"stage": None, "camera": None, "nosepiece": None, "light": None, **devices}, name="test")

    def test_any_class_will_do(self) -> None:
        class Duck:
            axes = [translation("x", min_um=0, max_um=10, repeatability_um=1)]
            place = 0.0

            def position(self) -> dict[str, float]:
                return {"x_um": self.place}

            def move(self, goal: dict[str, float]) -> None:
                self.place = goal["x_um"]

            def motion(self) -> str:
                return "settled"

            def stop(self) -> None:
                pass

        client = self.talk(stage=Duck())
        self.assertEqual(client.go(x_um=4)["x_um"], 4)
        self.assertEqual(self.error(client.ask("home")), "unsupported")


if __name__ == "__main__":
    unittest.main()
