"""A driver for devices of python-microscope.

    python -m scopeservo_driver.microscope --image specimen.png
    python -m scopeservo_driver.microscope --stage PYRO:stage@127.0.0.1:8000 --camera PYRO:camera@127.0.0.1:8000 \\
        --exposure-ms 1 1000 --positive-z closer

Its stages must count in micrometres. python-microscope is not part of this package and is imported when this runs:
pip install microscope
"""

from __future__ import annotations

import argparse
import math
import queue
import sys
from pathlib import Path
from typing import Any

from .devices import Axis, Objective, translation
from .errors import DriverError
from .options import OptionError, add_objective_option, add_serving_options, add_stage_options, serve_as_asked
from .python_microscope import FrameSource, MicroscopeCamera, MicroscopeNosepiece, MicroscopeStage
from .standard_streams import protect_stdout


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m scopeservo_driver.microscope", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--image", type=Path, metavar="FILE", help="a simulated stage and camera over this colour image"
    )
    for device in ("stage", "camera", "filterwheel"):
        parser.add_argument(f"--{device}", metavar="URI", help=f"a {device} of a device server that you trust")
    for axis in "xyz":
        parser.add_argument(f"--{axis}-axis", default=None, metavar="NAME", help=f"the stage's name of {axis}, or none")
        parser.add_argument(
            f"--{axis}-um", nargs=2, type=float, metavar=("MIN", "MAX"), help=f"narrower ends of travel of {axis}"
        )
    parser.add_argument(
        "--step-um", type=float, default=200.0, metavar="UM", help="stop waits for a step of this length (200 um)"
    )
    parser.add_argument("--exposure-ms", nargs=2, type=float, metavar=("MIN", "MAX"), help="the range of exposures")
    parser.add_argument("--bits", type=int, help="bits of a sample, when fewer than its bytes hold")
    add_stage_options(parser)
    add_objective_option(parser)
    add_serving_options(parser)
    return parser


def _axes(stage: Any, options: argparse.Namespace) -> tuple[dict[str, str], list[Axis]]:
    """The stage's own names of x, y and z, and its axes with its own limits or narrower ones."""
    limits = stage.limits
    name_of_axis: dict[str, str] = {}
    axes = []
    for axis in "xyz":
        asked = getattr(options, f"{axis}_axis")
        if asked == "none":
            continue
        if asked is not None and asked not in limits:
            raise OptionError(f"--{axis}-axis {asked}: the stage's axes are {', '.join(limits)}")
        name = asked or next((name for name in limits if name.lower() == axis), None)
        if name is None:
            continue
        lower_um, upper_um = float(limits[name].lower), float(limits[name].upper)
        narrower = getattr(options, f"{axis}_um")
        if narrower is not None:
            if not lower_um <= narrower[0] < narrower[1] <= upper_um:
                raise OptionError(f"--{axis}-um must be within the stage's own limits, {lower_um:g} to {upper_um:g}")
            lower_um, upper_um = narrower
        if not math.isfinite(lower_um) or not math.isfinite(upper_um):
            raise OptionError(f"give --{axis}-um MIN MAX: the stage does not know its limits of {name}")
        name_of_axis[axis] = name
        axes.append(translation(axis, min_um=lower_um, max_um=upper_um, repeatability_um=options.repeatability_um))
    if not axes:
        raise OptionError(f"give --x-axis, --y-axis, --z-axis: the stage's axes are {', '.join(limits)}")
    return name_of_axis, axes


def _stage(mover: Any, reader: Any, name: str, options: argparse.Namespace) -> MicroscopeStage:
    name_of_axis, axes = _axes(reader, options)
    if "z" in name_of_axis and options.positive_z is None:
        raise OptionError("give --positive-z closer or apart: what larger z does; or --z-axis none to leave it out")
    if not options.step_um > 0:
        raise OptionError("--step-um must be above 0")
    return MicroscopeStage(
        mover,
        reader,
        name,
        name_of_axis,
        axes,
        options.positive_z if "z" in name_of_axis else None,
        options.moves,
        options.tolerance_um,
        options.settle_ms,
        options.step_um,
    )


