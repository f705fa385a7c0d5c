"""Micro-Manager's simulated devices, with a specimen to look at."""

from __future__ import annotations

import argparse
import random
from contextlib import ExitStack
from typing import Any

from .devices import Objective
from .options import OptionError

# The camera says that it is simulated. It looks for the stages by these names of theirs.
CAMERA, XY, Z = "simulated camera", "XY", "Z"
DEMO_DEVICES = [(CAMERA, "DCam"), (XY, "DXYStage"), (Z, "DStage"), ("Objective", "DObjective")]

SAMPLE_OBJECTIVES = [
    Objective("10x", 10, 0.3, 1.0),
    Objective("20x", 20, 0.5, 0.5),
    Objective("40x", 40, 0.8, 0.25),
]
SAMPLE_HALF_WIDTH_UM = 1000.0
SAMPLE_MARGIN_UM = 300.0
SAMPLE_BEADS_PER_UM2 = 1 / 250
SAMPLE_SEED = 20240229


def _test_adapters_folder() -> str:
    try:
        import mm_test_adapters
    except ImportError:
        raise OptionError("the demos need Micro-Manager's simulated devices: pip install mm-test-adapters") from None
    return str(mm_test_adapters.device_adapter_path())


def _load(core: Any) -> None:
    core.setDeviceAdapterSearchPaths([_test_adapters_folder()])
    for label, device in DEMO_DEVICES:
        core.loadDevice(label, "DemoCamera", device)
    core.initializeAllDevices()
    core.setCameraDevice(CAMERA)
    core.setXYStageDevice(XY)
    core.setFocusDevice(Z)


def _set_defaults(options: argparse.Namespace, half_width_um: float, exposure_ms: tuple[float, float]) -> None:
    if options.x_um is None:
        options.x_um = (-half_width_um, half_width_um)
    if options.y_um is None:
        options.y_um = (-half_width_um, half_width_um)
    if options.z_um is None:
        options.z_um = (-100.0, 100.0)
    if options.exposure_ms is None:
        options.exposure_ms = exposure_ms
    if options.positive_z is None:
        options.positive_z = "closer"


def load_beads(options: argparse.Namespace) -> Any:
    """The demo camera in the only mode that looks at the stage. Its picture does not know the objective."""
    import pymmcore

    core = pymmcore.CMMCore()
    _load(core)
    core.setProperty(CAMERA, "Mode", "Fluorescent Beads")
    core.setExposure(20.0)
    _set_defaults(options, 10000.0, (1.0, 5000.0))
    if not options.objective:
        options.objective = [Objective("Objective-A", 10, 0.25, 1.0)]
    return core


def load_sample(options: argparse.Namespace, until_the_end: ExitStack) -> Any:
    """The simulated sample of pymmcore-plus: the demo devices, but with a picture that knows the objective, too."""
    try:
        from pymmcore_plus import CMMCorePlus
        from pymmcore_plus.experimental.simulate import RenderConfig, Sample
    except ImportError:
        raise OptionError(
            "this demo needs pymmcore-plus with its simulated sample: pip install pymmcore-plus"
        ) from None

    core = CMMCorePlus()
    _load(core)
    # The Sample takes brightness and noise from these properties.
    core.setProperty(CAMERA, "Photon Flux", 4000)
    core.setProperty(CAMERA, "Gain", 0)
    core.setExposure(50.0)
    for state, objective in enumerate(SAMPLE_OBJECTIVES):
        core.defineStateLabel("Objective", state, objective.id)
        core.definePixelSizeConfig(objective.id, "Objective", "Label", objective.id)
        core.setPixelSizeUm(objective.id, objective.um_per_px)
    # The Sample reads all properties, and with them the pixel size, from this cache.
    core.updateSystemStateCache()
    sample = Sample(_beads(), RenderConfig(backend="pil", base_blur=1.0, defocus_scale=0.2))
    until_the_end.enter_context(sample.patch(core))
    # A longer snap would keep stop waiting.
    _set_defaults(options, SAMPLE_HALF_WIDTH_UM, (1.0, 100.0))
    if not options.objective:
        options.objective = list(SAMPLE_OBJECTIVES)
    return core


def _beads() -> list[Any]:
    """The same beads every time, of sizes that suit every objective."""
    from pymmcore_plus.experimental.simulate import Point

    half_um = SAMPLE_HALF_WIDTH_UM + SAMPLE_MARGIN_UM
    chance = random.Random(SAMPLE_SEED)
    beads = []
    for _ in range(int((2 * half_um) ** 2 * SAMPLE_BEADS_PER_UM2)):
        x_um, y_um = chance.uniform(-half_um, half_um), chance.uniform(-half_um, half_um)
        # Few brightnesses, because the Sample draws one layer for each.
        beads.append(Point(x_um, y_um, chance.choice((60, 110, 170, 255)), chance.choice((0.5, 0.8, 1.2, 2.0, 3.0))))
    return beads
