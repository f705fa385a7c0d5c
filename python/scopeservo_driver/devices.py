"""The classes that a driver's author writes.

Subclass them, or write any class with the same attributes and methods. Lengths are micrometres, angles degrees, times
milliseconds: the unit is in the name.

One thread calls all methods of a device, one after another, but for `stop`, which comes from a thread of its own at any
time, also while another method of the same device runs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from .errors import Unsupported

Motion = Literal["moving", "settled", "stopped"]

UNIT_OF_AXIS: dict[str, str] = {"x": "um", "y": "um", "z": "um", "rx": "deg", "ry": "deg", "rz": "deg"}
FIELD_OF_AXIS: dict[str, str] = {axis: f"{axis}_{unit}" for axis, unit in UNIT_OF_AXIS.items()}


@dataclass(frozen=True)
class Axis:
    """One axis of a stage: its ends of travel, and the half-width of the interval in which repeated arrivals end.

    All three numbers are micrometres for "x", "y", "z" and degrees for "rx", "ry", "rz".
    `translation` and `rotation` make one with the unit in the names.
    """

    axis: str
    min: float
    max: float
    repeatability: float
    arrival_tolerance: float | None = None


def translation(
    axis: str, *, min_um: float, max_um: float, repeatability_um: float, arrival_tolerance_um: float | None = None
) -> Axis:
    """An axis "x", "y" or "z".

    A move counts as arrived where the stage then says that it is within `arrival_tolerance_um` of the goal: four times
    the repeatability, at least 1 um, when it is left out.
    """
    return Axis(axis, min_um, max_um, repeatability_um, arrival_tolerance_um)


def rotation(
    axis: str, *, min_deg: float, max_deg: float, repeatability_deg: float, arrival_tolerance_deg: float | None = None
) -> Axis:
    """An axis "rx", "ry" or "rz". `arrival_tolerance_deg` as in `translation`; at least 0.005 deg when it is left out."""
    return Axis(axis, min_deg, max_deg, repeatability_deg, arrival_tolerance_deg)


@dataclass(frozen=True)
class Objective:
    """One objective of a nosepiece.

    `magnification` is the total one and orders them; `um_per_px` is the nominal size of a camera pixel on the specimen,
    within 30 %. `immersion`: what it works in, one of "air", "water", "glycerol", "silicone" and "oil". The program asks somebody
    before an objective comes that works in another medium.
    """

    id: str
    magnification: float
    numerical_aperture: float
    um_per_px: float
    immersion: str = "air"


@dataclass(frozen=True)
class Frame:
    """One picture, for cameras that know more than its pixels.

    `pixels`: bytes, or anything with the buffer protocol or with `tobytes()`, `shape` and `dtype`, such as a numpy array
    of shape (height, width) or (height, width, samples). Unsigned 8 or 16 bit; rows from the top, pixels from the left.
    `order`: "rgb" or "bgr" of the first three samples of a pixel; a fourth (alpha) is dropped.
    `exposure_ms`: how long it was exposed; left out, the camera's `get_exposure_ms()`.
    `sequence`: the camera's own count of its frames; left out, this package counts.
    `began_s`: `time.monotonic()` when the exposure began; left out, the time when `grab` was called.
    """

    pixels: Any
    order: Literal["rgb", "bgr"] = "rgb"
    exposure_ms: float | None = None
    sequence: int | None = None
    began_s: float | None = None


class Stage(ABC):
    """A stage with any of the axes x, y, z (micrometres) and rx, ry, rz (degrees).

    Places and goals are mappings such as `{"x_um": 1200.0, "rz_deg": 0.5}`. Before `move` is called, this package has
    checked that the axes exist, that the goal is within the travel and that nothing moves.
    """

    name: str = "stage"
    """Maker and model."""

    axes: Sequence[Axis] = ()
    """The axes that there are."""

    moves: str = "specimen_xy_on_top"
    """What the stage carries: "microscope", "specimen_rotation_on_top" or "specimen_xy_on_top"."""

    positive_z: str | None = None
    """What larger z does: "closer" brings objective and specimen together, "apart" takes them apart. Needed with a z axis."""

    homed: bool = True
    """False while the stage must be homed before it knows where it is. May be a property."""

    @abstractmethod
    def position(self) -> Mapping[str, float]:
        """The place of every axis, read from the device, also during motion."""

    @abstractmethod
    def move(self, goal: Mapping[str, float]) -> None:
        """Start towards `goal`, absolute, and return at once. Axes not named stay where they are.

        When the library only has a move that waits for its end, use `BlockingStage`.
        """

    @abstractmethod
    def motion(self) -> Motion:
        """ "moving" (under way or settling), "settled" (at its goal, or nothing ever moved), "stopped" (ended before)."""

    @abstractmethod
    def stop(self) -> None:
        """Stop everything that moves, now. Called from another thread, at any time; must return within 0.2 s."""

    # A stage whose speed can be chosen has one method more, and only then is asked for it:
    #
    #     def move_at(self, goal: Mapping[str, float], speed_um_per_s: float) -> None
    #
    # As `move`, no faster than that along the way. The usual speed is back for the next move, however this one ends.

    def home(self) -> None:
        """Start finding the reference and return at once; may move anything anywhere."""
        raise Unsupported("this stage cannot be homed by the program; home it with its maker's tool")


class Camera(ABC):
    """A camera. Grey or red-green-blue, 8 to 16 bits."""

    name: str = "camera"
    """Maker and model."""

    width_px: int = 0
    height_px: int = 0
    channels: int = 1
    """1 for grey, 3 for red, green and blue."""

    bits: int = 8
    """8 to 16. Samples of more than 8 bits take two bytes, the low one first."""

    min_exposure_ms: float = 0.0
    max_exposure_ms: float = 0.0

    @abstractmethod
    def get_exposure_ms(self) -> float:
        """The exposure now in force, as the camera rounds it."""

    @abstractmethod
    def set_exposure_ms(self, exposure_ms: float) -> None:
        """Set it. This package has checked that it is between `min_exposure_ms` and `max_exposure_ms`."""

    @abstractmethod
    def grab(self) -> Frame | Any:
        """One frame whose exposure begins after this call: never one from a buffer. A `Frame`, or just its pixels."""


class Nosepiece(ABC):
    """A turret of objectives."""

    name: str = "nosepiece"
    """Maker and model."""

    objectives: Sequence[Objective] = ()

    @abstractmethod
    def objective(self) -> str | None:
        """The id of the one in the beam, or None while turning or when unknown."""

    @abstractmethod
    def change(self, objective: str) -> None:
        """Start turning to `objective` and return at once. This package has checked that it exists and nothing turns."""

    @abstractmethod
    def motion(self) -> Motion:
        """As of a stage."""

    def stop(self) -> None:
        """Stop turning, now. From another thread, at any time. Nothing to do when the turret cannot be stopped."""


class Light(ABC):
    """A lamp with a level from 0 to 1."""

    name: str = "light"
    """Maker and model."""

    @abstractmethod
    def get_level(self) -> float:
        """The level now in force, 0 to 1."""

    @abstractmethod
    def set_level(self, level: float) -> None:
        """Set it. This package has checked that it is between 0 and 1."""
