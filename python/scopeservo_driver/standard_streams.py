"""Keeps standard output for the protocol alone."""

from __future__ import annotations

import os
import sys

_kept: tuple[int, int] | None = None


def protect_stdout() -> tuple[int, int]:
    """Keep the real standard input and output for the protocol; what anybody prints from now on goes to standard error.

    `serve` does this. Call it yourself, before you import them, when your libraries print while they are imported.
    Gives the file descriptors to read requests from and to write replies to.
    """
    global _kept
    if _kept is None:
        # Not flushed before: what a library left in the buffer then goes to standard error too.
        _kept = (os.dup(0), os.dup(1))
        os.dup2(2, 1)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        if sys.stdout is not None and hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(line_buffering=True)
    return _kept
