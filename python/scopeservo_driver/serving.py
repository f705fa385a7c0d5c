"""Entry points: speak on standard input and output, or listen on a TCP port."""

from __future__ import annotations

import atexit
import ipaddress
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any, NoReturn

from .errors import DriverError
from .instrument import Instrument
from .session import Session
from .standard_streams import protect_stdout

READ_BYTES = 65536
HELLO_WAIT_S = 15.0
STRANGERS = 16
ACCEPT_AGAIN_S = 0.05
EXIT_WAIT_S = 3.0


class PipeChannel:
    """Two file descriptors."""

    def __init__(self, fd_in: int, fd_out: int) -> None:
        self.fd_in = fd_in
        self._fd_out = fd_out

    def read(self) -> bytes:
        return os.read(self.fd_in, READ_BYTES)

    def write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(self._fd_out, rest) :]

    def accepted(self) -> None:
        pass


class SocketChannel:
    """One connection. Who does not get through hello in time, however he spends it, is disconnected."""

    def __init__(self, connection: socket.socket, on_accepted: Callable[[], None] = lambda: None) -> None:
        self._connection = connection
        self._on_accepted = on_accepted
        self._deadline: float | None = time.monotonic() + HELLO_WAIT_S
        connection.settimeout(HELLO_WAIT_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # A program whose machine has gone must not keep the driver in use for hours.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

    def read(self) -> bytes:
        if self._deadline is not None:
            left_s = self._deadline - time.monotonic()
            if left_s <= 0:
                raise TimeoutError("hello did not come in time")
            self._connection.settimeout(left_s)
        return self._connection.recv(READ_BYTES)

    def write(self, data: bytes) -> None:
        self._connection.sendall(data)

    def accepted(self) -> None:
        self._deadline = None
        self._connection.settimeout(None)
        self._on_accepted()


class Strangers:
    """The connections of those who have not said hello: never more than some, and the one that has been there longest goes."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[socket.socket] = []

    def add(self, connection: socket.socket) -> None:
        with self._lock:
            self._waiting.append(connection)
            if len(self._waiting) > STRANGERS:
                try:
                    self._waiting.pop(0).shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass  # it has gone

    def remove(self, connection: socket.socket) -> None:
        with self._lock:
            if connection in self._waiting:
                self._waiting.remove(connection)


def serve(
    *, stage: Any = None, camera: Any = None, nosepiece: Any = None, light: Any = None, name: str = "Python driver"
) -> NoReturn:
    """Speak the protocol on standard input and output, and end the process with the conversation.

    Clean up your devices with `atexit` or `finally`: the end is a SystemExit.
    """
    channel = PipeChannel(*protect_stdout())
    instrument = Instrument(stage, camera, nosepiece, light, name)
    session = Session(instrument, channel)
    _stop_on_signals(instrument, ends_on_interrupt=os.isatty(channel.fd_in))
    threading.Thread(target=session.run, daemon=True, name="reader").start()
    # With a timeout, because Windows delivers no signal during an endless wait.
    while not session.over.wait(0.5):
        pass
    _end_process()


def serve_tcp(
    *,
    stage: Any = None,
    camera: Any = None,
    nosepiece: Any = None,
    light: Any = None,
    name: str = "Python driver",
    host: str = "127.0.0.1",
    port: int,
    secret: str | None = None,
) -> NoReturn:
    """Listen on `host` and `port` and answer one program after another, until the process is ended.

    Any address but those of this machine itself needs a `secret`. With port 0 the system picks a free one. The port is
    written to standard error when programs can connect.
    """
    family, _, _, _, address = socket.getaddrinfo(host or "0.0.0.0", port, type=socket.SOCK_STREAM)[0]
    if secret is not None and not secret:
        raise ValueError("the secret is empty")
    if secret is None and not ipaddress.ip_address(str(address[0]).split("%")[0]).is_loopback:
        raise ValueError(f"{host} can be reached from other machines: give a secret, or listen on 127.0.0.1")
    instrument = Instrument(stage, camera, nosepiece, light, name)
    _stop_on_signals(instrument, ends_on_interrupt=True)
    with socket.socket(family, socket.SOCK_STREAM) as listener:
        if os.name == "posix":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
        print(f"{name}: listening on {host} port {listener.getsockname()[1]}", file=sys.stderr, flush=True)
        _receive(listener, instrument, secret)


def _receive(listener: socket.socket, instrument: Instrument, secret: str | None) -> NoReturn:
    in_use = threading.Lock()
    strangers = Strangers()
    trouble: str | None = None
    while True:
        try:
            connection, _ = listener.accept()
        except OSError as error:
            # Too many files, say: some connections end, and the next may come.
            if trouble != str(error):
                trouble = str(error)
                print(f"a connection could not be taken: {error}", file=sys.stderr, flush=True)
            time.sleep(ACCEPT_AGAIN_S)
            continue
        trouble = None
        strangers.add(connection)
        threading.Thread(
            target=_converse,
            args=(instrument, connection, secret, in_use, strangers),
            daemon=True,
            name="connection",
        ).start()


def _converse(
    instrument: Instrument,
    connection: socket.socket,
    secret: str | None,
    in_use: threading.Lock,
    strangers: Strangers,
) -> None:
    with connection:
        try:
            channel = SocketChannel(connection, on_accepted=lambda: strangers.remove(connection))
            session = Session(instrument, channel, secret, claim=lambda: in_use.acquire(blocking=False))
            try:
                session.run()
            finally:
                if session.accepted:
                    in_use.release()
        except OSError:
            pass  # it has gone already
        finally:
            strangers.remove(connection)


def _stop_on_signals(instrument: Instrument, ends_on_interrupt: bool) -> None:
    """SIGTERM stops everything and ends. So does Ctrl-C, unless a program is at the other end: that one decides."""
    if threading.current_thread() is not threading.main_thread():
        return

    def end(number: int, frame: FrameType | None) -> None:
        instrument.end()
        _end_process(128 + number)

    def stop(number: int, frame: FrameType | None) -> None:
        try:
            instrument.stop()
        except DriverError as error:
            print(f"stopping failed: {error}", file=sys.stderr)

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end if ends_on_interrupt else stop)


_exit_code: int | None = None


def _end_process(code: int = 0) -> NoReturn:
    global _exit_code
    _exit_code = code
    # A library's thread that never ends must not keep the process alive.
    timer = threading.Timer(EXIT_WAIT_S, os._exit, args=(code,))
    timer.daemon = True
    timer.start()
    raise SystemExit(code)


@atexit.register
def _exit_before_threads_are_torn_down() -> None:
    """Registered before the clean-up of drivers, so it runs after it.

    Python ends threads that are still within a C++ library in a way that aborts the process.
    """
    if _exit_code is not None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_exit_code)
