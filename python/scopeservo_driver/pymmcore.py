"""A driver for everything that Micro-Manager drives, by way of pymmcore.

    python -m scopeservo_driver.pymmcore --config microscope.cfg --x-um 0 100000 --y-um 0 80000 --focus none
    python -m scopeservo_driver.pymmcore --demo beads
    python -m scopeservo_driver.pymmcore --demo sample

pymmcore is not part of this package and is imported when this runs: pip install pymmcore
"""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from .devices import Axis, translation
from .errors import DriverError
from .micromanager import MicroManagerCamera, MicroManagerNosepiece, MicroManagerStage
from .micromanager_demos import load_beads, load_sample
from .options import OptionError, add_objective_option, add_serving_options, add_stage_options, serve_as_asked
from .standard_streams import protect_stdout

CAMERA, STATE, FOCUS, XY_STAGE = 2, 4, 5, 6
"""Types of devices, as Micro-Manager numbers them."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m scopeservo_driver.pymmcore", description=__doc__.splitlines()[0])
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--config", type=Path, metavar="FILE.cfg", help="a configuration of Micro-Manager")
    source.add_argument(
        "--device",
        nargs=3,
        action="append",
        metavar=("LABEL", "LIBRARY", "DEVICE"),
        help="load this device; repeat for each",
    )
    source.add_argument("--demo", choices=("beads", "sample"), help="simulated devices and specimen")
    parser.add_argument("--adapters", type=Path, metavar="FOLDER", help="where Micro-Manager's device adapters are")
    parser.add_argument(
        "--property",
        nargs=3,
        action="append",
        default=[],
        metavar=("LABEL", "PROPERTY", "VALUE"),
        help="set this property; repeat for each",
    )
    for role, what in (
        ("camera", "camera"),
        ("xy-stage", "XY stage"),
        ("focus", "focus drive"),
        ("turret", "state device that turns the objectives"),
    ):
        parser.add_argument(f"--{role}", metavar="LABEL", help=f"the {what}, or none")
    for axis in "xyz":
        parser.add_argument(
            f"--{axis}-um", nargs=2, type=float, metavar=("MIN", "MAX"), help=f"the ends of travel of {axis}"
        )
    parser.add_argument("--exposure-ms", nargs=2, type=float, metavar=("MIN", "MAX"), help="the range of exposures")
    add_stage_options(parser)
    add_objective_option(parser)
    add_serving_options(parser)
    return parser


def _adapters_folder(options: argparse.Namespace) -> str:
    if options.adapters is not None:
        return str(options.adapters)
    if "MICROMANAGER_PATH" in os.environ:
        return os.environ["MICROMANAGER_PATH"]
    try:
        import pymmcore_plus

        found = pymmcore_plus.find_micromanager()
    except ImportError:
        found = None
    if not found:
        raise OptionError("give --adapters FOLDER, where Micro-Manager's device adapters are")
    return str(found)


def _set_properties(core: Any, options: argparse.Namespace, before_initialization: bool) -> None:
    for label, name, value in options.property:
        if core.isPropertyPreInit(label, name) == before_initialization:
            core.setProperty(label, name, value)


def load_core(options: argparse.Namespace, until_the_end: ExitStack) -> Any:
    """A core with the devices that the options ask for."""
    try:
        import pymmcore
    except ImportError as error:
        raise OptionError(f"pymmcore is missing ({error}): pip install pymmcore") from None
    if options.demo == "sample":
        core = load_sample(options, until_the_end)
    elif options.demo == "beads":
        core = load_beads(options)
    else:
        core = pymmcore.CMMCore()
        core.setDeviceAdapterSearchPaths([_adapters_folder(options)])
        if options.config is not None:
            core.loadSystemConfiguration(str(options.config))
        else:
            for label, library, device in options.device:
                core.loadDevice(label, library, device)
            _set_properties(core, options, before_initialization=True)
            core.initializeAllDevices()
    until_the_end.callback(core.unloadAllDevices)
    _set_properties(core, options, before_initialization=False)
    return core


def _role(core: Any, asked: str | None, of_core: str, device_type: int, option: str) -> str | None:
    """The label of the device for one role: the one asked for, the core's own, or the only one of its type."""
    if asked == "none":
        return None
    there_are = list(core.getLoadedDevicesOfType(device_type))
    if asked is not None:
        if asked not in there_are:
            raise OptionError(f"{option} {asked}: there is none; there are {', '.join(there_are) or 'none at all'}")
        return asked
    if of_core:
        return of_core
    if len(there_are) > 1:
        raise OptionError(f"give {option}, one of {', '.join(there_are)}, or none")
    return there_are[0] if there_are else None


