"""One conversation, from the first byte to the end."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
import time
from collections.abc import Callable
from typing import Protocol

from .errors import BadRequest, Busy, DriverError, Refused, Unsupported
from .instrument import DEVICE_OF_CALL, Instrument, as_driver_error
from .messages import LineSplitter, NotUnderstood, Request, encode, encode_error, parse_request
from .adapters import Reply

PROTOCOL = 1


class Channel(Protocol):
    """Where the bytes come from and go to."""

    def read(self) -> bytes:
        """Some bytes; none at the end."""

    def write(self, data: bytes) -> None:
        """All of them, or OSError."""

    def accepted(self) -> None:
        """The other side has shown that it may speak."""


class Session:
    """Answers one program. `claim` tells whether the instrument is free for it."""

    def __init__(
        self,
        instrument: Instrument,
        channel: Channel,
        secret: str | None = None,
        claim: Callable[[], bool] = lambda: True,
    ) -> None:
        self._instrument = instrument
        self._channel = channel
        self._secret = secret
        self._claim = claim
        self._nonce: str | None = None
        self._last_id = 0
        self._open = True
        self._closing = False
        self._finish_lock = threading.Lock()
        self._write_lock = threading.Lock()
        self.over = threading.Event()
        """Set when the conversation has ended and everything was stopped."""
        self.accepted = False
        """Whether hello was answered with the devices."""

    def run(self) -> None:
        """Read and answer until bye or the end of the input."""
        splitter = LineSplitter()
        try:
            while self._open:
                data = self._channel.read()
                if not data:
                    break
                for line in splitter.feed(data):
                    self._handle_line(line)
                    if not self._open:
                        break
        except OSError:
            pass
        finally:
            self._finish()

    def _finish(self) -> None:
        self._open = False
        with self._finish_lock:
            if self.accepted and not self.over.is_set():
                self._instrument.end()
            self.over.set()

    def _handle_line(self, line: bytes | None) -> None:
        try:
            if line is None:
                raise NotUnderstood(None, "a message must have at most 65536 bytes")
            request = parse_request(line)
            if request.id <= self._last_id:
                raise NotUnderstood(request.id, "the id of a request must be larger than those before")
        except NotUnderstood as error:
            self._send(encode_error(error.id, error.code, str(error)))
            return
        self._last_id = request.id
        try:
            self._handle(request)
        except Exception as error:
            self._send_error(request, as_driver_error(error))
        if self._closing:
            self._open = False

    def _handle(self, request: Request) -> None:
        if request.call == "hello":
            self._hello(request)
        elif not self.accepted:
            if self._secret is not None:
                raise Refused("prove with hello that you know the secret")
            raise BadRequest("say hello first")
        elif request.call == "stop":
            threading.Thread(target=self._stop, args=(request,), daemon=True, name="stop").start()
        elif request.call == "bye":
            self._stop(request)
            self._closing = True
        elif request.call in DEVICE_OF_CALL:
            self._pass_on(request)
        else:
            raise Unsupported(f"there is no call {request.call}")

    def _hello(self, request: Request) -> None:
        if self.accepted:
            raise BadRequest("hello was said before")
        if request.number("protocol") != PROTOCOL:
            raise Unsupported(f"this driver speaks protocol {PROTOCOL}; use a program or a driver that fits")
        if self._secret is not None and not self._is_proven(request, self._secret):
            return
        said = {"protocol": PROTOCOL, "name": self._instrument.name} | self._instrument.describe()
        if not self._claim():
            self._closing = True
            raise Busy("another program uses this driver; end it first")
        self.accepted = True
        self._channel.accepted()
        self._send(encode({"id": request.id, "ok": True} | said))

    def _is_proven(self, request: Request, secret: str) -> bool:
        if self._nonce is None:
            self._nonce = secrets.token_hex(32)
            message = "this driver asks for its secret; give it to the program"
            self._send(encode_error(request.id, "secret", message, nonce=self._nonce))
            return False
        wanted = hmac.new(secret.encode("utf-8"), self._nonce.encode("ascii"), hashlib.sha256).hexdigest()
        given = request.fields.get("proof")
        if isinstance(given, str) and hmac.compare_digest(
            given.encode("utf-8", "backslashreplace"), wanted.encode("ascii")
        ):
            return True
        self._closing = True
        raise Refused("the secret is wrong; give the program the one that the driver was started with")

    def _pass_on(self, request: Request) -> None:
        device = DEVICE_OF_CALL[request.call]
        if device not in self._instrument.adapters:
            raise Unsupported(f"this driver has no {device}")
        stops_seen = self._instrument.stops_so_far()
        self._instrument.workers[device].do(lambda: self._answer(device, request, stops_seen))

    def _answer(self, device: str, request: Request, stops_seen: int) -> None:
        if not self._open:
            return
        try:
            reply = self._instrument.do(device, request, stops_seen)
        except BaseException as error:
            self._send_error(request, as_driver_error(error))
        else:
            self._send_reply(request, reply)

    def _stop(self, request: Request) -> None:
        try:
            self._instrument.stop()
        except BaseException as error:
            self._send_error(request, as_driver_error(error))
        else:
            self._send_reply(request, Reply())

    def _send_error(self, request: Request, error: DriverError) -> None:
        self._send(encode_error(request.id, error.code, str(error) or type(error).__name__))

    def _send_reply(self, request: Request, reply: Reply) -> None:
        said = {"id": request.id, "ok": True} | reply.fields
        if reply.samples is None:
            self._send(encode(said))
            return
        with self._write_lock:
            age_ms = max(0.0, (time.monotonic() - reply.began_s) * 1000)
            self._write(encode(said | {"age_ms": age_ms, "bytes": len(reply.samples)}))
            self._write(reply.samples)

    def _send(self, line: bytes) -> None:
        with self._write_lock:
            self._write(line)

    def _write(self, data: bytes) -> None:
        if not self._open:
            return
        try:
            self._channel.write(data)
        except OSError:
            # Nobody listens: the same as the end of the input. In a thread, because ending waits for workers.
            self._open = False
            threading.Thread(target=self._finish, daemon=True, name="end").start()
