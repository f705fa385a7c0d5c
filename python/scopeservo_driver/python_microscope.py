"""Stage, camera and filter wheel of python-microscope, in this process or behind its device server."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from typing import Any

from .background import BlockingNosepiece, BlockingStage
from .devices import Axis, Camera, Frame, Objective
from .errors import Fault

POLL_S = 0.01
STALL_S = 2.0
FRAME_WAIT_S = 4.0
ARRIVED_UM = 1e-6


class MicroscopeStage(BlockingStage):
    """A stage of python-microscope.

    The library can neither stop a move nor tell whether one has ended, and some of its stages wait for the end while others
    do not. So a move is sent as steps of at most `step_um`, each is watched until it has arrived, and `stop` lets the
    present step end.
    """

    def __init__(
        self,
        mover: Any,
        reader: Any,
        name: str,
        name_of_axis: Mapping[str, str],
        axes: list[Axis],
        positive_z: str | None,
        moves: str,
        tolerance_um: float,
        settle_ms: float,
        step_um: float,
    ) -> None:
        """`mover` and `reader` are the same stage, reached so that reading works while a move waits for its end.

        `name_of_axis` has the library's names of x, y and z.
        """
        super().__init__()
        self._mover = mover
        self._reader = reader
        self._name_of_field = {f"{axis}_um": name for axis, name in name_of_axis.items()}
        self._settle_s = settle_ms / 1000
        self._step_um = step_um
        self._near_um = tolerance_um
        self.name = name
        self.axes = axes
        self.positive_z = positive_z
        self.moves = moves
        self.tolerance_um = tolerance_um
        # Enabling may search for the reference: that waits until the user has agreed to `home`.
        self.homed = not mover.may_move_on_enable()
        if self.homed:
            mover.enable()

    def position(self) -> dict[str, float]:
        place = self._reader.position
        return {field: place[name] for field, name in self._name_of_field.items()}

    def move_and_wait(self, goal: Mapping[str, float]) -> None:
        begin = self.position()
        farthest_um = max(abs(goal[field] - begin[field]) for field in goal)
        steps = max(1, -int(-farthest_um // self._step_um))
        target: dict[str, float] = {}
        for step in range(1, steps + 1):
            if self.background.stop_asked.is_set():
                # Near the end of a step is not yet still.
                if target:
                    self._wait_for(target, ARRIVED_UM)
                return
            if step == steps:
                target = dict(goal)
            else:
                target = {field: begin[field] + (goal[field] - begin[field]) * step / steps for field in goal}
            self._mover.move_to({self._name_of_field[field]: place for field, place in target.items()})
            self._wait_for(target, ARRIVED_UM if step == steps else self._near_um)
        self.background.stop_asked.wait(self._settle_s)

    def _wait_for(self, target: Mapping[str, float], near_um: float) -> None:
        """Return when the stage is at `target`, or near it and still; a Fault when it stands elsewhere."""
        last: dict[str, float] = {}
        changed_s = time.monotonic()
        while True:
            place = self.position()
            off_um = max(abs(place[field] - target[field]) for field in target)
            if off_um <= near_um:
                return
            if place != last:
                last, changed_s = place, time.monotonic()
            # A stage that has stopped short of its goal by its rounding needs no long wait.
            elif time.monotonic() - changed_s > (5 * POLL_S if off_um <= self._near_um else STALL_S):
                if off_um <= self._near_um:
                    return
                raise Fault(f"the stage was sent to {dict(target)} and stands at {place}")
            time.sleep(POLL_S)

    def stop_device(self) -> None:
        """`stop_asked` is set, which ends the move after the present step."""

    def home_and_wait(self) -> None:
        self._mover.enable()
        self.homed = True


class FrameSource:
    """A camera that puts its frames into a queue. The library's own way of asking for one deadlocks between threads."""

    def __init__(self, camera: Any, frames: queue.Queue[Any], frame_of: Callable[[Any], Any]) -> None:
        self.camera = camera
        self._frames = frames
        self._frame_of = frame_of

    def next_frame(self, exposure_s: float) -> Any:
        """Trigger one frame and wait for it."""
        while not self._frames.empty():
            self._frames.get_nowait()
        self.camera.trigger()
        try:
            frame = self._frame_of(self._frames.get(timeout=exposure_s + FRAME_WAIT_S))
        except queue.Empty:
            raise Fault("the camera gave no frame; look at the log of its device server") from None
        if isinstance(frame, Exception):
            raise Fault(f"the camera failed: {frame}")
        return frame


class MicroscopeCamera(Camera):
    """A camera of python-microscope, with the region and binning that it has now. Takes one frame to learn its size."""

    def __init__(
        self, source: FrameSource, name: str, min_exposure_ms: float, max_exposure_ms: float, bits: int | None
    ) -> None:
        self._source = source
        self.name = name
        self.min_exposure_ms, self.max_exposure_ms = min_exposure_ms, max_exposure_ms
        self.set_exposure_ms(min(max(self.get_exposure_ms(), min_exposure_ms), max_exposure_ms))
        first = source.next_frame(source.camera.get_exposure_time())
        if first.ndim not in (2, 3) or first.dtype.kind != "u" or first.dtype.itemsize > 2:
            raise Fault(
                f"the camera's frames are of shape {first.shape} and type {first.dtype}; only unsigned 8 or 16 bit"
            )
        self.height_px, self.width_px = first.shape[:2]
        self.channels = 1 if first.ndim == 2 else 3
        self.bits = bits or 8 * first.dtype.itemsize

    def get_exposure_ms(self) -> float:
        return self._source.camera.get_exposure_time() * 1000

    def set_exposure_ms(self, exposure_ms: float) -> None:
        self._source.camera.set_exposure_time(exposure_ms / 1000)

    def grab(self) -> Frame:
        exposure_ms = self.get_exposure_ms()
        began_s = time.monotonic()
        pixels = self._source.next_frame(exposure_ms / 1000)
        return Frame(pixels, exposure_ms=exposure_ms, began_s=began_s)


class MicroscopeNosepiece(BlockingNosepiece):
    """A filter wheel that carries objectives. Their ids are its positions, from "0"."""

    def __init__(self, wheel: Any, name: str, objectives: list[Objective]) -> None:
        super().__init__()
        self._wheel = wheel
        self.name = name
        self.objectives = objectives
        wheel.enable()

    def objective(self) -> str | None:
        return str(self._wheel.get_position())

    def change_and_wait(self, objective: str) -> None:
        self._wheel.set_position(int(objective))
