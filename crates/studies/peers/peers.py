"""OpenCV's SIFT, ORB, AKAZE and BRISK on the pairs of the accuracy study.

See docs/sift-accuracy.md. Asks the renderer (`accuracy serve`) for scenes and appends one line of
JSON per pair and method to a file. A rerun skips what is there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8]
Matrix = NDArray[np.float64]

FEATURES = 2000
RATIO = 0.8
RANSAC_PX = 3.0
ZOOMS = (1, 2, 4)
CONDITIONS = 8


@dataclass(frozen=True)
class Features:
    """The strongest features of a frame, and the time it took."""

    points: NDArray[np.float32]
    descriptors: NDArray[Any] | None
    ms: float


@dataclass(frozen=True)
class Answer:
    """What a method says of a pair."""

    target_from_view: Matrix | None
    matches: int
    inliers: int
    ms: float


@dataclass(frozen=True)
class Method:
    """A detector with its descriptor, and the norm that compares two descriptors."""

    detector: cv2.Feature2D
    norm: int
    # BRISK finds far more corners than are kept: describing only those gives the same, sooner.
    cut_before_describing: bool = False

    def features(self, frame: Frame) -> Features:
        start = time.perf_counter()
        if self.cut_before_describing:
            best = strongest(self.detector.detect(frame, None))
            keypoints, descriptors = self.detector.compute(frame, best)
        else:
            keypoints, descriptors = self.detector.detectAndCompute(frame, None)
        if len(keypoints) > FEATURES:
            order = np.argsort([-k.response for k in keypoints], kind="stable")[:FEATURES]
            keypoints = [keypoints[i] for i in order]
            descriptors = descriptors[order]
        points = np.array([k.pt for k in keypoints], np.float32).reshape(-1, 2)
        return Features(points, descriptors, 1e3 * (time.perf_counter() - start))


def strongest(keypoints: Sequence[cv2.KeyPoint]) -> list[cv2.KeyPoint]:
    return sorted(keypoints, key=lambda k: -k.response)[:FEATURES]


def methods() -> dict[str, Method]:
    """The peers, by the names of the tables."""
    return {
        "opencv_sift": Method(cv2.SIFT.create(nfeatures=FEATURES), cv2.NORM_L2),
        "opencv_sift_precise": Method(
            cv2.SIFT.create(nfeatures=FEATURES, enable_precise_upscale=True), cv2.NORM_L2
        ),
        "opencv_orb": Method(cv2.ORB.create(nfeatures=FEATURES), cv2.NORM_HAMMING),
        "opencv_akaze": Method(cv2.AKAZE.create(), cv2.NORM_HAMMING),
        "opencv_brisk": Method(cv2.BRISK.create(), cv2.NORM_HAMMING, cut_before_describing=True),
    }


def register(view: Features, target: Features, norm: int) -> Answer:
    """Brute force, ratio and mutual test, RANSAC for an affine transform."""
    start = time.perf_counter()

    def answer(transform: Matrix | None, matches: int, inliers: int) -> Answer:
        return Answer(transform, matches, inliers, 1e3 * (time.perf_counter() - start))

    if view.descriptors is None or target.descriptors is None or len(target.points) < 2:
        return answer(None, 0, 0)
    matcher = cv2.BFMatcher(norm)
    distinct = [
        best
        for best, second in matcher.knnMatch(view.descriptors, target.descriptors, k=2)
        if best.distance < RATIO * second.distance
    ]
    if len(distinct) < 3:
        return answer(None, len(distinct), 0)
    back = matcher.match(target.descriptors[[m.trainIdx for m in distinct]], view.descriptors)
    good = [m for m, b in zip(distinct, back, strict=True) if b.trainIdx == m.queryIdx]
    if len(good) < 3:
        return answer(None, len(good), 0)
    transform, inliers = cv2.estimateAffine2D(
        view.points[[m.queryIdx for m in good]],
        target.points[[m.trainIdx for m in good]],
        method=cv2.RANSAC,
        ransacReprojThreshold=RANSAC_PX,
        maxIters=10000,
        confidence=0.999,
    )
    if transform is None or not np.isfinite(transform).all():
        return answer(None, len(good), 0)
    return answer(transform.astype(np.float64), len(good), int(inliers.sum()))


def corner_error_px(estimate: Matrix, truth: Matrix, size: tuple[int, int]) -> float:
    """Mean distance, in target pixels, of the target's corners from where the estimate puts what is
    truly there."""
    w, h = size[0] - 1.0, size[1] - 1.0
    corners = np.array([[0, 0], [w, 0], [0, h], [w, h]])
    in_view = np.linalg.solve(truth[:, :2], (corners - truth[:, 2]).T)
    put = (estimate[:, :2] @ in_view).T + estimate[:, 2]
    return float(np.linalg.norm(put - corners, axis=1).mean())


@dataclass(frozen=True)
class Scene:
    """A target and its views, by pair."""

    truth: Matrix
    target: Frame
    views: dict[str, tuple[str, Frame]]


class Renderer:
    """The program that renders scenes, one thread of it."""

    def __init__(self, program: Path, seed: int) -> None:
        command = [str(program.resolve()), "--seed", str(seed), "--threads", "1", "serve"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        hello = self._line()
        self.set: str = hello["set"]
        width, height = hello["size"]
        self.size: tuple[int, int] = (width, height)

    def _out(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout

    def _line(self) -> dict[str, Any]:
        line = self._out().readline()
        if not line:
            sys.exit("the renderer stopped")
        value: dict[str, Any] = json.loads(line)
        return value

    def _frame(self) -> Frame:
        width, height = self.size
        data = self._out().read(width * height)
        return np.frombuffer(data, np.uint8).reshape(height, width)

    def scene(self, name: str) -> Scene:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{name}\n".encode())
        self.process.stdin.flush()
        header = self._line()
        target = self._frame()
        views = {p["pair"]: (p["frames"], self._frame()) for p in header["pairs"]}
        return Scene(np.array(header["target_from_view"]), target, views)


def results(
    scene: Scene, size: tuple[int, int], wanted: Callable[[str, str], bool]
) -> Iterator[dict[str, Any]]:
    """A line for each wanted pair and method of a scene; each method describes the target once."""
    for name, method in methods().items():
        target: Features | None = None
        for pair, (frames, frame) in scene.views.items():
            if not wanted(pair, name):
                continue
            target = target or method.features(scene.target)
            view = method.features(frame)
            answer = register(view, target, method.norm)
            found = answer.target_from_view
            yield {
                "pair": pair,
                "method": name,
                "engine": f"opencv {cv2.__version__}",
                "frames": frames,
                "found": found is not None,
                "error_px": None if found is None else corner_error_px(found, scene.truth, size),
                "inliers": answer.inliers,
                "matches": answer.matches,
                "features": [len(view.points), len(target.points)],
                "features_ms": round(view.ms, 2),
                "register_ms": round(answer.ms, 2),
            }


def done(file: Path, renderer_set: str) -> set[tuple[str, str]]:
    """The pairs and methods that a file has; a last line that was cut is not one."""
    there: set[tuple[str, str]] = set()
    if not file.exists():
        return there
    for line in file.read_text().splitlines():
        try:
            row = json.loads(line)
        except ValueError:
            continue
        if row["set"] == renderer_set and row["engine"] == f"opencv {cv2.__version__}":
            there.add((row["pair"], row["method"]))
    return there


def scene_of(pair: str) -> str:
    zoom, rest = pair.split("-", 1)
    return f"{zoom}-{rest.rsplit('-', 1)[1]}"


def run(renderer: Renderer, file: Path, per_cell: int, part: tuple[int, int]) -> None:
    """All scenes of a part of the study: those whose number is `part[0]` modulo `part[1]`."""
    there = done(file, renderer.set)
    complete: dict[str, int] = {}
    for pair, _ in there:
        complete[scene_of(pair)] = complete.get(scene_of(pair), 0) + 1
    scenes = [f"{zoom}-{k:03}" for k in range(per_cell) for zoom in ZOOMS]
    scenes = scenes[part[0] :: part[1]]
    each = CONDITIONS * len(methods())
    scenes = [s for s in scenes if complete.get(s, 0) < each]
    start = time.monotonic()
    with file.open("a") as out:
        if out.tell() and not file.read_bytes().endswith(b"\n"):
            out.write("\n")
        for i, name in enumerate(scenes):
            scene = renderer.scene(name)
            for row in results(scene, renderer.size, lambda p, m: (p, m) not in there):
                out.write(json.dumps({"set": renderer.set, **row}) + "\n")
                out.flush()
            minutes = (time.monotonic() - start) / 60
            left = minutes / (i + 1) * (len(scenes) - i - 1)
            print(f"{name}: {i + 1} of {len(scenes)} scenes, {left:.0f} minutes left", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--renderer", type=Path, default=Path("target/release/examples/accuracy"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="file to append to")
    parser.add_argument("--per-cell", type=int, default=150, help="pairs of each cell")
    parser.add_argument("--part", default="1/1", help="I/N: the I-th of N shares of the scenes")
    parser.add_argument("--pair", help="print the answers for one pair, such as 4-blur-017")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    renderer = Renderer(args.renderer, args.seed)
    if args.pair:
        scene = renderer.scene(scene_of(args.pair))
        for row in results(scene, renderer.size, lambda pair, _: pair == args.pair):
            print(json.dumps({"set": renderer.set, **row}))
    elif args.out:
        share, shares = (int(n) for n in args.part.split("/"))
        run(renderer, args.out, args.per_cell, (share - 1, shares))
    else:
        parser.error("name a file with --out, or a pair with --pair")


if __name__ == "__main__":
    main()
