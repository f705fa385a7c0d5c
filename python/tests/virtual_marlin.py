"""OctoPrint's Virtual Marlin on a TCP port, one connection after another: a test peer, from an environment of its own.

    virtual_marlin.py --listen HOST:PORT [--set KEY=JSON ...]
"""

from __future__ import annotations

import argparse
import json
import logging
import socket
import sys
import tempfile
import threading
from typing import Any

from octoprint.plugin import plugin_manager
from octoprint.plugins.virtual_printer import VirtualPrinterPlugin
from octoprint.plugins.virtual_printer.virtual import VirtualPrinter


class Settings:
    """What the plugin asks of OctoPrint's settings: its own defaults, but for what was set."""

    def __init__(self, changes: dict[str, Any], folder: str) -> None:
        self._all = VirtualPrinterPlugin().get_settings_defaults() | changes
        self._folder = folder

    def get(self, path: list[str], merged: bool = False) -> Any:
        return self._all.get(path[0])

    def get_boolean(self, path: list[str]) -> bool:
        return bool(self.get(path))

    def get_int(self, path: list[str]) -> int:
        return int(self.get(path) or 0)

    def get_float(self, path: list[str]) -> float:
        return float(self.get(path) or 0)

    def global_get_basefolder(self, name: str) -> str:
        return self._folder


def converse(connection: socket.socket, settings: Settings, folder: str) -> None:
    printer = VirtualPrinter(settings, None, folder, read_timeout=0.1)
    over = threading.Event()

    def speak() -> None:
        try:
            while not over.is_set():
                line = printer.readline()
                # It leaves out the end of some lines, which OctoPrint does not need.
                connection.sendall(line if not line or line.endswith(b"\n") else line + b"\n")
        except (OSError, TypeError):
            over.set()

    threading.Thread(target=speak, daemon=True).start()
    try:
        for line in connection.makefile("rb"):
            printer.write(line)
    except OSError:
        pass
    finally:
        over.set()
        printer.close()


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--listen", required=True)
    options.add_argument("--set", action="append", default=[])
    given = options.parse_args()
    changes = {key: json.loads(value) for key, value in (pair.split("=", 1) for pair in given.set)}
    logging.disable(logging.CRITICAL)
    plugin_manager(init=True, plugin_folders=[], plugin_entry_points=[])
    host, port = given.listen.rsplit(":", 1)
    with tempfile.TemporaryDirectory() as folder, socket.create_server((host, int(port))) as listener:
        print(f"Virtual Marlin: listening on {given.listen}", file=sys.stderr, flush=True)
        while True:
            connection, _ = listener.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                converse(connection, Settings(changes, folder), folder)


if __name__ == "__main__":
    main()
