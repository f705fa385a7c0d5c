"""Command-line options that all ready drivers share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NoReturn

from .devices import Objective
from .adapters import IMMERSIONS, MOVES
from .serving import serve, serve_tcp


class OptionError(Exception):
    """The options do not fit; the message says what to do."""


def objective(text: str) -> Objective:
    """ID:MAGNIFICATION:NUMERICAL_APERTURE:UM_PER_PX, and :IMMERSION where that is not air. The id may have colons of its own."""
    numbers, _, last = text.rpartition(":")
    immersion = last if last in IMMERSIONS else "air"
    parts = (numbers if last in IMMERSIONS else text).rsplit(":", 3)
    try:
        id, magnification, numerical_aperture, um_per_px = parts
        return Objective(id, float(magnification), float(numerical_aperture), float(um_per_px), immersion)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not ID:MAGNIFICATION:NUMERICAL_APERTURE:UM_PER_PX, such as 10x:100:0.25:1.0, or 100x:1000:1.25:0.1:oil"
        ) from None


def address(text: str) -> tuple[str, int]:
    """HOST:PORT."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT, such as 127.0.0.1:5599")
    return host.strip("[]"), int(port)


def add_stage_options(parser: argparse.ArgumentParser) -> None:
    """What a stage needs that its library does not know."""
    parser.add_argument("--moves", choices=MOVES, default="specimen_xy_on_top", help="what the stage carries")
    parser.add_argument(
        "--positive-z", choices=("closer", "apart"), help="what larger z does to objective and specimen"
    )
    parser.add_argument(
        "--repeatability-um", type=float, default=1.0, metavar="UM", help="half-width of repeated arrivals (1 um)"
    )
    parser.add_argument(
        "--tolerance-um", type=float, default=5.0, metavar="UM", help="a move that ends farther off is a fault (5 um)"
    )
    parser.add_argument(
        "--settle-ms", type=float, default=0.0, metavar="MS", help="how long the stage settles after a move (0 ms)"
    )


def add_objective_option(parser: argparse.ArgumentParser) -> None:
    """The objectives, which no library knows well enough."""
    parser.add_argument(
        "--objective",
        type=objective,
        action="append",
        default=[],
        metavar="ID:MAGNIFICATION:NA:UM_PER_PX[:IMMERSION]",
        help="an objective, such as 10x:100:0.25:1.0 or 100x:1000:1.25:0.1:oil; repeat for each",
    )


def add_serving_options(parser: argparse.ArgumentParser) -> None:
    """How the program reaches the driver."""
    parser.add_argument("--name", help="what people see")
    parser.add_argument(
        "--listen", type=address, metavar="HOST:PORT", help="listen there instead of on standard input and output"
    )
    parser.add_argument(
        "--secret-file", type=Path, metavar="FILE", help="its first line is the secret that programs must know"
    )


def serve_as_asked(options: argparse.Namespace, name: str, **devices: Any) -> NoReturn:
    """Serve `devices` the way the options say."""
    name = options.name or name
    if options.listen is None:
        if options.secret_file is not None:
            raise OptionError("--secret-file is for --listen")
        serve(name=name, **devices)
    secret = None
    if options.secret_file is not None:
        secret = options.secret_file.read_text(encoding="utf-8").partition("\n")[0].rstrip("\r")
    host, port = options.listen
    try:
        serve_tcp(name=name, host=host, port=port, secret=secret, **devices)
    except ValueError as error:
        raise OptionError(f"{error}; --secret-file gives one") from None
