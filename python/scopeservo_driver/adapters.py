"""The calls of each device: what is checked before the driver's class is asked, and what it answers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from .devices import FIELD_OF_AXIS, UNIT_OF_AXIS, Frame
from .errors import BadRequest, Busy, Fault, NoSuchAxis, NoSuchObjective, NotHomed, OutsideLimits, Unsupported
from .frames import pack
from .messages import Request

MOTIONS = ("moving", "settled", "stopped")
IMMERSIONS = ("air", "water", "glycerol", "silicone", "oil")
MOVES = ("microscope", "specimen_rotation_on_top", "specimen_xy_on_top")
# Arrivals that scatter by more, or by a tenth of the travel, are no stage's of a microscope, but a unit's that is wrong.
WORST_REPEATABILITY = {"um": 50.0, "deg": 1.0}


@dataclass
class Reply:
    """What is asked for; with a frame, its samples and when its exposure began."""

    fields: dict[str, Any] = field(default_factory=dict)
    samples: bytes | None = None
    began_s: float = 0.0


def _finite(value: Any, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise Fault(f"the driver's class gave {value!r} for {what}; it must be a number") from None
    if not math.isfinite(number):
        raise Fault(f"the driver's class gave {number} for {what}; it must be finite")
    return number


def _motion(device: Any) -> str:
    motion = device.motion()
    if motion not in MOTIONS:
        raise Fault(f"the driver's class gave {motion!r} for motion; it must be one of {', '.join(MOTIONS)}")
    return motion


def _declared(condition: bool, what: str) -> None:
    if not condition:
        raise ValueError(what)


class StageAdapter:
    """The calls of a stage."""

    starts = ("move", "home")

    def __init__(self, device: Any) -> None:
        self.device = device
        self.name = str(getattr(device, "name", "stage"))
        self.axes = {axis.axis: axis for axis in device.axes}
        self.moves = getattr(device, "moves", "specimen_xy_on_top")
        self.positive_z = getattr(device, "positive_z", None)
        _declared(len(self.axes) == len(list(device.axes)) > 0, "a stage needs axes, each once")
        for axis in self.axes.values():
            _declared(
                axis.axis in UNIT_OF_AXIS, f"there is no axis {axis.axis}; the axes are {', '.join(UNIT_OF_AXIS)}"
            )
            numbers = (axis.min, axis.max, axis.repeatability)
            _declared(all(math.isfinite(n) for n in numbers), f"the numbers of axis {axis.axis} must be finite")
            _declared(axis.min < axis.max, f"min of axis {axis.axis} must be below its max")
            most = min(WORST_REPEATABILITY[UNIT_OF_AXIS[axis.axis]], (axis.max - axis.min) / 10)
            _declared(
                0 <= axis.repeatability <= most,
                f"the repeatability of axis {axis.axis} is {axis.repeatability} {UNIT_OF_AXIS[axis.axis]}; it must not be negative, "
                f"and {most} is the most that is believed: look at its unit",
            )
            _declared(
                axis.arrival_tolerance is None or 0 < axis.arrival_tolerance <= 4 * most,
                f"the arrival tolerance of axis {axis.axis} must be above 0 and at most {4 * most}: look at its unit",
            )
        _declared(self.moves in MOVES, f"moves of a stage must be one of {', '.join(MOVES)}")
        _declared(self.positive_z in (None, "closer", "apart"), 'positive_z must be "closer" or "apart"')
        _declared("z" not in self.axes or self.positive_z is not None, "a stage with a z axis needs positive_z")
        self.calls: dict[str, Callable[[Request], Reply]] = {
            "position": self.position,
            "move": self.move,
            "motion": self.motion,
            "home": self.home,
        }

    def describe(self) -> dict[str, Any]:
        axes = []
        for axis in self.axes.values():
            unit = UNIT_OF_AXIS[axis.axis]
            numbers = {"min": axis.min, "max": axis.max, "repeatability": axis.repeatability}
            if axis.arrival_tolerance is not None:
                numbers["arrival_tolerance"] = axis.arrival_tolerance
            axes.append({"axis": axis.axis} | {f"{name}_{unit}": float(value) for name, value in numbers.items()})
        said: dict[str, Any] = {"name": self.name, "moves": self.moves, "axes": axes}
        if self.positive_z is not None:
            said["positive_z"] = self.positive_z
        if not self._is_homed():
            said["homed"] = False
        if self._knows_speeds():
            said["speeds"] = True
        return said

    def _knows_speeds(self) -> bool:
        known = getattr(self.device, "knows_speeds", None)
        return callable(getattr(self.device, "move_at", None)) if known is None else bool(known)

    def _is_homed(self) -> bool:
        return bool(getattr(self.device, "homed", True))

    def _check_homed(self) -> None:
        if not self._is_homed():
            raise NotHomed("the stage does not know where it is; home it first")

    def position(self, request: Request) -> Reply:
        self._check_homed()
        place = self.device.position()
        said = {}
        for axis in self.axes:
            name = FIELD_OF_AXIS[axis]
            if name not in place:
                raise Fault(f"the stage's class gave no {name} in its position")
            said[name] = _finite(place[name], name)
        return Reply(said)

    def move(self, request: Request) -> Reply:
        goal = {axis: request.number(name) for axis, name in FIELD_OF_AXIS.items() if name in request}
        if not goal:
            raise BadRequest("a move needs a goal for at least one axis, such as x_um")
        for axis in goal:
            if axis not in self.axes:
                raise NoSuchAxis(f"the stage has no axis {axis}")
        for axis, place in goal.items():
            ends = self.axes[axis]
            if not ends.min <= place <= ends.max:
                unit = UNIT_OF_AXIS[axis]
                raise OutsideLimits(
                    f"{axis} {place:g} {unit} is outside the travel, {ends.min:g} to {ends.max:g} {unit}"
                )
        speed_um_per_s = self._speed(request)
        self._check_homed()
        self._check_still()
        named = {FIELD_OF_AXIS[axis]: place for axis, place in goal.items()}
        if speed_um_per_s is None:
            self.device.move(named)
        else:
            self.device.move_at(named, speed_um_per_s)
        return Reply()

    def _speed(self, request: Request) -> float | None:
        if "speed_um_per_s" not in request:
            return None
        if not self._knows_speeds():
            raise Unsupported("the speed of this stage cannot be chosen")
        speed_um_per_s = request.number("speed_um_per_s")
        if not speed_um_per_s > 0:
            raise OutsideLimits(f"a speed is above 0; {speed_um_per_s:g} um/s was asked for")
        return speed_um_per_s

    def _check_still(self) -> None:
        if _motion(self.device) == "moving":
            raise Busy("the stage still moves; wait for its end or stop it")

    def motion(self, request: Request) -> Reply:
        return Reply({"motion": _motion(self.device)})

    def home(self, request: Request) -> Reply:
        if not hasattr(self.device, "home"):
            raise Unsupported("this stage cannot be homed by the program")
        self._check_still()
        self.device.home()
        return Reply()


class NosepieceAdapter:
    """The calls of a nosepiece."""

    starts = ("change",)

    def __init__(self, device: Any) -> None:
        self.device = device
        self.name = str(getattr(device, "name", "nosepiece"))
        self.objectives = {objective.id: objective for objective in device.objectives}
        _declared(
            len(self.objectives) == len(list(device.objectives)) > 0, "a nosepiece needs objectives, each id once"
        )
        for objective in self.objectives.values():
            numbers = (objective.magnification, objective.numerical_aperture, objective.um_per_px)
            _declared(
                all(math.isfinite(n) and n > 0 for n in numbers),
                f"the numbers of objective {objective.id} must be positive",
            )
            _declared(
                objective.immersion in IMMERSIONS,
                f"the immersion of objective {objective.id} must be one of {', '.join(IMMERSIONS)}",
            )
        self.calls: dict[str, Callable[[Request], Reply]] = {"objective": self.objective, "change": self.change}

    def describe(self) -> dict[str, Any]:
        objectives = [
            {
                "id": objective.id,
                "magnification": float(objective.magnification),
                "numerical_aperture": float(objective.numerical_aperture),
                "um_per_px": float(objective.um_per_px),
                # Left out where a program of before it was thought of would take it to be.
                **({} if objective.immersion == "air" else {"immersion": objective.immersion}),
            }
            for objective in self.objectives.values()
        ]
        return {"name": self.name, "objectives": objectives}

    def objective(self, request: Request) -> Reply:
        motion = _motion(self.device)
        reached = None if motion == "moving" else self.device.objective()
        return Reply({"objective": reached if reached in self.objectives else None, "motion": motion})

    def change(self, request: Request) -> Reply:
        wanted = request.text("objective")
        if wanted not in self.objectives:
            raise NoSuchObjective(f"there is no objective {wanted}; there are {', '.join(self.objectives)}")
        if _motion(self.device) == "moving":
            raise Busy("the nosepiece still turns; wait for its end or stop it")
        self.device.change(wanted)
        return Reply()


class CameraAdapter:
    """The calls of a camera."""

    starts = ()

    def __init__(self, device: Any) -> None:
        self.device = device
        self.name = str(getattr(device, "name", "camera"))
        self.width_px, self.height_px = int(device.width_px), int(device.height_px)
        self.channels, self.bits = int(getattr(device, "channels", 1)), int(getattr(device, "bits", 8))
        self.min_exposure_ms, self.max_exposure_ms = float(device.min_exposure_ms), float(device.max_exposure_ms)
        self.frames = 0
        for size in (self.width_px, self.height_px):
            _declared(1 <= size <= 16384, "a camera's width_px and height_px must be 1 to 16384")
        _declared(self.channels in (1, 3), "a camera's channels must be 1 or 3")
        _declared(8 <= self.bits <= 16, "a camera's bits must be 8 to 16")
        _declared(
            0 <= self.min_exposure_ms <= self.max_exposure_ms < math.inf and self.max_exposure_ms > 0,
            "a camera needs min_exposure_ms and, not below it, max_exposure_ms",
        )
        self.calls: dict[str, Callable[[Request], Reply]] = {"exposure": self.exposure, "grab": self.grab}

    def _size(self) -> dict[str, Any]:
        return {
            "width_px": self.width_px,
            "height_px": self.height_px,
            "channels": self.channels,
            "bits": self.bits,
        }

    def describe(self) -> dict[str, Any]:
        exposures = {"min_exposure_ms": self.min_exposure_ms, "max_exposure_ms": self.max_exposure_ms}
        return {"name": self.name} | self._size() | exposures

    def exposure(self, request: Request) -> Reply:
        if "exposure_ms" in request:
            wanted_ms = request.number("exposure_ms")
            if not self.min_exposure_ms <= wanted_ms <= self.max_exposure_ms:
                raise OutsideLimits(
                    f"{wanted_ms:g} ms is outside the exposures, {self.min_exposure_ms:g} to {self.max_exposure_ms:g} ms"
                )
            self.device.set_exposure_ms(wanted_ms)
        return Reply({"exposure_ms": _finite(self.device.get_exposure_ms(), "exposure_ms")})

    def grab(self, request: Request) -> Reply:
        called_s = time.monotonic()
        frame = self.device.grab()
        if not isinstance(frame, Frame):
            frame = Frame(frame)
        samples = pack(frame.pixels, frame.order, self.width_px, self.height_px, self.channels, self.bits)
        exposure_ms = self.device.get_exposure_ms() if frame.exposure_ms is None else frame.exposure_ms
        self.frames += 1
        said = self._size() | {
            "exposure_ms": _finite(exposure_ms, "exposure_ms"),
            "sequence": self.frames if frame.sequence is None else int(frame.sequence),
        }
        return Reply(said, samples, called_s if frame.began_s is None else frame.began_s)


class LightAdapter:
    """The call of a light."""

    starts = ()

    def __init__(self, device: Any) -> None:
        self.device = device
        self.name = str(getattr(device, "name", "light"))
        self.calls: dict[str, Callable[[Request], Reply]] = {"light": self.light}

    def describe(self) -> dict[str, Any]:
        return {"name": self.name}

    def light(self, request: Request) -> Reply:
        if "level" in request:
            wanted = request.number("level")
            if not 0 <= wanted <= 1:
                raise OutsideLimits(f"level {wanted:g} is outside 0 to 1")
            self.device.set_level(wanted)
        return Reply({"level": _finite(self.device.get_level(), "level")})


Adapter = StageAdapter | NosepieceAdapter | CameraAdapter | LightAdapter
