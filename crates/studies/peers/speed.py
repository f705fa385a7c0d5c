#!/usr/bin/env python3
"""Times our SIFT against its peers, piece by piece, in turn on one machine, and checks the answers first.

Needs cargo, CPython 3.11 or later with venv, and the network once, for the peers. Everything it makes lies in the target folder.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import datetime
import json
import math
import os
import platform
import shlex
import shutil
import signal
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
Json = dict[str, Any]

EXAMPLES = """examples:
  python3 crates/studies/peers/speed.py --write docs/sift-speed.md
  python3 crates/studies/peers/speed.py --quick
  python3 crates/studies/peers/speed.py --sizes 640x480 --only match --only affine
  python3 crates/studies/peers/speed.py --images my_photos --no-extra-peers --rounds 3

slides come from the folder that SCOPESERVO_SPECIMENS names, unless --images names another one."""

SIZES = [(640, 480), (1280, 1024), (2448, 2048)]
# Share of blocks with structure: name, wanted share, slide.
KINDS = [("dense", 1.0, "carcinoma_he.png"), ("sparse", 0.3, "embryo_section.png")]
BEST = 2000
# What the slowest side takes for its repetitions of one measurement in a round, about; all have as many.
ROUND_MS = 700
# Repetitions until it is the next side's turn: on a shared machine half a second may be slower than the one before, for whoever it meets.
TURN = 2
# A difference of two times below this share of the first is noise.
LEAST_SHARE = 0.05
# An OpenCV variant this much slower than the fastest in every piece is not timed further.
VARIANT_SLACK = 1.05
# What a check lets pass: our count over theirs, and the mean error of the four corners in pixels.
COUNT_RATIO = (0.67, 2.0)
CORNER_PX = 1.5


class Problem(Exception):
    """Said in one sentence; the run ends."""


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# ---------------------------------------------------------------------------------------------------------------- workers


class Worker:
    """A process that answers one JSON line with one JSON line."""

    def __init__(self, command: list[str | Path], log: Path):
        self.log = log
        with log.open("wb") as errors:
            # In a session of its own Ctrl-C does not reach it: we stop it. It stops itself when its input ends.
            self.process = subprocess.Popen(
                [str(c) for c in command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True
            )
        try:
            self.hello = self.ask({"piece": "hello"})
        except BaseException:
            self.stop()
            raise

    def ask(self, request: Json) -> Json:
        assert self.process.stdin and self.process.stdout
        try:
            print(json.dumps(request), file=self.process.stdin, flush=True)
            line = self.process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            last = self.log.read_text(errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
            raise Problem(f"a worker ended early ({' '.join(map(str, self.process.args))}): {last[0]}")
        reply = json.loads(line)
        if "error" in reply:
            raise Problem(f"{request['piece']} failed in {self.process.args[-1]}: {reply['error']}")
        return reply

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()


@dataclasses.dataclass
class Side:
    """A worker with settings: one column of the comparison."""

    name: str
    worker: Worker
    settings: Json


# ------------------------------------------------------------------------------------------------------------------ pieces


@dataclasses.dataclass
class Piece:
    """A row: one measurement, or the difference of two, or that difference per feature in microseconds."""

    name: str
    title: str
    measure: str
    minus: str | None = None
    each: bool = False
    # What OpenCV is asked, where it is something else.
    peer: str | None = None
    fast: bool = False

    @property
    def group(self) -> str:
        return self.name.split("-")[0]

    def measures(self) -> list[str]:
        return [m for m in (self.measure, self.minus, self.peer) if m]


PIECES = [
    Piece("scan", "pyramid + scan", "scan"),
    Piece("refine-best", f"refine + orient, {BEST} best", "detect_best", minus="scan"),
    Piece("refine-all", "refine + orient, all", "detect_all", minus="scan"),
    Piece("describe-best", f"describe, us per keypoint, {BEST} best", "compute_best", each=True),
    Piece("describe-all", "describe, us per keypoint, all", "compute_all", each=True),
    Piece("whole-best", f"detect + describe, {BEST} best", "describe_best"),
    Piece("whole-all", "detect + describe, all", "describe_all"),
    Piece("whole-fast", f"detect + describe, {BEST} best, from octave 0 (1)", "describe_fast", peer="describe_best", fast=True),
    Piece("affine", "image -> affine, target cached", "affine"),
    Piece("affine-fast", "image -> affine, target cached, from octave 0 (1)", "affine_fast", peer="affine", fast=True),
    Piece("match-500", "match 500 x 500 (2)", "match_500"),
    Piece("match-2000", "match 2000 x 2000 (2)", "match_2000"),
    Piece("match-5000", "match 5000 x 5000 (2)", "match_5000"),
    Piece("flann-2000", "match 2000 x 2000, FLANN (3)", "match_2000", peer="flann_2000"),
    Piece("flann-5000", "match 5000 x 5000, FLANN (3)", "match_5000", peer="flann_5000"),
]

# Pieces of two sets of features, without an image.
PAIRS = ("match", "flann")

REQUESTS: dict[str, Json] = {
    "scan": {"piece": "scan"},
    "detect_best": {"piece": "detect", "most": BEST},
    "detect_all": {"piece": "detect"},
    "describe_best": {"piece": "describe", "most": BEST},
    "describe_all": {"piece": "describe"},
    "describe_fast": {"piece": "describe", "most": BEST, "first_octave": 0},
    "compute_best": {"piece": "compute", "most": BEST},
    "compute_all": {"piece": "compute"},
    "affine": {"piece": "affine", "most": BEST},
    "affine_fast": {"piece": "affine", "most": BEST, "first_octave": 0},
    **{f"{kind}_{n}": {"piece": kind, "number": n} for kind in ("match", "flann") for n in (500, 2000, 5000)},
}


def bounds(piece: Piece, width: int, threads: int, level: str) -> tuple[float, list[float]] | None:
    """Must and aims, as OpenCV's time over ours."""
    if piece.name == "scan":
        return {640: (2.5, [4]), 1280: (5, [8]), 2448: (6, [9])}.get(width)
    if piece.group == "describe":
        return 6, [10, 15]
    if piece.name == "match-2000":
        return {"avx512": (20, [28]), "avx2": (10, [15])}.get(level)
    if piece.name == "whole-best":
        return 7, [11]
    if piece.name == "affine":
        return {1: (8, [12]), 2: (10, [15])}.get(threads)
    return None


