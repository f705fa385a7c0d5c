#!/usr/bin/env python3
"""Times tracking, correlation and a servo step by features against OpenCV, in turn on one machine, and tells how far each is off.

Needs what speed.py needs. A row tells medians over the rounds of the best of each round, and the error of the target's centre, target pixels.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import sys
from pathlib import Path

import speed
from speed import Json, Worker

# Name, request, OpenCV's request beside it, threads, size, ratio, turn, off, slide, source pixels per target pixel.
SMALL, LARGE = (640, 480), (2448, 2048)
FAR = {"ratio": 1.0, "turn_deg": 1.5, "off": [42.0, -42.0]}
WIDE = {"ratio": 4.0, "turn_deg": 7.0, "off": [300.0, -200.0]}
ROWS: list[tuple[str, Json, Json, int, tuple[int, int], Json, float, int]] = [
    ("tracking, 60 px and 1.5 deg", {"piece": "track"}, {"recipe": "levels"}, 1, SMALL, FAR, 0.5, 100),
    ("tracking; OpenCV at full resolution", {"piece": "track"}, {"recipe": "full"}, 1, SMALL, FAR, 0.5, 20),
    ("correlation within 10 deg, 4:1", {"piece": "correlate", "within_deg": 10.0}, {"every": 2, "step_deg": 3.3}, 2, SMALL, WIDE, 1.0, 10),
    ("correlation at all angles, 4:1", {"piece": "correlate"}, {"every": 2, "step_deg": 3.3}, 2, SMALL, WIDE, 1.0, 5),
    ("correlation within 10 deg, 1:1", {"piece": "correlate", "within_deg": 10.0}, {"every": 4, "step_deg": 2.0}, 2, SMALL, FAR, 1.0, 10),
    ("correlation at all angles, 1:1", {"piece": "correlate"}, {"every": 4, "step_deg": 2.0}, 2, SMALL, FAR, 1.0, 5),
    ("step by features", {"piece": "step"}, {}, 2, SMALL, WIDE, 1.0, 10),
    ("step by features", {"piece": "step"}, {}, 2, LARGE, FAR, 0.5, 4),
    ("step by features, 4:1", {"piece": "step"}, {}, 2, LARGE, WIDE, 0.25, 4),
]


def centre_error(truth: list[list[float]], found: list[list[float]] | None, size: tuple[int, int]) -> float:
    """How far what truly lies in the target's centre is put from it."""
    if found is None:
        return math.inf
    (a, b, x), (c, d, y) = truth
    det = a * d - b * c
    middle = [(n - 1) / 2 for n in size]
    u, v = middle[0] - x, middle[1] - y
    p = ((d * u - b * v) / det, (a * v - c * u) / det)
    return math.dist(middle, [row[0] * p[0] + row[1] * p[1] + row[2] for row in found])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--slide", default="carcinoma_he.png", help="of the folder that SCOPESERVO_SPECIMENS names")
    given = parser.parse_args()
    folder = os.environ.get("SCOPESERVO_SPECIMENS")
    if not folder:
        print("set SCOPESERVO_SPECIMENS to the folder of slides", file=sys.stderr)
        return 2
    target = speed.target_folder()
    cache = target / "alignment"
    cache.mkdir(parents=True, exist_ok=True)
    speed.command(["cargo", "build", "--release", "-p", "scopeservo-studies", "--example", "alignment"], "building our side")
    python = speed.environment("opencv5", cache)
    ours = Worker([target / "release" / "examples" / "alignment"], cache / "ours.log")
    theirs = Worker([python, speed.HERE / "alignment_worker.py"], cache / "opencv.log")
    print(f"{speed.machine()}, commit {speed.commit()}, OpenCV {theirs.hello['version']}\n")
    print("| what | image | cores | ours ms | OpenCV ms | OpenCV over ours | ours off px | OpenCV off px |")
    print("|---|---|---|---|---|---|---|---|")
    try:
        for name, request, peer, threads, size, scene, pitch, repetitions in ROWS:
            pair: Json = {key: str(cache / f"{key}.pgm") for key in ("view", "target")}
            drawn = {"piece": "pair", "slide": str(Path(folder) / given.slide), "size": size, "pitch": pitch, **scene, **pair}
            truth = ours.ask(drawn)["answer"]
            asked = {**request, **pair, "ratio": scene["ratio"], "around_deg": 0.0, "threads": threads, "repetitions": repetitions}
            best: list[list[float]] = [[], []]
            off = [math.inf, math.inf]
            for turn in range(given.rounds + 1):
                for k in (0, 1) if turn % 2 else (1, 0):
                    reply = (ours, theirs)[k].ask(asked | (peer if k else {}))
                    # The first round warms up.
                    if turn:
                        best[k].append(min(reply["ms"]))
                    off[k] = centre_error(truth, reply["answer"], size)
            ms = [statistics.median(b) for b in best]
            cells = [name, f"{size[0]} x {size[1]}", threads, f"{ms[0]:.2f}", f"{ms[1]:.2f}", f"{ms[1] / ms[0]:.1f}", f"{off[0]:.3f}", f"{off[1]:.3f}"]
            print(f"| {' | '.join(map(str, cells))} |", flush=True)
    finally:
        ours.stop()
        theirs.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
