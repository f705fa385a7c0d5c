"""What the tests share: a small client of the protocol, and devices to talk to."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGE_FOLDER = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PACKAGE_FOLDER))

from scopeservo_driver import (  # noqa: E402
    BlockingNosepiece,
    BlockingStage,
    Camera,
    Light,
    Objective,
    Stage,
    rotation,
    translation,
)

ANSWER_WAIT_S = 20.0


class Client:
    """Sends requests and sorts the replies by their id. A frame's samples come as reply["samples"]."""

    def __init__(self, read: Callable[[int], bytes], write: Callable[[bytes], Any]) -> None:
        self._read = read
        self._write = write
        self._id = 0
        self._buffer = b""
        self._replies: dict[Any, dict[str, Any]] = {}
        self._arrived = threading.Condition()
        self.ended = threading.Event()
        self.not_messages: list[bytes] = []
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def _more(self) -> bool:
        data = self._read(65536)
        self._buffer += data
        return bool(data)

    def _receive(self) -> None:
        try:
            while True:
                while b"\n" not in self._buffer:
                    if not self._more():
                        return
                line, _, self._buffer = self._buffer.partition(b"\n")
                try:
                    reply = json.loads(line)
                except ValueError:
                    self.not_messages.append(line)
                    continue
                if "bytes" in reply:
                    while len(self._buffer) < reply["bytes"]:
                        if not self._more():
                            return
                    reply["samples"] = self._buffer[: reply["bytes"]]
                    self._buffer = self._buffer[reply["bytes"] :]
                with self._arrived:
                    self._replies[reply["id"]] = reply
                    self._arrived.notify_all()
        except (OSError, ValueError):
            pass
        finally:
            self.ended.set()
            with self._arrived:
                self._arrived.notify_all()

    def send(self, call: str, **fields: Any) -> int:
        self._id += 1
        self.send_raw(json.dumps({"id": self._id, "call": call, **fields}).encode() + b"\n")
        return self._id

    def send_raw(self, data: bytes) -> None:
        self._write(data)

    def answer(self, id: int | None, timeout_s: float = ANSWER_WAIT_S) -> dict[str, Any]:
        with self._arrived:
            if not self._arrived.wait_for(lambda: id in self._replies or self.ended.is_set(), timeout_s):
                raise TimeoutError(f"no reply to {id}")
            if id not in self._replies:
                raise EOFError(f"the driver ended without a reply to {id}")
            return self._replies.pop(id)

    def ask(self, call: str, **fields: Any) -> dict[str, Any]:
        return self.answer(self.send(call, **fields))

    def do(self, call: str, **fields: Any) -> dict[str, Any]:
        reply = self.ask(call, **fields)
        if reply.get("ok") is not True:
            raise AssertionError(f"{call} {fields} was answered with {reply}")
        return reply

    def hello(self) -> dict[str, Any]:
        return self.do("hello", protocol=1, client="tests")

    def wait_until_still(self, call: str = "motion", timeout_s: float = ANSWER_WAIT_S) -> dict[str, Any]:
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            reply = self.do(call)
            if reply["motion"] != "moving":
                return reply
            time.sleep(0.01)
        raise TimeoutError("still moving")

    def go(self, **goal: float) -> dict[str, Any]:
        """Move, wait, and give the place."""
        self.do("move", **goal)
        motion = self.wait_until_still()["motion"]
        if motion != "settled":
            raise AssertionError(f"the move to {goal} ended {motion}")
        return self.do("position")

    def change(self, objective: str) -> dict[str, Any]:
        self.do("change", objective=objective)
        return self.wait_until_still("objective")


