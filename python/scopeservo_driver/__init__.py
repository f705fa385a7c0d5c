"""Make a scopeservo driver out of any Python class. See README.md for an example."""

from .background import BlockingNosepiece, BlockingStage
from .devices import (
    Axis,
    Camera,
    Frame,
    Light,
    Nosepiece,
    Objective,
    Stage,
    rotation,
    translation,
)
from .errors import (
    Busy,
    DriverError,
    Fault,
    NoSuchAxis,
    NoSuchObjective,
    NotHomed,
    OutsideLimits,
    Refused,
    Unsupported,
)
from .serving import serve, serve_tcp
from .standard_streams import protect_stdout

__version__ = "0.1.0"

__all__ = [
    "Axis",
    "BlockingNosepiece",
    "BlockingStage",
    "Busy",
    "Camera",
    "DriverError",
    "Fault",
    "Frame",
    "Light",
    "NoSuchAxis",
    "NoSuchObjective",
    "Nosepiece",
    "NotHomed",
    "Objective",
    "OutsideLimits",
    "Refused",
    "Stage",
    "Unsupported",
    "protect_stdout",
    "rotation",
    "serve",
    "serve_tcp",
    "translation",
]
