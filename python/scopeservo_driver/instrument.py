"""All devices of a driver, each with the thread that calls it, and the stop that may come at any time."""

from __future__ import annotations

import queue
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any

from .errors import DriverError, Fault, Refused
from .messages import Request
from .adapters import Adapter, CameraAdapter, LightAdapter, NosepieceAdapter, Reply, StageAdapter

CALLS_BY_DEVICE = {
    "stage": ("position", "move", "motion", "home"),
    "camera": ("exposure", "grab"),
    "nosepiece": ("objective", "change"),
    "light": ("light",),
}
DEVICE_OF_CALL = {call: device for device, calls in CALLS_BY_DEVICE.items() for call in calls}

END_WAIT_S = 2.0


def as_driver_error(error: BaseException) -> DriverError:
    """What to answer when a driver's class raised `error`; what is not meant for the user goes to standard error in full."""
    if isinstance(error, DriverError):
        return error
    traceback.print_exception(error, file=sys.stderr)
    return Fault(str(error) or type(error).__name__)


class Worker:
    """A thread that does one job after another."""

    def __init__(self, name: str) -> None:
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        threading.Thread(target=self._run, daemon=True, name=name).start()

    def _run(self) -> None:
        while True:
            self._jobs.get()()

    def do(self, job: Callable[[], None]) -> None:
        """Do `job` after those before it."""
        self._jobs.put(job)

    def wait(self, timeout_s: float) -> bool:
        """Wait until the jobs given so far are done; false when they take longer."""
        done = threading.Event()
        self.do(done.set)
        return done.wait(timeout_s)


class Instrument:
    """The devices, whoever is connected."""

    def __init__(self, stage: Any, camera: Any, nosepiece: Any, light: Any, name: str) -> None:
        self.name = name
        self.adapters: dict[str, Adapter] = {}
        if stage is not None:
            self.adapters["stage"] = StageAdapter(stage)
        if camera is not None:
            self.adapters["camera"] = CameraAdapter(camera)
        if nosepiece is not None:
            self.adapters["nosepiece"] = NosepieceAdapter(nosepiece)
        if light is not None:
            self.adapters["light"] = LightAdapter(light)
        if not self.adapters:
            raise ValueError("a driver needs at least one of stage, camera, nosepiece and light")
        self.workers = {device: Worker(device) for device in self.adapters}
        self._lock = threading.Lock()
        self._stops = 0

    def describe(self) -> dict[str, Any]:
        """The devices as hello tells them."""
        return {device: adapter.describe() for device, adapter in self.adapters.items()}

    def stops_so_far(self) -> int:
        """How often `stop` was asked for."""
        with self._lock:
            return self._stops

    def do(self, device: str, request: Request, stops_seen: int) -> Reply:
        """Carry out `request`, on the worker of `device`. `stops_seen` is the count when the request was read."""
        adapter = self.adapters[device]
        starts = request.call in adapter.starts
        if starts and self.stops_so_far() != stops_seen:
            raise Refused("stop came before this had begun; nothing moved")
        reply = adapter.calls[request.call](request)
        if starts and self.stops_so_far() != stops_seen:
            # The stop may have reached the device before the move did.
            adapter.device.stop()
        return reply

    def stop(self) -> None:
        """Stop stage and nosepiece, side by side so that a slow one does not keep the other waiting."""
        with self._lock:
            self._stops += 1
        errors: list[BaseException] = []

        def tell(device: Any) -> None:
            try:
                device.stop()
            except BaseException as error:
                errors.append(error)

        moving = [adapter.device for name, adapter in self.adapters.items() if name in ("stage", "nosepiece")]
        threads = [
            threading.Thread(target=tell, args=(device,), daemon=True, name="stop")
            for device in moving
            if hasattr(device, "stop")
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if errors:
            raise as_driver_error(errors[0])

    def end(self) -> None:
        """Stop, and wait a little for moves that are just being started."""

        def stop_and_tell() -> None:
            try:
                self.stop()
            except DriverError as error:
                print(f"stopping failed: {error}", file=sys.stderr)

        thread = threading.Thread(target=stop_and_tell, daemon=True, name="end")
        thread.start()
        thread.join(END_WAIT_S)
        for device in ("stage", "nosepiece"):
            if device in self.workers:
                self.workers[device].wait(END_WAIT_S)