def _nosepiece(wheel: Any, name: str, options: argparse.Namespace) -> MicroscopeNosepiece:
    positions = [str(position) for position in range(wheel.get_num_positions())]
    for objective in options.objective:
        if objective.id not in positions:
            raise OptionError(f"--objective {objective.id}: the ids are the wheel's positions, {', '.join(positions)}")
    return MicroscopeNosepiece(wheel, name, options.objective)


def _simulated(options: argparse.Namespace) -> dict[str, Any]:
    from microscope.simulators.stage_aware_camera import simulated_setup_from_image

    setup = simulated_setup_from_image(str(options.image))
    if options.positive_z is None:
        options.positive_z = "closer"
    frames: queue.Queue[Any] = queue.Queue()
    camera = setup["camera"]
    camera.set_client(frames)
    camera.enable()
    min_ms, max_ms = options.exposure_ms or (1.0, 5000.0)
    # The wheel chooses the image's channel; nothing in this simulation changes the magnification.
    if not options.objective:
        options.objective = [Objective("0", 10, 0.25, 1.0)]
    return {
        "stage": _stage(setup["stage"], setup["stage"], "python-microscope simulated stage", options),
        "camera": MicroscopeCamera(
            FrameSource(camera, frames, lambda frame: frame),
            "python-microscope stage-aware camera",
            min_ms,
            max_ms,
            options.bits,
        ),
        "nosepiece": _nosepiece(setup["filterwheel"], "python-microscope simulated filter wheel", options),
    }


def _served(options: argparse.Namespace) -> dict[str, Any]:
    # Importing this sets up Pyro4 the way the device server wants it.
    from microscope.clients import DataClient, Pyro4

    devices: dict[str, Any] = {}
    if options.stage is not None:
        mover, reader = Pyro4.Proxy(options.stage), Pyro4.Proxy(options.stage)
        devices["stage"] = _stage(mover, reader, f"python-microscope {options.stage}", options)
    if options.camera is not None:
        if options.exposure_ms is None:
            raise OptionError("give --exposure-ms MIN MAX, which python-microscope does not know of its cameras")

        class Receiver(DataClient):
            @property
            def frames(self) -> queue.Queue[Any]:
                return self._buffer

        camera = Receiver(options.camera)
        camera.enable()
        devices["camera"] = MicroscopeCamera(
            FrameSource(camera, camera.frames, lambda frame_and_time: frame_and_time[0]),
            f"python-microscope {options.camera}",
            options.exposure_ms[0],
            options.exposure_ms[1],
            options.bits,
        )
    if options.filterwheel is not None:
        if not options.objective:
            raise OptionError(
                "give --objective for each position of the filter wheel that has one, such as 0:10:0.25:1.0"
            )
        wheel = Pyro4.Proxy(options.filterwheel)
        devices["nosepiece"] = _nosepiece(wheel, f"python-microscope {options.filterwheel}", options)
    return devices


def _devices(options: argparse.Namespace) -> dict[str, Any]:
    try:
        import microscope  # noqa: F401
    except ImportError as error:
        raise OptionError(f"python-microscope is missing ({error}): pip install microscope") from None
    served = [options.stage, options.camera, options.filterwheel]
    if (options.image is None) == (served == [None, None, None]):
        raise OptionError("give either --image, or URIs with --stage, --camera and --filterwheel")
    return _simulated(options) if options.image is not None else _served(options)


def main(arguments: list[str] | None = None) -> None:
    """Run the driver."""
    parser = _parser()
    options = parser.parse_args(arguments)
    protect_stdout()
    try:
        serve_as_asked(options, "python-microscope", **_devices(options))
    except Exception as error:
        # Pyro has exceptions of its own for a server that cannot be reached.
        if (
            not isinstance(error, (OptionError, DriverError, OSError, ValueError))
            and "Pyro" not in type(error).__module__
        ):
            raise
        print(f"{parser.prog}: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