# ------------------------------------------------------------------------------------------------------------ measurements


@dataclasses.dataclass
class Image:
    name: str
    view: Path
    target: Path
    size: tuple[int, int]
    truth: list[list[float]]


# (side, measure) -> the best milliseconds of each round, the first of which is the warm-up.
Times = dict[tuple[str, str], list[float]]


@dataclasses.dataclass
class Row:
    piece: Piece
    image: str
    size: tuple[int, int]
    threads: int
    ours: float | None
    theirs: float | None
    peer: str
    counts: tuple[int, int]
    ratio: float | None
    spread: tuple[float, float] | None
    bounds: tuple[float, list[float]] | None
    failed: str | None

    def verdict(self) -> str:
        if self.failed or not self.bounds or self.ratio is None:
            return ""
        must, aims = self.bounds
        words = ["must met" if self.ratio >= must else "must MISSED"]
        words += [f"aim {aim:g} {'met' if self.ratio >= aim else 'missed'}" for aim in aims]
        return ", ".join(words)


def corner_error(truth: list[list[float]], found: list[list[float]] | None, size: tuple[int, int]) -> float:
    """Mean distance in the target between where the truth and the answer put the view's corners."""
    if found is None:
        return math.inf

    def apply(m: list[list[float]], x: float, y: float) -> list[float]:
        return [row[0] * x + row[1] * y + row[2] for row in m]

    w, h = size[0] - 1, size[1] - 1
    return statistics.mean(math.dist(apply(truth, x, y), apply(found, x, y)) for x, y in [(0, 0), (w, 0), (0, h), (w, h)])


