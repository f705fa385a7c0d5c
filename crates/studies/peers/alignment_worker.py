"""OpenCV as a worker for alignment.py: JSON lines in, JSON lines out.

Transforms are told as the target's pixel from the view's.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

Json = dict[str, Any]
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)


def repeat(request: Json, work: Callable[[], Any]) -> tuple[list[float], Any]:
    ms, value = [], None
    for _ in range(request["repetitions"]):
        start = time.perf_counter()
        value = work()
        ms.append((time.perf_counter() - start) * 1e3)
    return ms, value


def ecc(target: np.ndarray, view: np.ndarray, view_from_target: np.ndarray) -> np.ndarray:
    _, found = cv2.findTransformECC(target, view, view_from_target.astype(np.float32), cv2.MOTION_EUCLIDEAN, CRITERIA, None, 5)
    return found


def rescaled(matrix: np.ndarray, factor: float) -> np.ndarray:
    """The same between images `factor` times as large; their first pixels' centres do not coincide."""
    out = matrix.astype(np.float64).copy()
    middle = (factor - 1) / 2
    out[:, 2] = factor * matrix[:, 2] + middle - matrix[:, :2] @ np.array([middle, middle])
    return out


def inverse(matrix: np.ndarray) -> list[list[float]]:
    return cv2.invertAffineTransform(matrix.astype(np.float64)).tolist()


def track(request: Json, view: np.ndarray, target: np.ndarray) -> Json:
    """Phase correlation, then ECC: at full resolution, or as we do at a quarter, then at a quarter and half."""
    levels = [1] if request["recipe"] == "full" else [4, 2]

    def reduced(image: np.ndarray, every: int) -> np.ndarray:
        small = image if every == 1 else cv2.resize(image, None, fx=1 / every, fy=1 / every, interpolation=cv2.INTER_AREA)
        return small.astype(np.float32)

    references = {every: reduced(target, every) for every in levels}
    window = cv2.createHanningWindow(references[levels[0]].shape[::-1], cv2.CV_32F)

    def follow() -> np.ndarray | None:
        first = reduced(view, levels[0])
        (dx, dy), _ = cv2.phaseCorrelate(references[levels[0]], first, window)
        found = np.array([[1, 0, dx], [0, 1, dy]])
        try:
            for k, every in enumerate(levels):
                if k:
                    found = rescaled(found, levels[k - 1] / every)
                found = ecc(references[every], first if k == 0 else reduced(view, every), found)
        except cv2.error:
            return None
        return rescaled(found, levels[-1])

    ms, found = repeat(request, follow)
    return {"ms": ms, "answer": None if found is None else inverse(found)}


def correlate(request: Json, view: np.ndarray, target: np.ndarray) -> Json:
    """matchTemplate over the angles, both at the scale that we search at: the place and the angle of the best one."""
    every, ratio, step = request["every"], request["ratio"], request["step_deg"]
    reach = request.get("within_deg", 180.0)
    count = math.ceil(reach / step)
    angles = [request.get("around_deg", 0.0) + k * reach / max(count, 1) for k in range(-count, count + 1)]
    height, width = target.shape
    size = (round(width / ratio / every), round(height / ratio / every))

    def search() -> tuple[float, float, float, float]:
        small = cv2.resize(view, None, fx=1 / every, fy=1 / every, interpolation=cv2.INTER_AREA).astype(np.float32)
        template = cv2.resize(target, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        side = min(size) / math.sqrt(2)
        best = (-2.0, 0.0, 0.0, 0.0)
        for angle in angles:
            # What lies inside the template at every angle.
            turn = cv2.getRotationMatrix2D((size[0] / 2 - 0.5, size[1] / 2 - 0.5), angle, 1)
            turned = cv2.warpAffine(template, turn, size)
            x, y = (round((n - side) / 2) for n in size)
            cut = turned[y : y + round(side), x : x + round(side)]
            _, score, _, at = cv2.minMaxLoc(cv2.matchTemplate(small, cut, cv2.TM_CCOEFF_NORMED))
            if score > best[0]:
                best = (score, angle, (at[0] + side / 2) * every, (at[1] + side / 2) * every)
        return best

    ms, (_, angle, x, y) = repeat(request, search)
    a = math.radians(angle)
    linear = ratio * np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    offset = centre - linear @ np.array([x, y])
    return {"ms": ms, "answer": np.column_stack([linear, offset]).tolist()}


def step(request: Json, view: np.ndarray, target: np.ndarray) -> Json:
    sift = cv2.SIFT_create(nfeatures=3000, enable_precise_upscale=True)
    wanted, described = cv2.SIFT_create(nfeatures=8000, enable_precise_upscale=True).detectAndCompute(target, None)
    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def register() -> np.ndarray | None:
        seen, descriptors = sift.detectAndCompute(view, None)
        pairs = matcher.knnMatch(descriptors, described, k=2)
        good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < 0.8 * p[1].distance]
        a = np.float32([seen[m.queryIdx].pt for m in good])
        b = np.float32([wanted[m.trainIdx].pt for m in good])
        found, _ = cv2.estimateAffine2D(a, b, method=cv2.RANSAC, ransacReprojThreshold=3.0)
        return found

    ms, found = repeat(request, register)
    return {"ms": ms, "answer": None if found is None else found.tolist()}


def answer(request: Json) -> Json:
    if request["piece"] == "hello":
        return {"name": "OpenCV", "version": cv2.__version__}
    cv2.setNumThreads(request["threads"])
    view, target = (cv2.imread(request[key], cv2.IMREAD_GRAYSCALE) for key in ("view", "target"))
    return {"track": track, "correlate": correlate, "step": step}[request["piece"]](request, view, target)


for line in sys.stdin:
    try:
        reply = answer(json.loads(line))
    except Exception as error:  # whatever goes wrong is the driver's to tell
        reply = {"error": f"{type(error).__name__}: {error}"}
    print(json.dumps(reply), flush=True)