class DriverProcess:
    """A driver as a child process, and a client that talks to it."""

    def __init__(self, *args: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, *args],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
            env={**os.environ, "PYTHONPATH": str(PACKAGE_FOLDER)},
        )
        self._errors = bytearray()
        self._error_reader = threading.Thread(target=self._read_errors, daemon=True)
        self._error_reader.start()
        assert self._process.stdin is not None and self._process.stdout is not None
        self.client = Client(self._process.stdout.read, self._process.stdin.write)

    def _read_errors(self) -> None:
        assert self._process.stderr is not None
        while data := self._process.stderr.read(4096):
            self._errors += data

    def close_input(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def wait(self, timeout_s: float = ANSWER_WAIT_S) -> int:
        """Its exit code."""
        code = self._process.wait(timeout_s)
        self._error_reader.join(timeout_s)
        return code

    def errors(self) -> str:
        return self._errors.decode(errors="replace")

    def __enter__(self) -> DriverProcess:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.client.ended.wait(5)
        self._error_reader.join(5)
        self._process.stdout.close()
        if self._process.stderr is not None:
            self._process.stderr.close()


class TimedStage(Stage):
    """Three axes that move with 1000 um or degrees a second, in real time."""

    name = "timed stage"
    axes = [
        translation("x", min_um=0, max_um=50000, repeatability_um=0.5),
        translation("z", min_um=-100, max_um=100, repeatability_um=0.1),
        rotation("rz", min_deg=-180, max_deg=180, repeatability_deg=0.01),
    ]
    positive_z = "closer"
    usual_per_s = 1000.0

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._begin = {"x_um": 100.0, "z_um": 0.0, "rz_deg": 0.0}
        self._goal = dict(self._begin)
        self._began_s = 0.0
        self._stopped = False
        self.speed_per_s = self.usual_per_s
        self.stops = 0
        self.moves_begun = 0

    def _place(self) -> dict[str, float]:
        way = self.speed_per_s * (time.monotonic() - self._began_s)
        place = {}
        for field, goal in self._goal.items():
            distance = goal - self._begin[field]
            place[field] = goal if abs(distance) <= way else self._begin[field] + (way if distance > 0 else -way)
        return place

    def position(self) -> dict[str, float]:
        with self._lock:
            return self._place()

    def move(self, goal: Mapping[str, float]) -> None:
        with self._lock:
            self._go(goal, self.usual_per_s)

    def _go(self, goal: Mapping[str, float], speed_per_s: float) -> None:
        self.moves_begun += 1
        self._begin = self._place()
        self.speed_per_s = speed_per_s
        self._goal = {**self._begin, **goal}
        self._began_s = time.monotonic()
        self._stopped = False

    def motion(self) -> str:
        with self._lock:
            if self._stopped:
                return "stopped"
            return "settled" if self._place() == self._goal else "moving"

    def stop(self) -> None:
        with self._lock:
            self.stops += 1
            self._begin = self._place()
            self._stopped = self._stopped or self._begin != self._goal
            self._goal = dict(self._begin)


class SlowCamera(Camera):
    """Its exposures take real time. The first samples of a frame count the frames."""

    name = "slow camera"
    width_px, height_px, channels, bits = 6, 4, 1, 12
    min_exposure_ms, max_exposure_ms = 1.0, 5000.0

    def __init__(self) -> None:
        self._exposure_ms = 10.0
        self._count = 0

    def get_exposure_ms(self) -> float:
        return self._exposure_ms

    def set_exposure_ms(self, exposure_ms: float) -> None:
        self._exposure_ms = round(exposure_ms)

    def grab(self) -> bytes:
        time.sleep(self._exposure_ms / 1000)
        self._count += 1
        return self._count.to_bytes(2, "little") * (self.width_px * self.height_px)


class SlowNosepiece(BlockingNosepiece):
    name = "slow nosepiece"
    objectives = [Objective("10x", 100, 0.25, 2.2), Objective("20x", 200, 0.5, 1.1)]

    def __init__(self) -> None:
        super().__init__()
        self._objective: str | None = "10x"
        self._stopped = threading.Event()

    def objective(self) -> str | None:
        return self._objective

    def change_and_wait(self, objective: str) -> None:
        self._stopped.clear()
        self._objective = None
        if not self._stopped.wait(0.3):
            self._objective = objective

    def stop_device(self) -> None:
        self._stopped.set()


class SteppingStage(BlockingStage):
    """One axis whose move waits for its end, 10 um every 10 ms; stopping is a flag, as in many libraries."""

    name = "stepping stage"
    axes = [translation("y", min_um=0, max_um=1000, repeatability_um=1)]
    tolerance_um = 1.0

    def __init__(self) -> None:
        super().__init__()
        self.y_um = 0.0
        self.jammed_at_um: float | None = None
        self.delay_before_move_s = 0.0
        self._keep_going = True

    def position(self) -> dict[str, float]:
        return {"y_um": self.y_um}

    def move_and_wait(self, goal: Mapping[str, float]) -> None:
        time.sleep(self.delay_before_move_s)
        self._keep_going = True
        while self.y_um != goal["y_um"] and self._keep_going and self.y_um != self.jammed_at_um:
            self.y_um += max(-10.0, min(10.0, goal["y_um"] - self.y_um))
            time.sleep(0.01)

    def stop_device(self) -> None:
        self._keep_going = False


class Lamp(Light):
    name = "lamp"

    def __init__(self) -> None:
        self._level = 0.0

    def get_level(self) -> float:
        return self._level

    def set_level(self, level: float) -> None:
        self._level = level
