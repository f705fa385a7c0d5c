#!/usr/bin/env python3
"""Counts the instructions of our SIFT under callgrind and compares them with the recorded ones: a guard without a clock.

Needs cargo and valgrind on Linux, x86-64. Callgrind knows AVX2 but not AVX-512.

A script and not gungraun: that brings 30 packages into the benches and 200 into a runner to be installed at the same version,
and keeps its baselines in the target folder, where a record that is committed and renewed by one command is wanted.

  python3 crates/sift/counts/counts.py            compare, 5 % either way
  python3 crates/sift/counts/counts.py --renew    record the present counts
"""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
RECORD = Path(__file__).with_name("counts.json")
WORK = [(level, piece) for level in ("scalar", "avx2") for piece in ("describe", "match")]


def output(*command: str | Path) -> tuple[str, str]:
    try:
        done = subprocess.run([str(c) for c in command], cwd=ROOT, capture_output=True, text=True)
    except FileNotFoundError:
        sys.exit(f"counts.py needs {command[0]}, which is not installed.")
    if done.returncode:
        sys.exit(f"{command[0]} failed: {(done.stderr.strip().splitlines() or ['no reason given'])[-1]}")
    return done.stdout, done.stderr


def count(program: Path, level: str, piece: str) -> int:
    options = ["--tool=callgrind", "--collect-atstart=no", "--toggle-collect=*counted::counted*", "--callgrind-out-file=/dev/null"]
    said = output("valgrind", *options, program, level, piece)[1]
    found = re.search(r"Collected : (\d+)", said)
    if not found or int(found[1]) == 0:
        sys.exit(f"valgrind counted nothing of {level} {piece}.")
    return int(found[1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renew", action="store_true", help="record the present counts")
    parser.add_argument("--percent", type=float, default=5.0, help="how far a count may be off (5)")
    given = parser.parse_args()
    output("cargo", "build", "--release", "-p", "scopeservo-sift", "--example", "counted")
    metadata = json.loads(output("cargo", "metadata", "--no-deps", "--format-version", "1", "--offline")[0])
    program = Path(metadata["target_directory"]) / "release" / "examples" / "counted"
    compiler = output("rustc", "--version")[0].strip()
    counts = {f"{level} {piece}": count(program, level, piece) for level, piece in WORK}
    if given.renew:
        RECORD.write_text(json.dumps({"compiler": compiler, "instructions": counts}, indent=2) + "\n")
        print(f"recorded in {RECORD.relative_to(ROOT)}: {counts}")
        return 0
    record = json.loads(RECORD.read_text())
    if record["compiler"] != compiler:
        print(f"recorded with {record['compiler']}, this is {compiler}: another compiler may count otherwise")
    off = False
    for name, now in counts.items():
        before = record["instructions"][name]
        change = 100 * (now / before - 1)
        bad = abs(change) > given.percent
        off |= bad
        print(f"{name:16} {now:>13,} instructions, recorded {before:>13,}, {change:+.2f} %{' OUT OF BOUNDS' if bad else ''}")
    if off:
        print("if this is meant, record it: python3 crates/sift/counts/counts.py --renew")
    return int(off)


if __name__ == "__main__":
    sys.exit(main())
