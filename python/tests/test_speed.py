"""Moves at a speed of their own."""

from __future__ import annotations

from collections.abc import Mapping

from conversing import Conversing
from support import SteppingStage, TimedStage

from scopeservo_driver import Refused, Stage


class PacedStage(TimedStage):
    """A stage whose speed can be chosen."""

    def move_at(self, goal: Mapping[str, float], speed_um_per_s: float) -> None:
        if speed_um_per_s < 1:
            raise Refused("not as slow as that")
        with self._lock:
            self._go(goal, min(speed_um_per_s, self.usual_per_s))


class PacedLibrary(SteppingStage):
    """A library whose slow move waits for its end."""

    def __init__(self) -> None:
        super().__init__()
        self.speeds: list[float] = []

    def move_and_wait_at(self, goal: Mapping[str, float], speed_um_per_s: float) -> None:
        self.speeds.append(speed_um_per_s)
        self.move_and_wait(goal)


class Speed(Conversing):
    def test_a_stage_that_has_no_speeds_is_not_said_to(self) -> None:
        self.has_no_speeds(TimedStage(), z_um=1.0)

    def test_a_library_that_has_no_speeds_is_not_said_to(self) -> None:
        self.has_no_speeds(SteppingStage(), y_um=1.0)

    def has_no_speeds(self, stage: Stage, **goal: float) -> None:
        client = self.connect(stage=stage)
        self.assertNotIn("speeds", client.hello()["stage"])
        self.assertEqual(self.error(client.ask("move", **goal, speed_um_per_s=10.0)), "unsupported")
        client.go(**goal)

    def test_a_move_goes_as_fast_as_it_was_asked_to_and_the_next_as_usual(self) -> None:
        stage = PacedStage()
        client = self.connect(stage=stage)
        self.assertIs(client.hello()["stage"]["speeds"], True)
        for asked, speed in ((40.0, 40.0), (25.5, 25.5), (5000.0, 1000.0)):
            client.do("move", z_um=stage.position()["z_um"] + 2.0, speed_um_per_s=asked)
            self.assertEqual(stage.speed_per_s, speed)
            client.wait_until_still()
        client.do("move", z_um=20.0, speed_um_per_s=2.0)
        client.do("stop")
        self.assertLess(stage.position()["z_um"], 19.0)
        client.go(z_um=1.0)
        self.assertEqual(stage.speed_per_s, stage.usual_per_s)

    def test_a_speed_that_cannot_be_had_begins_nothing(self) -> None:
        stage = PacedStage()
        client = self.talk(stage=stage)
        for speed, code in ((0, "outside_limits"), (-3, "outside_limits"), ("fast", "bad_request"), (0.5, "refused"), (None, "bad_request")):
            self.assertEqual(self.error(client.ask("move", z_um=1.0, speed_um_per_s=speed)), code)
        self.assertEqual(self.error(client.ask("move", z_um=1e6, speed_um_per_s=10.0)), "outside_limits")
        self.assertEqual(stage.moves_begun, 0)

    def test_a_library_that_waits_may_know_speeds(self) -> None:
        stage = PacedLibrary()
        client = self.connect(stage=stage)
        self.assertIs(client.hello()["stage"]["speeds"], True)
        client.do("move", y_um=1.0, speed_um_per_s=12.5)
        self.assertEqual(client.wait_until_still()["motion"], "settled")
        client.go(y_um=0.0)
        self.assertEqual(stage.speeds, [12.5])

