"""OpenCV as a worker: JSON lines in, JSON lines out, as speed.py asks."""

import json
import sys
import time
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np

Request = dict[str, object]

# Above any difference of Gaussians, and small enough that OpenCV's threshold, a whole number, does not overflow: with 1e9 it
# lets every pixel pass on to the next test.
NOTHING_PASSES = 50.0


@cache
def image(path: str) -> np.ndarray:
    read = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    if read is None:
        raise ValueError(f"{path} cannot be read")
    return read


@cache
def sift(most: int, precise: bool, contrast: float = 0.04) -> cv2.SIFT:
    return cv2.SIFT_create(nfeatures=most, contrastThreshold=contrast, enable_precise_upscale=precise)


@cache
def described(path: str, most: int, precise: bool) -> tuple[np.ndarray, np.ndarray]:
    """Places and descriptors, the strongest first."""
    keypoints, descriptors = sift(most, precise).detectAndCompute(image(path), None)
    if descriptors is None:
        return np.empty((0, 2), np.float32), np.empty((0, 128), np.float32)
    order = np.argsort([-k.response for k in keypoints], kind="stable")
    return cv2.KeyPoint_convert(keypoints)[order], descriptors[order]


def repeat(request: Request, work: Callable[[], object]) -> tuple[list[float], object]:
    ms, value = [], None
    for _ in range(request["repetitions"]):
        start = time.perf_counter()
        value = work()
        ms.append((time.perf_counter() - start) * 1e3)
    return ms, value


@cache
def keypoints_of(path: str, most: int, many: int, precise: bool) -> list[cv2.KeyPoint]:
    """At most `many` of the keypoints, regularly chosen."""
    keypoints = sift(most, precise).detect(image(path), None)
    return list(keypoints)[:: max(1, -(-len(keypoints) // many))]


def compute(request: Request, pixels: np.ndarray, keypoints: list[cv2.KeyPoint], engine: cv2.SIFT) -> dict[str, object]:
    """Milliseconds to describe every keypoint once, without the pyramid: more of the same keypoints, less each of them once."""
    times = max(2, -(-request["many"] // max(len(keypoints), 1)))
    once, _ = repeat(request, lambda: engine.compute(pixels, keypoints))
    many, _ = repeat(request, lambda: engine.compute(pixels, keypoints * times))
    return {"ms": [(min(many) - min(once)) / (times - 1)], "count": len(keypoints)}


def affine(view: np.ndarray, target: tuple[np.ndarray, np.ndarray], engine: cv2.SIFT, matcher: cv2.DescriptorMatcher):
    keypoints, descriptors = engine.detectAndCompute(view, None)
    pairs = [] if descriptors is None else matcher.knnMatch(descriptors, target[1], k=2)
    good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < 0.8 * p[1].distance]
    if len(good) < 3:
        return None, 0
    a = np.float32([keypoints[m.queryIdx].pt for m in good])
    b = target[0][[m.trainIdx for m in good]]
    matrix, inliers = cv2.estimateAffine2D(a, b, method=cv2.RANSAC, ransacReprojThreshold=3.0)
    return (None, 0) if matrix is None else (matrix.tolist(), int(inliers.sum()))


def nearest(request: Request) -> dict[str, object]:
    """How many queries OpenCV answers otherwise than the worker that wrote the files, on the same descriptors."""
    path = request["write"]
    view, target = (np.fromfile(f"{path}.{end}", np.uint8).reshape(-1, 128).astype(np.float32) for end in ("view", "target"))
    theirs = np.fromfile(f"{path}.nearest", "<u4").reshape(-1, 4).astype(np.int64)
    found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(view, target, k=2)
    ours = np.array([[m.queryIdx, m.trainIdx, m.distance**2, n.distance**2] for m, n in found]).round().astype(np.int64)
    if len(ours) != len(theirs):
        return {"count": len(ours), "differ": abs(len(ours) - len(theirs))}
    same_distance = (np.abs(ours[:, 2:] - theirs[:, 2:]) <= 1).all(axis=1)
    # Of equal distances either may be called the nearest.
    same_place = (ours[:, 1] == theirs[:, 1]) | (np.abs(ours[:, 3] - ours[:, 2]) <= 1)
    return {"count": len(ours), "differ": int((~(same_distance & same_place)).sum())}


def answer(request: Request) -> dict[str, object]:
    piece = request["piece"]
    if piece == "hello":
        return {"name": "OpenCV", "version": cv2.__version__}
    if piece == "nearest":
        return nearest(request)
    cv2.setNumThreads(request["threads"])
    precise = bool(request.get("precise"))
    most = request.get("most") or 0
    if piece in ("match", "flann"):
        view, target = (described(request[key], 0, precise)[1][: request["number"]] for key in ("image", "target"))
        matcher = cv2.BFMatcher(cv2.NORM_L2) if piece == "match" else cv2.FlannBasedMatcher()
        ms, pairs = repeat(request, lambda: matcher.knnMatch(view, target, k=2))
        return {"ms": ms, "count": len(pairs), "features": [len(view), len(target)]}
    pixels = image(request["image"])
    if piece == "affine":
        target = described(request["target"], most, precise)
        engine, matcher = sift(most, precise), cv2.BFMatcher(cv2.NORM_L2)
        ms, (matrix, inliers) = repeat(request, lambda: affine(pixels, target, engine, matcher))
        return {"ms": ms, "count": inliers, "answer": matrix}
    if piece == "compute":
        return compute(request, pixels, keypoints_of(request["image"], most, request["many"], precise), sift(most, precise))
    if piece == "describe":
        engine = sift(most, precise)
        ms, (keypoints, _) = repeat(request, lambda: engine.detectAndCompute(pixels, None))
    else:
        engine = sift(0, precise, NOTHING_PASSES) if piece == "scan" else sift(most, precise)
        ms, keypoints = repeat(request, lambda: engine.detect(pixels, None))
    return {"ms": ms, "count": len(keypoints)}


for line in sys.stdin:
    try:
        reply = answer(json.loads(line))
    except Exception as error:  # whatever goes wrong is the driver's to tell
        reply = {"error": f"{type(error).__name__}: {error}"}
    print(json.dumps(reply), flush=True)