def _axis(options: argparse.Namespace, axis: str, device: str, option: str) -> Axis:
    ends_um = getattr(options, f"{axis}_um")
    if ends_um is None:
        raise OptionError(
            f"give --{axis}-um MIN MAX, the travel that is safe for {axis} of {device}, which Micro-Manager does not "
            f"know; or {option} none to leave it out"
        )
    return translation(axis, min_um=ends_um[0], max_um=ends_um[1], repeatability_um=options.repeatability_um)


def _stage(core: Any, options: argparse.Namespace) -> MicroManagerStage | None:
    xy_label = _role(core, options.xy_stage, core.getXYStageDevice(), XY_STAGE, "--xy-stage")
    focus_label = _role(core, options.focus, core.getFocusDevice(), FOCUS, "--focus")
    axes = []
    if xy_label is not None:
        axes += [_axis(options, axis, xy_label, "--xy-stage") for axis in "xy"]
    positive_z = None
    if focus_label is not None:
        axes.append(_axis(options, "z", focus_label, "--focus"))
        known = {1: "closer", -1: "apart"}.get(core.getFocusDirection(focus_label))
        positive_z = options.positive_z or known
        if positive_z is None:
            raise OptionError(f"give --positive-z closer or apart: what larger z of {focus_label} does")
    if not axes:
        return None
    return MicroManagerStage(
        core, xy_label, focus_label, axes, positive_z, options.moves, options.tolerance_um, options.settle_ms
    )


def _camera(core: Any, options: argparse.Namespace) -> MicroManagerCamera | None:
    label = _role(core, options.camera, core.getCameraDevice(), CAMERA, "--camera")
    if label is None:
        return None
    core.setCameraDevice(label)
    ends_ms = options.exposure_ms
    if ends_ms is None and core.hasPropertyLimits(label, "Exposure"):
        ends_ms = core.getPropertyLowerLimit(label, "Exposure"), core.getPropertyUpperLimit(label, "Exposure")
    if ends_ms is None:
        raise OptionError(f"give --exposure-ms MIN MAX, the range of exposures of {label}")
    library = core.getDeviceLibrary(label)
    moving = [
        other
        for device_type in (XY_STAGE, FOCUS)
        for other in core.getLoadedDevicesOfType(device_type)
        if core.getDeviceLibrary(other) == library
    ]
    return MicroManagerCamera(core, label, ends_ms[0], ends_ms[1], bool(moving))


def _nosepiece(core: Any, options: argparse.Namespace) -> MicroManagerNosepiece | None:
    if not options.objective or options.turret == "none":
        return None
    wanted = {objective.id for objective in options.objective}
    labels = {turret: set(core.getStateLabels(turret)) for turret in core.getLoadedDevicesOfType(STATE)}
    fitting = [turret for turret, there_are in labels.items() if wanted <= there_are]
    if options.turret is not None:
        fitting = [turret for turret in fitting if turret == options.turret]
    if len(fitting) != 1:
        known = "; ".join(f"{turret}: {', '.join(sorted(there_are))}" for turret, there_are in labels.items())
        raise OptionError(
            f"{'no turret has' if not fitting else 'give --turret: several have'} all of {', '.join(sorted(wanted))}. "
            f"The labels that there are: {known or 'none'}"
        )
    return MicroManagerNosepiece(core, fitting[0], options.objective)


def main(arguments: list[str] | None = None) -> None:
    """Run the driver."""
    parser = _parser()
    options = parser.parse_args(arguments)
    protect_stdout()
    with ExitStack() as until_the_end:
        try:
            core = load_core(options, until_the_end)
            stage, camera, nosepiece = _stage(core, options), _camera(core, options), _nosepiece(core, options)
            serve_as_asked(options, "Micro-Manager", stage=stage, camera=camera, nosepiece=nosepiece)
        except (OptionError, DriverError, OSError, RuntimeError, ValueError) as error:
            print(f"{parser.prog}: {error}", file=sys.stderr)
            sys.exit(2)


if __name__ == "__main__":
    main()