class Comparison:
    def __init__(self, ours: Side, peers: list[Side], rounds: int, most_repetitions: int, cache: Path):
        self.ours, self.peers, self.rounds, self.most_repetitions, self.cache = ours, peers, rounds, most_repetitions, cache
        self.level: str = ours.worker.hello["level"]
        self.rows: list[Row] = []
        self.failures: list[str] = []
        self.checks: list[str] = []

    def ask(self, side: Side, measure: str, image: Image, threads: int, repetitions: int) -> Json:
        request = {"image": str(image.view), "target": str(image.target), "threads": threads, "repetitions": repetitions}
        if REQUESTS[measure]["piece"] == "compute":
            # Describing shall take no less than the scale space that is taken from it.
            request["many"] = max(20_000, image.size[0] * image.size[1] // 80)
        return side.worker.ask(request | REQUESTS[measure] | side.settings)

    def plan(self, pieces: list[Piece]) -> list[tuple[Side, str]]:
        """Who does what, the sides of one measure next to each other."""
        # How the image is doubled does not matter to a matcher.
        peers = [s for s in self.peers if not s.settings["precise"]] if pieces[0].group in PAIRS else self.peers

        def asked(side: Side) -> set[str | None]:
            return {m for p in pieces for m in ((p.measure if side is self.ours else p.peer or p.measure), p.minus)}

        return [(s, m) for m in REQUESTS for s in [self.ours, *peers] if m in asked(s)]

    def run(self, image: Image, threads: int, pieces: list[Piece]) -> None:
        """One image on so many threads: warm-up with the checks, then the rounds."""
        label = f"{image.name} {image.size[0]}x{image.size[1]}, {threads} thread{'s' * (threads > 1)}"
        say(f"{label}: warm-up and checks")
        # What is found is checked even when only a part of the finding is timed.
        whole = [p for p in PIECES if p.name == "whole-best" and pieces[0].group not in PAIRS]
        plan = self.plan([*pieces, *whole])
        times: Times = collections.defaultdict(list)
        first: dict[tuple[str, str], Json] = {}
        for side, measure in plan:
            first[side.name, measure] = reply = self.ask(side, measure, image, threads, 1)
            times[side.name, measure].append(min(reply["ms"]))
        failed = self.check(label, image, first)
        kept = self.fastest(times)
        plan = [(s, m) for s, m in self.plan(pieces) if s is self.ours or s.name in kept]
        for number in range(1, self.rounds + 1):
            say(f"{label}: round {number} of {self.rounds}")
            for measure in REQUESTS:
                sides = [s for s, m in plan if m == measure]
                if not sides:
                    continue
                slowest = max(times[s.name, measure][0] for s in sides)
                repetitions = min(math.ceil(ROUND_MS / slowest), self.most_repetitions)
                if measure.startswith("compute"):
                    # That is a mean over many keypoints already.
                    repetitions = min(repetitions, 2)
                best = dict.fromkeys((s.name for s in sides), math.inf)
                for turn, done in enumerate(range(0, repetitions, TURN), start=number):
                    begin = turn % len(sides)
                    for side in sides[begin:] + sides[:begin]:
                        reply = self.ask(side, measure, image, threads, min(TURN, repetitions - done))
                        best[side.name] = min(best[side.name], *reply["ms"])
                for name, ms in best.items():
                    times[name, measure].append(ms)
        counts = {key: reply["count"] for key, reply in first.items()}
        self.rows += [self.row(p, image, threads, times, counts, kept, failed) for p in pieces]

    def fastest(self, times: Times) -> set[str]:
        """The variants of OpenCV that are, within a little, the fastest in some measurement."""
        kept = set()
        for measure in {m for _, m in times}:
            by_side = {s: t[0] for (s, m), t in times.items() if m == measure and s != self.ours.name}
            least = min(by_side.values(), default=0)
            kept |= {s for s, ms in by_side.items() if ms <= VARIANT_SLACK * least}
        return kept

    def check(self, label: str, image: Image, first: dict[tuple[str, str], Json]) -> dict[str, str]:
        """What is wrong with the answers, by group of pieces."""
        failed: dict[str, str] = {}

        def note(good: bool, text: str, groups: list[str]) -> None:
            self.checks.append(f"{label}: {text}{'' if good else ' FAILED'}")
            if not good:
                say(f"check failed: {label}: {text}")
                self.failures.append(f"{label}: {text}")
                failed.update(dict.fromkeys(groups, text))

        scans = [first[key]["count"] for key in first if key[1] == "scan"]
        if any(scans):
            note(False, f"a scan that is to find nothing found {max(scans)}", ["scan", "refine"])
        for measure in ("detect_all", "describe_all", "detect_best", "describe_best"):
            if (self.ours.name, measure) not in first:
                continue
            ours = first[self.ours.name, measure]["count"]
            theirs = [first[s.name, measure]["count"] for s in self.peers if (s.name, measure) in first]
            if not theirs:
                continue
            good = all(t and COUNT_RATIO[0] <= ours / t <= COUNT_RATIO[1] for t in theirs)
            if measure.startswith("describe") or not good:
                numbers = "/".join(map(str, sorted(set(theirs))))
                note(good, f"{measure.replace('_', ' ')}: {ours} features of ours, {numbers} of OpenCV", ["scan", "refine", "describe", "whole"])
        for (side, measure), reply in first.items():
            if measure.startswith("affine"):
                error = corner_error(image.truth, reply["answer"], image.size)
                fast = " from octave 0" if measure == "affine_fast" else ""
                note(error <= CORNER_PX, f"corner error of {side}{fast} {error:.3f} px, {reply['count']} inliers", ["affine"])
        for n in (500, 2000, 5000):
            if (self.ours.name, f"match_{n}") in first:
                request = {"piece": "nearest", "number": n, "write": str(self.cache / "nearest"), "image": str(image.view), "target": str(image.target)}
                ours = self.ours.worker.ask(request)["count"]
                reply = self.peers[0].worker.ask(request)
                text = f"nearest two of {ours} on our descriptors: {reply['differ']} differ from {self.peers[0].name}"
                note(reply["differ"] == 0 and ours == reply["count"], text, list(PAIRS))
        return failed

    def row(
        self, piece: Piece, image: Image, threads: int, times: Times, counts: dict[tuple[str, str], int], kept: set[str], failed: dict[str, str]
    ) -> Row:
        def value(side: str, measure: str, number: int) -> float | None:
            rest = whole = times[side, measure][number]
            if piece.minus:
                rest -= times[side, piece.minus][number]
            if rest < LEAST_SHARE * whole:
                return None
            return 1e3 * rest / max(counts[side, measure], 1) if piece.each else rest

        def rounds(side: str, measure: str) -> list[float | None]:
            return [value(side, measure, i) for i in range(1, self.rounds + 1)]

        def median(values: list[float | None]) -> float | None:
            """None unless every round says something."""
            known = [v for v in values if v is not None]
            return statistics.median(known) if len(known) == len(values) else None

        asked = piece.peer or piece.measure
        mine = rounds(self.ours.name, piece.measure)
        candidates = {s: rounds(s, asked) for s in sorted(kept) if (s, asked) in times}
        peer = min(candidates, key=lambda s: median(candidates[s]) or math.inf)
        ours, theirs = median(mine), median(candidates[peer])
        fault = failed.get(piece.group)
        known = ours and theirs and not fault
        ratios = [b / a for a, b in zip(mine, candidates[peer]) if a and b]
        return Row(
            piece, image.name, image.size, threads, ours, theirs, peer,
            (counts[self.ours.name, piece.measure], counts[peer, asked]),
            statistics.median(ratios) if known else None,
            (min(ratios), max(ratios)) if known else None,
            bounds(piece, image.size[0], threads, self.level), fault,
        )  # fmt: skip


# --------------------------------------------------------------------------------------------------------- what is needed


def command(arguments: list[str | Path], what: str, cwd: Path = ROOT) -> str:
    """Runs a command to its end and gives its output."""
    try:
        done = subprocess.run([str(a) for a in arguments], cwd=cwd, capture_output=True, text=True)
    except FileNotFoundError:
        raise Problem(f"{what} needs {arguments[0]}, which is not installed.") from None
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no reason given"]
        raise Problem(f"{what} failed: {last[0]}")
    return done.stdout


def environment(name: str, cache: Path) -> Path:
    """The interpreter of an environment with the pinned packages, made when it is not there."""
    wanted = (HERE / f"requirements-{name}.txt").read_text()
    folder = cache / "env" / name
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp = folder / "installed.txt"
    if python.exists() and stamp.exists() and stamp.read_text() == wanted:
        return python
    say(f"making a Python environment with {', '.join(wanted.split())}")
    shutil.rmtree(folder, ignore_errors=True)
    command([sys.executable, "-m", "venv", folder], "making a Python environment")
    command(
        [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", HERE / f"requirements-{name}.txt"],
        f"installing {name} (this needs the network once)",
    )
    stamp.write_text(wanted)
    return python


def target_folder() -> Path:
    metadata = command(["cargo", "metadata", "--no-deps", "--format-version", "1", "--offline"], "finding the target folder")
    return Path(json.loads(metadata)["target_directory"])


def build(target: Path) -> Path:
    say("building our worker")
    command(["cargo", "build", "--release", "-p", "scopeservo-studies", "--example", "speed"], "building our worker")
    return target / "release" / "examples" / ("speed.exe" if os.name == "nt" else "speed")


def build_sift_features(cache: Path) -> Path:
    say("building the sift-features crate")
    target = cache / "sift_features"
    manifest = HERE / "sift_features" / "Cargo.toml"
    command(["cargo", "build", "--release", "--locked", "--manifest-path", manifest, "--target-dir", target], "building sift-features")
    return target / "release" / ("sift-features-peer.exe" if os.name == "nt" else "sift-features-peer")


def images(worker: Worker, folder: Path | None, sizes: list[tuple[int, int]], quick: bool, cache: Path) -> list[Image]:
    """Crops of the known slides, or every picture of a folder as it is, each with a turned and shifted target."""
    if folder is not None:
        if not folder.is_dir():
            raise Problem(f"{folder} is not a folder.")
        files = sorted(f for f in folder.iterdir() if f.suffix.lower() in (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".svs"))
        wanted = [(f.stem, f, None, 1.0) for f in files[: 1 if quick else None]]
        if not wanted:
            raise Problem(f"{folder} holds no PNG, JPEG or TIFF picture.")
    else:
        specimens = os.environ.get("SCOPESERVO_SPECIMENS")
        if not specimens or not Path(specimens).is_dir():
            raise Problem("no slides: set SCOPESERVO_SPECIMENS to their folder, or name a folder of pictures with --images.")
        wanted = [(kind, Path(specimens) / slide, size, busy) for kind, busy, slide in KINDS for size in sizes]
    out = []
    for kind, slide, size, busy in wanted:
        if not slide.exists():
            raise Problem(f"{slide} is not there.")
        stem = f"{kind}-{size[0]}x{size[1]}" if size else kind
        view, target = cache / f"{stem}.view.pgm", cache / f"{stem}.target.pgm"
        say(f"cutting {stem} from {slide.name}")
        reply = worker.ask(
            {"piece": "crop", "slide": str(slide), "size": size, "busy": busy, "view": str(view), "target": str(target)}
        )
        out.append(Image(kind, view, target, tuple(reply["size"]), reply["answer"]))
    return sorted(out, key=lambda i: (i.size[0] * i.size[1], i.name))


# ------------------------------------------------------------------------------------------------------------------- table


def machine() -> str:
    model, logical = platform.processor() or platform.machine(), os.cpu_count()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields = dict(l.split(":", 1) for l in cpuinfo.read_text().splitlines() if ":" in l)
        fields = {k.strip(): v.strip() for k, v in fields.items()}
        family = f" (family {fields['cpu family']}, model {fields['model']})" if "cpu family" in fields else ""
        model = fields.get("model name", model) + family
    elif sys.platform == "darwin":
        model = command(["sysctl", "-n", "machdep.cpu.brand_string"], "naming the processor").strip()
    return f"{model}, {logical} cores, {platform.system()} {platform.machine()}"


def commit() -> str:
    try:
        name = command(["git", "rev-parse", "--short", "HEAD"], "naming the commit").strip()
        changed = command(["git", "status", "--porcelain", "--untracked-files=no"], "naming the commit").strip()
    except Problem:
        return "unknown"
    return name + (" with changes" if changed else "")


def number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def table(titles: list[str], rows: list[list[str]]) -> str:
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def summary(rows: list[Row]) -> str:
    """The smallest ratio of each demand."""
    groups: dict[tuple[str, str, str], list[Row]] = collections.defaultdict(list)
    for row in rows:
        if row.bounds:
            must, aims = row.bounds
            size = f" at {row.size[0]} wide" if row.piece.name == "scan" else ""
            threads = f", {row.threads} thread{'s' * (row.threads > 1)}" if row.piece.name == "affine" else ""
            groups[row.piece.title + size + threads, f"{must:g}", " / ".join(f"{a:g}" for a in aims)].append(row)
    lines = []
    for (title, must, aim), members in groups.items():
        failed = next((r.failed for r in members if r.failed), None)
        known = [r for r in members if r.ratio is not None]
        if failed or not known:
            lines.append([title, "-", "-", must, aim, "check failed" if failed else "not measurable"])
            continue
        worst = min(known, key=lambda r: r.ratio or 0.0)
        best = max(r.ratio or 0.0 for r in known)
        lines.append([title, f"{worst.ratio:.2f}", f"{best:.2f}", must, aim, worst.verdict()])
    return table(["piece", "smallest ratio", "largest", "must", "aim", "smallest against them"], lines)


def details(rows: list[Row]) -> str:
    lines = []
    for r in rows:
        must, aims = r.bounds or (None, [])
        if r.failed:
            ratio = "check failed"
        elif r.ratio is None or r.spread is None:
            ratio = "-"
        else:
            ratio = f"{r.ratio:.2f} ({r.spread[0]:.2f} to {r.spread[1]:.2f})"
        lines.append([
            r.piece.title, f"{r.image} {r.size[0]}x{r.size[1]}", str(r.threads), number(r.ours), number(r.theirs), r.peer,
            "/".join(map(str, r.counts)), ratio, f"{must:g}" if must else "", " / ".join(f"{a:g}" for a in aims), r.verdict(),
        ])  # fmt: skip
    titles = ["piece", "image", "threads", "ours ms", "OpenCV ms", "fastest variant", "counts", "ratio (spread)", "must", "aim", "verdict"]
    return table(titles, lines)


NOTES = """1. Our fast mode, which leaves out the doubled image: another, smaller result. OpenCV does the same work as in the row without it.
2. The strongest so many features of view and target, two nearest each. Ours also does the ratio and mutual tests.
3. FLANN is approximate, and for information.

Times are the median over the rounds of the best repetition in a round, of which all sides have as many; the ratio is OpenCV's time over ours, per round, the
median with the smallest and largest. Within a round the sides take turns, two repetitions each: both meet the same neighbours. Ours
writes its features into those of the frame before, as a camera's loop does. Engines are made and images decoded beforehand, and
the warm-up round is not counted. The peer is the fastest of the variants of OpenCV. Both sides have their default settings but
for the number of features; "best" keeps that many on both sides, where each orientation counts as one. Counts are ours / theirs
(affine: inliers; match: accepted pairs of ours, all queries of theirs). Refine + orient is the difference of two times; "-": too
small a one to be told from noise. Describe is what a side takes longer to describe given keypoints, each side its own, several times
than once.

What limits these figures, and what was tried: [sift-limits.md](sift-limits.md)."""


def document(comparison: Comparison, extras: list[list[str]], versions: str, built_from: str) -> str:
    load = f"; load average at the end {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    stamp = datetime.datetime.now().astimezone().strftime("%Y-%m-%d")
    parts = [
        "# SIFT against its peers",
        f"`{shlex.join(['python3', os.path.relpath(__file__, ROOT), *sys.argv[1:]])}`",
        f"- date: {stamp}\n- machine: {machine()}; our level: {comparison.level}{load}\n- commit: {built_from}\n- versions: {versions}\n"
        f"- rounds: {comparison.rounds}",
        "## Against what was demanded",
        summary(comparison.rows),
        "## Every piece",
        details(comparison.rows),
        NOTES,
    ]
    if extras:
        parts += ["## Other peers", "Detect and describe, all features, one thread, for information.",
                  table(["peer", "image", "ms", "features", "its time over ours"], extras)]  # fmt: skip
    parts += ["## Answers that were checked first", "\n".join(f"- {c}" for c in comparison.checks)]
    return "\n\n".join(parts) + "\n"


# --------------------------------------------------------------------------------------------------------------------- run


def others(ours: Side, cache: Path, image: Image, workers: list[Worker]) -> list[list[str]]:
    """The other libraries; one that is missing is left out with a word."""

    def python(which: str) -> list[str | Path]:
        return [environment("others", cache), HERE / "others_worker.py", which]

    makers = {
        "sift-features": lambda: [build_sift_features(cache)],
        "pycolmap": lambda: python("vlfeat"),
        "scikit-image": lambda: python("skimage"),
    }
    request = {"image": str(image.view), "threads": 1, "repetitions": 3, "piece": "describe"}
    place = f"{image.name} {image.size[0]}x{image.size[1]}"
    mine = ours.worker.ask(request)
    base = min(mine["ms"])
    rows = [["ours", place, number(base), str(mine["count"]), "1"]]
    for name, maker in makers.items():
        say(f"{place}: {name}")
        try:
            worker = Worker(maker(), cache / f"{name}.log")
            workers.append(worker)
            reply = worker.ask(request)
        except Problem as problem:
            say(f"{name} is left out: {problem}")
            rows.append([name, place, "left out", "", ""])
            continue
        ms = min(reply["ms"])
        title = f"{worker.hello['name']} {worker.hello['version']}".strip()
        rows.append([title, place, number(ms), str(reply["count"]), f"{ms / base:.1f}"])
    return rows


def arguments() -> argparse.Namespace:
    def size(text: str) -> tuple[int, int]:
        w, h = (int(n) for n in text.split("x"))
        if min(w, h) < 64:
            raise argparse.ArgumentTypeError(f"{text} is too small, 64x64 is the least")
        return w, h

    names = sorted({p.group for p in PIECES} | {p.name for p in PIECES})
    parser = argparse.ArgumentParser(description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the smallest size, OpenCV 4 alone, few rounds, under two minutes; fails on a wrong answer, never on a time")
    parser.add_argument("--images", type=Path, metavar="FOLDER", help="pictures to use as they are, in place of crops of the slides")
    parser.add_argument("--sizes", type=size, nargs="+", metavar="WxH", default=SIZES, help="sizes of the crops (640x480 1280x1024 2448x2048)")
    parser.add_argument("--rounds", type=int, help="counted rounds (5; 2 with --quick)")
    parser.add_argument("--only", action="append", choices=names, metavar="PIECE", help=f"one piece or group, may be repeated: {', '.join(names)}")
    parser.add_argument("--no-extra-peers", action="store_true", help="OpenCV alone")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table there too")
    given = parser.parse_args()
    if given.rounds is None:
        given.rounds = 2 if given.quick else 5
    if given.rounds < 1:
        parser.error("--rounds must be at least 1")
    if given.write and not given.write.resolve().parent.is_dir():
        parser.error(f"the folder of {given.write} is not there")
    return given


def run(given: argparse.Namespace, workers: list[Worker]) -> int:
    target = target_folder()
    # Named now: the sources may change while the run goes on.
    built_from = commit()
    cache = target / "speed"
    cache.mkdir(parents=True, exist_ok=True)

    def start(arguments: list[str | Path], log: str) -> Worker:
        workers.append(Worker(arguments, cache / log))
        return workers[-1]

    ours = Side("ours", start([build(target)], "ours.log"), {})
    sizes = [min(given.sizes)] if given.quick else given.sizes
    pictures = images(ours.worker, given.images, sizes, given.quick, cache)
    peers = []
    for name in ["opencv4"] if given.quick else ["opencv4", "opencv5"]:
        worker = start([environment(name, cache), HERE / "opencv_worker.py"], f"{name}.log")
        for precise in (False, True):
            title = f"{worker.hello['version']}{' precise' if precise else ''}"
            peers.append(Side(title, worker, {"precise": precise}))

    pieces = [p for p in PIECES if not given.only or p.group in given.only or p.name in given.only]
    if given.quick:
        pieces = [p for p in pieces if "5000" not in p.name and p.group != "flann"]
    of_pairs = [p for p in pieces if p.group in PAIRS]
    of_images = [p for p in pieces if p not in of_pairs]
    comparison = Comparison(ours, peers, given.rounds, 1 if given.quick else 8, cache)
    threads = [t for t in (1, 2) if t <= (os.cpu_count() or 1)]
    for image in pictures if of_images else []:
        for t in threads:
            comparison.run(image, t, of_images)
    if of_pairs:
        # Matching knows no pixels: one image is enough, the one with the most features.
        counts = {i.name + str(i.size): ours.worker.ask({"piece": "describe", "image": str(i.view), "repetitions": 1})["count"] for i in pictures}
        image = max(pictures, key=lambda i: counts[i.name + str(i.size)])
        enough = [p for p in of_pairs if int(p.name.split("-")[1]) <= 0.8 * counts[image.name + str(image.size)]]
        for t in threads if enough else []:
            comparison.run(image, t, enough)
    extras = [] if given.quick or given.no_extra_peers else others(ours, cache, pictures[0], workers)

    versions = f"scopeservo-sift {ours.worker.hello['version']}, "
    versions += ", ".join(dict.fromkeys(f"OpenCV {s.worker.hello['version']}" for s in peers))
    versions += f", {command(['rustc', '--version'], 'naming the compiler').strip()}, Python {platform.python_version()}"
    text = document(comparison, extras, versions, built_from)
    print(text)
    if given.write:
        given.write.write_text(text)
    for failure in comparison.failures:
        say(f"check failed: {failure}")
    return 1 if comparison.failures else 0


def main() -> int:
    def stopped(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stopped)
    given = arguments()
    workers: list[Worker] = []
    try:
        return run(given, workers)
    except Problem as problem:
        say(f"speed.py: {problem}")
        return 2
    except OSError as error:
        say(f"speed.py: {error}")
        return 2
    except KeyboardInterrupt:
        say("speed.py: interrupted")
        return 130
    finally:
        for worker in workers:
            worker.stop()


if __name__ == "__main__":
    sys.exit(main())
