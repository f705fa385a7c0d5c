"""For libraries whose moves wait for their end: the move runs in a thread of its own."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping

from .devices import Motion, Nosepiece, Stage
from .errors import Busy, Fault

REPEAT_STOP_S = 0.1


class BackgroundMove:
    """Runs one blocking move at a time, knows its motion, and stops it from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._motion: Motion = "settled"
        self._failure: Exception | None = None
        self.stop_asked = threading.Event()

    def start(self, work: Callable[[], None]) -> None:
        """Begin `work` in a thread."""
        with self._lock:
            if self._motion == "moving":
                raise Busy("an earlier move still runs; wait for its end or stop it")
            self._motion = "moving"
            self._failure = None
            self.stop_asked.clear()
            self._thread = threading.Thread(target=self._run, args=(work,), daemon=True, name="move")
            self._thread.start()

    def _run(self, work: Callable[[], None]) -> None:
        failure: Exception | None = None
        try:
            if not self.stop_asked.is_set():
                work()
        except Exception as error:
            failure = error
        with self._lock:
            stopped = self.stop_asked.is_set()
            # A library may report a stopped move as an error; that is no fault.
            self._failure = None if stopped else failure
            self._motion = "stopped" if stopped or failure else "settled"

    def motion(self) -> Motion:
        """The motion; a move that failed is raised as a fault, once."""
        with self._lock:
            failure, self._failure = self._failure, None
            if failure is None:
                return self._motion
        if isinstance(failure, Fault):
            raise failure
        raise Fault(f"the move failed: {failure or type(failure).__name__}") from failure

    def stop(self, tell_device: Callable[[], None]) -> None:
        """Call `tell_device`, and again until the move has ended."""
        with self._lock:
            thread = self._thread if self._motion == "moving" else None
            if thread is not None:
                self.stop_asked.set()
        tell_device()
        if thread is not None:
            threading.Thread(target=self._insist, args=(thread, tell_device), daemon=True, name="stop").start()

    def _insist(self, thread: threading.Thread, tell_device: Callable[[], None]) -> None:
        # The first stop may have come just before the library's move began.
        thread.join(REPEAT_STOP_S)
        while thread.is_alive():
            try:
                tell_device()
            except Exception as error:
                print(f"stopping again failed: {error}")
            thread.join(REPEAT_STOP_S)


class BlockingStage(Stage):
    """A stage whose library's move waits for its end. Write `move_and_wait`, `stop_device` and `position`.

    `move_and_wait` runs in a thread, so `position` and `stop_device` are called while it runs: the library must allow that.
    """

    tolerance_um: float | None = None
    """When set, a move that ends farther than this from its goal is a fault."""

    tolerance_deg: float | None = None
    """The same for rotations."""

    def __init__(self) -> None:
        self.background = BackgroundMove()

    @abstractmethod
    def move_and_wait(self, goal: Mapping[str, float]) -> None:
        """Move to `goal`, absolute, and return when it is reached and settled."""

    @abstractmethod
    def stop_device(self) -> None:
        """Make a running `move_and_wait` end early. Called from other threads, perhaps repeatedly; harmless when still."""

    def home_and_wait(self) -> None:
        """Find the reference and return when done. Left as it is, `home` is unsupported."""
        raise NotImplementedError

    @property
    def knows_speeds(self) -> bool:
        """Whether the class has `move_and_wait_at(goal, speed_um_per_s)`, which leaves the usual speed behind, also when it fails."""
        return callable(getattr(self, "move_and_wait_at", None))

    def move(self, goal: Mapping[str, float]) -> None:
        wanted = dict(goal)
        self.background.start(lambda: self._move_and_look(wanted, lambda: self.move_and_wait(wanted)))

    def move_at(self, goal: Mapping[str, float], speed_um_per_s: float) -> None:
        """As `move`, no faster than that along the way."""
        wanted = dict(goal)
        go = getattr(self, "move_and_wait_at")
        self.background.start(lambda: self._move_and_look(wanted, lambda: go(wanted, speed_um_per_s)))

    def _move_and_look(self, goal: dict[str, float], go: Callable[[], None]) -> None:
        go()
        if self.background.stop_asked.is_set():
            return
        if self.tolerance_um is None and self.tolerance_deg is None:
            return
        place = self.position()
        for field, wanted in goal.items():
            tolerance = self.tolerance_um if field.endswith("_um") else self.tolerance_deg
            if tolerance is not None and not abs(place[field] - wanted) <= tolerance:
                raise Fault(f"the stage was sent to {field} {wanted:g} and ended at {place[field]:g}")

    def motion(self) -> Motion:
        return self.background.motion()

    def stop(self) -> None:
        self.background.stop(self.stop_device)

    def home(self) -> None:
        if type(self).home_and_wait is BlockingStage.home_and_wait:
            super().home()
        self.background.start(self.home_and_wait)


class BlockingNosepiece(Nosepiece):
    """A turret whose library's change waits for its end. Write `change_and_wait`, `objective`, and `stop_device` if it can."""

    def __init__(self) -> None:
        self.background = BackgroundMove()

    @abstractmethod
    def change_and_wait(self, objective: str) -> None:
        """Turn to `objective` and return when it is in the beam."""

    def stop_device(self) -> None:
        """Make a running `change_and_wait` end early. Called from other threads; harmless when still."""

    def change(self, objective: str) -> None:
        self.background.start(lambda: self._change_and_look(objective))

    def _change_and_look(self, objective: str) -> None:
        self.change_and_wait(objective)
        if self.background.stop_asked.is_set():
            return
        reached = self.objective()
        if reached != objective:
            raise Fault(f"the nosepiece was sent to {objective} and ended at {reached}")

    def motion(self) -> Motion:
        return self.background.motion()

    def stop(self) -> None:
        self.background.stop(self.stop_device)
