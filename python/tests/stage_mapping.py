"""OpenFlexure's camera-stage-mapping, driven over the driver protocol: prints its matrices as JSON.

    python stage_mapping.py HOST PORT OBJECTIVE REPEATS

Its matrix takes (row, column) displacements of the image to (x, y) of the stage, in um per pixel.
"""

from __future__ import annotations

import json
import logging
import socket
import sys
import time

import numpy as np
from camera_stage_mapping.camera_stage_calibration_1d import (
    calibrate_backlash_1d,
    image_to_stage_displacement_from_1d,
)
from camera_stage_mapping.camera_stage_tracker import Tracker
from support import Client


class Microscope:
    """What camera-stage-mapping asks for: pictures, places and moves."""

    def __init__(self, host: str, port: int) -> None:
        stream = socket.create_connection((host, port))
        self.client = Client(stream.recv, stream.sendall)
        self.client.do("hello", protocol=1, client="camera-stage-mapping")

    def picture(self) -> np.ndarray:
        frame = self.client.do("grab")
        shape = (frame["height_px"], frame["width_px"], frame["channels"])
        return np.frombuffer(frame["samples"], np.uint8).reshape(shape).mean(axis=2)

    def place(self) -> np.ndarray:
        at = self.client.do("position")
        return np.array([at["x_um"], at["y_um"], at["z_um"]])

    def move(self, to: np.ndarray) -> None:
        self.client.do("move", x_um=float(to[0]), y_um=float(to[1]))
        self.wait("motion")

    def wait(self, call: str) -> None:
        while self.client.do(call)["motion"] == "moving":
            time.sleep(0.005)

    def select(self, objective: str) -> None:
        if self.client.do("objective")["objective"] != objective:
            self.client.do("change", objective=objective)
            self.wait("objective")


def mapping(microscope: Microscope) -> list[list[float]]:
    start = microscope.place()
    along = []
    for direction in ([1, 0, 0], [0, 1, 0]):
        microscope.move(start)
        tracker = Tracker(microscope.picture, microscope.place, settle=lambda: None)
        along.append(calibrate_backlash_1d(tracker, microscope.move, direction=np.array(direction)))
    microscope.move(start)
    return image_to_stage_displacement_from_1d(along)["image_to_stage_displacement"].tolist()


def main() -> None:
    host, port, objective, repeats = sys.argv[1], int(sys.argv[2]), sys.argv[3], int(sys.argv[4])
    logging.basicConfig(level=logging.WARNING)
    microscope = Microscope(host, port)
    microscope.select(objective)
    print(json.dumps([mapping(microscope) for _ in range(repeats)]))
    microscope.client.do("bye")


if __name__ == "__main__":
    main()
