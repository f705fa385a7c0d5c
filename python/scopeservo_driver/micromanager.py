"""Stage, camera and nosepiece of a Micro-Manager core, whoever made the core."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from .background import BlockingNosepiece, BlockingStage
from .devices import Axis, Camera, Frame, Objective
from .errors import Fault

POLL_S = 0.01
FRAME_WAIT_S = 4.0
LOCKED_FOR_MS = 100.0


def _wait_while_busy(core: Any, labels: list[str]) -> None:
    while any(core.deviceBusy(label) for label in labels):
        time.sleep(POLL_S)


class MicroManagerStage(BlockingStage):
    """An XY stage, a focus drive, or both. Moves run in a thread, because some device adapters wait for their end."""

    def __init__(
        self,
        core: Any,
        xy_label: str | None,
        focus_label: str | None,
        axes: list[Axis],
        positive_z: str | None,
        moves: str,
        tolerance_um: float,
        settle_ms: float,
    ) -> None:
        super().__init__()
        self._core = core
        self._xy_label = xy_label
        self._focus_label = focus_label
        self._settle_s = settle_ms / 1000
        self._near_um = tolerance_um
        self._goal: dict[str, float] = {}
        self.name = " and ".join(f"Micro-Manager {label}" for label in (xy_label, focus_label) if label is not None)
        self.axes = axes
        self.positive_z = positive_z
        self.moves = moves
        self.tolerance_um = tolerance_um

    def position(self) -> dict[str, float]:
        place = {}
        if self._xy_label is not None:
            place["x_um"] = self._core.getXPosition(self._xy_label)
            place["y_um"] = self._core.getYPosition(self._xy_label)
        if self._focus_label is not None:
            place["z_um"] = self._core.getPosition(self._focus_label)
        return place

    def _where_it_stays(self, field: str, place: Mapping[str, float]) -> float:
        # Sending an axis to its read-back again and again would make it creep by the rounding of its steps.
        last = self._goal.get(field)
        if last is not None and abs(last - place[field]) <= self._near_um:
            return last
        return place[field]

    def move_and_wait(self, goal: Mapping[str, float]) -> None:
        started = []
        if self._xy_label is not None and ("x_um" in goal or "y_um" in goal):
            place = self.position()
            x_um, y_um = (goal[f] if f in goal else self._where_it_stays(f, place) for f in ("x_um", "y_um"))
            self._goal |= {"x_um": x_um, "y_um": y_um}
            self._core.setXYPosition(self._xy_label, x_um, y_um)
            started.append(self._xy_label)
        if self._focus_label is not None and "z_um" in goal and not self.background.stop_asked.is_set():
            self._core.setPosition(self._focus_label, goal["z_um"])
            started.append(self._focus_label)
        _wait_while_busy(self._core, started)
        self.background.stop_asked.wait(self._settle_s)
        if self.background.stop_asked.is_set():
            self._goal.clear()

    def stop_device(self) -> None:
        failures = []
        for label in (self._xy_label, self._focus_label):
            if label is None:
                continue
            try:
                self._core.stop(label)
            except RuntimeError as error:
                # Many focus drives cannot be stopped. That only matters while they move.
                if self._core.deviceBusy(label):
                    failures.append(str(error))
        if failures:
            raise Fault("; ".join(failures))


class MicroManagerCamera(Camera):
    """The camera of a core, with the region and binning that it has now."""

    def __init__(
        self,
        core: Any,
        label: str,
        min_exposure_ms: float,
        max_exposure_ms: float,
        same_library_as_stage: bool,
    ) -> None:
        self._core = core
        self._same_library_as_stage = same_library_as_stage
        self.name = f"Micro-Manager {label}"
        self.min_exposure_ms, self.max_exposure_ms = min_exposure_ms, max_exposure_ms
        self.width_px, self.height_px = core.getImageWidth(), core.getImageHeight()
        components = core.getNumberOfComponents()
        self.channels = 1 if components == 1 else 3
        sample_bytes = core.getBytesPerPixel() // components
        if components not in (1, 4) or sample_bytes not in (1, 2):
            raise Fault(f"the pixels of {label} are neither grey nor colour of 8 or 16 bits; set its PixelType")
        self.bits = 8 if sample_bytes == 1 else max(9, core.getImageBitDepth())

    def get_exposure_ms(self) -> float:
        return self._core.getExposure()

    def set_exposure_ms(self, exposure_ms: float) -> None:
        self._core.setExposure(exposure_ms)

    def grab(self) -> Frame:
        # A snap keeps the whole device library locked for its exposure, and with it the stop of a stage from that library.
        if self._same_library_as_stage and self.get_exposure_ms() > LOCKED_FOR_MS:
            began_s = time.monotonic()
            pixels = self._one_frame_of_a_sequence()
        else:
            began_s = time.monotonic()
            self._core.snapImage()
            pixels = self._core.getImage()
        # Micro-Manager's colour is blue, green, red, alpha.
        return Frame(pixels, order="bgr" if self.channels == 3 else "rgb", began_s=began_s)

    def _one_frame_of_a_sequence(self) -> Any:
        deadline_s = time.monotonic() + self.get_exposure_ms() / 1000 + FRAME_WAIT_S
        # This also empties the buffer of older frames.
        self._core.startSequenceAcquisition(1, 0.0, True)
        try:
            while self._core.getRemainingImageCount() == 0:
                if time.monotonic() > deadline_s:
                    raise Fault("the camera gave no frame; look whether it waits for a trigger")
                time.sleep(POLL_S)
            return self._core.popNextImage()
        finally:
            self._core.stopSequenceAcquisition()


class MicroManagerNosepiece(BlockingNosepiece):
    """A state device whose labels are the objectives. Micro-Manager cannot stop one: a change begun is carried through."""

    def __init__(self, core: Any, label: str, objectives: list[Objective]) -> None:
        super().__init__()
        self._core = core
        self._label = label
        self.name = f"Micro-Manager {label}"
        self.objectives = objectives

    def objective(self) -> str | None:
        return self._core.getStateLabel(self._label)

    def change_and_wait(self, objective: str) -> None:
        self._core.setStateLabel(self._label, objective)
        _wait_while_busy(self._core, [self._label])
