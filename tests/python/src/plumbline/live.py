"""Live telemetry: the ground's WebSocket of batches, decoded where somebody looks, and the operator's sign of life.

A batch is what the agent encoded (`proto/src/codec.rs`): `0x50 | schema u8 | frame*`, a frame
`kind u16 | instance u16 | length u32 | sequence u64 | time_us u64 | payload`, little-endian. Kinds that this package does
not know are passed over.
"""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, TypeVar
from urllib.parse import quote

import httpx
from google.protobuf.message import DecodeError, Message
from typing_extensions import Self
from websockets.exceptions import InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from . import v1
from ._http import COOKIE, OPERATOR, Connection
from .errors import NotAttended, PlumblineError, Problem, TimedOut, Unreachable, problem

M = TypeVar("M", bound=Message)

MAGIC = 0x50
SCHEMA = 1
_FRAME = struct.Struct("<HHIQQ")
#: Messages kept for a reader that is slower than the vehicle; then the oldest go, and are counted.
WAITING = 10_000
#: A link that broke is tried again after so long, s.
AGAIN_S = 0.3

#: Number on the wire, topic without its instance, message, and whether there is one topic for each instance.
KINDS: dict[int, tuple[str, type[Message], bool]] = {
    1: ("/sensor/imu", v1.ImuSample, True),
    2: ("/sensor/height", v1.HeightSample, True),
    3: ("/sensor/barometer", v1.BarometerSample, True),
    4: ("/sensor/gnss", v1.GnssSample, True),
    5: ("/sensor/mocap_pose", v1.MocapPoseSample, True),
    6: ("/sensor/camera_ranges", v1.CameraRangesSample, True),
    10: ("/estimate", v1.Estimate, True),
    11: ("/residuals", v1.Residuals, True),
    12: ("/truth", v1.Truth, False),
    13: ("/secure", v1.SecureStatus, False),
    20: ("/control", v1.Control, False),
    21: ("/step", v1.StepResponse, False),
    22: ("/gains", v1.GainsInUse, False),
    23: ("/attacks", v1.AttackState, False),
    30: ("/status", v1.Status, False),
    31: ("/event", v1.Event, False),
    32: ("/ack", v1.Ack, False),
    33: ("/description", v1.Description, False),
    34: ("/flight", v1.FlightMark, False),
    35: ("/device", v1.DeviceState, True),
    36: ("/scan", v1.Scan, True),
    40: ("/link", v1.LinkStatus, False),
    41: ("/recording", v1.RecordingStatus, False),
    42: ("/lease", v1.ControlLease, False),
}
_NUMBERS: dict[type[Message], int] = {message: number for number, (_, message, _) in KINDS.items()}
_STATUS = _NUMBERS[v1.Status]
#: Kinds from here on are the ground's own: their times are no flight times.
_GROUND = 40


@dataclass(frozen=True, slots=True)
class Received(Generic[M]):
    """One message with its envelope."""

    #: As in a flight file: `/sensor/height/2`.
    topic: str
    #: Sensor instance or number of the estimator; 0 where there is one topic only.
    instance: int
    #: Counts the agent's messages since its start; 0 for those of the ground.
    sequence: int
    #: Flight time, µs; wall time for messages of the ground.
    time_us: int
    message: M


@dataclass(frozen=True, slots=True)
class Frame:
    """One message, not decoded yet."""

    kind: int
    instance: int
    sequence: int
    time_us: int
    payload: bytes


def frames(batch: bytes) -> Iterator[Frame]:
    """The frames of a batch.

    Raises `ValueError` for what is no batch of this schema, or is cut off.
    """
    if len(batch) < 2 or batch[0] != MAGIC:
        raise ValueError(f"{batch[:2]!r} begins no batch")
    if batch[1] != SCHEMA:
        raise ValueError(f"the batch has schema {batch[1]}, this package reads {SCHEMA}")
    at = 2
    while at < len(batch):
        if at + _FRAME.size > len(batch):
            raise ValueError(f"a frame is cut off after {len(batch) - at} bytes")
        kind, instance, length, sequence, time_us = _FRAME.unpack_from(batch, at)
        at += _FRAME.size
        if at + length > len(batch):
            raise ValueError(f"a frame of {length} bytes is cut off after {len(batch) - at}")
        yield Frame(kind, instance, sequence, time_us, batch[at : at + length])
        at += length


def number_of(message: type[Message]) -> int:
    """The number of a kind of message on the wire."""
    found = _NUMBERS.get(message)
    if found is None:
        raise TypeError(f"{message.__name__} has no topic of its own")
    return found


class Subscription(Generic[M]):
    """What comes of one kind of message, in order; ends with the link, or after its time."""

    def __init__(self, live: Live, message: type[M], instance: int | None, seconds: float | None) -> None:
        self._live = live
        self._message = message
        self._kind = number_of(message)
        self._instance = instance
        self._until = None if seconds is None else time.monotonic() + seconds
        self._waiting: deque[Frame] = deque(maxlen=WAITING)
        #: Messages that gave way because they were not read in time.
        self.dropped = 0
        live._subscribe(self)

    def __iter__(self) -> Iterator[Received[M]]:
        return self

    def __next__(self) -> Received[M]:
        with self._live._changed:
            while not self._waiting:
                left = None if self._until is None else self._until - time.monotonic()
                if (left is not None and left <= 0) or self._live.closed:
                    self._live._unsubscribe(self)
                    if self._live.closed and self._live.error is not None:
                        raise self._live.error
                    raise StopIteration
                self._live._changed.wait(left)
            frame = self._waiting.popleft()
        topic, _, instances = KINDS[frame.kind]
        topic = f"{topic}/{frame.instance}" if instances else topic
        message = self._message.FromString(frame.payload)
        return Received(topic, frame.instance, frame.sequence, frame.time_us, message)

    def close(self) -> None:
        """No more of it."""
        with self._live._changed:
            self._live._unsubscribe(self)

    def _offer(self, frame: Frame) -> None:
        if frame.kind == self._kind and self._instance in (None, frame.instance):
            self.dropped += len(self._waiting) == WAITING
            self._waiting.append(frame)


class Live:
    """The live link to one vehicle. A thread of its own receives; a link that breaks is opened again."""

    def __init__(self, connection: Connection, vehicle: str, history_s: float = 0.0) -> None:
        self._connection = connection
        self._vehicle = vehicle
        self._history_s = history_s
        self._changed = threading.Condition()
        self._latest: dict[tuple[int, int], Frame] = {}
        self._subscriptions: list[Subscription[Message]] = []
        self._attending: Callable[[], bool] | None = None
        self._socket = self._open()
        #: Is it over?
        self.closed = False
        #: Why it ended by itself.
        self.error: PlumblineError | None = None
        #: Times that it broke and was opened again.
        self.reconnected = 0
        #: Signs of life sent.
        self.alive_sent = 0
        self._thread = threading.Thread(target=self._receive, name=f"plumbline live {vehicle}", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: tuple[type[BaseException], BaseException, TracebackType]) -> None:
        self.close()

    def close(self) -> None:
        """Ends it; the ground gives control back five seconds later, and the vehicle counts as unattended."""
        self._end(None)
        self._socket.close()
        self._thread.join(5)

    def latest(self, message: type[M], instance: int | None = None) -> M | None:
        """The newest of a kind; where it has instances and none is named, of any."""
        kind = number_of(message)
        with self._changed:
            found = [frame for (k, i), frame in self._latest.items() if k == kind and instance in (None, i)]
        newest = max(found, key=lambda frame: frame.time_us, default=None)
        return None if newest is None else message.FromString(newest.payload)

    def stream(
        self, message: type[M], instance: int | None = None, seconds: float | None = None
    ) -> Subscription[M]:
        """Every message of a kind from now on, for so many seconds or until the link is closed."""
        return Subscription(self, message, instance, seconds)

    def wait(
        self,
        message: type[M],
        condition: Callable[[M], bool],
        timeout_s: float = 30.0,
        instance: int | None = None,
    ) -> M:
        """The first message of a kind, the newest one included, for which `condition` holds.

        Raises `TimedOut`, or what ended the link.
        """
        arriving = self.stream(message, instance, timeout_s)
        last = self.latest(message, instance)
        if last is not None and condition(last):
            arriving.close()
            return last
        for received in arriving:
            last = received.message
            if condition(last):
                arriving.close()
                return last
        if self.closed:
            raise NotAttended(f"the live link of {self._vehicle} was closed")
        raise TimedOut(f"no {message.__name__} as wanted within {timeout_s} s; the last one:\n{last}")

    @property
    def newest_us(self) -> int | None:
        """Flight time of the newest message of the vehicle, µs."""
        with self._changed:
            times = [frame.time_us for (kind, _), frame in self._latest.items() if kind < _GROUND]
        return max(times, default=None)

    def attend(self, while_true: Callable[[], bool] | None) -> None:
        """Sends the operator's sign of life with every status, as the page does, while the function says so."""
        self._attending = while_true

    def _subscribe(self, subscription: Subscription[M]) -> None:
        with self._changed:
            self._subscriptions.append(subscription)  # type: ignore[arg-type]

    def _unsubscribe(self, subscription: Subscription[M]) -> None:
        self._subscriptions = [other for other in self._subscriptions if other is not subscription]

    def _open(self) -> ClientConnection:
        base = self._connection.url
        url = f"ws{base.removeprefix('http')}/api/v1/vehicles/{quote(self._vehicle, safe='')}/live"
        headers = {OPERATOR: self._connection.operator}
        if self._connection.token:
            headers["Cookie"] = f"{COOKIE}={self._connection.token}"
        query = f"?history={self._history_s:g}&operator={quote(self._connection.operator, safe='')}"
        tls = self._connection.tls if base.startswith("https") and not isinstance(self._connection.tls, bool) else None
        try:
            # Entered, so that it is one connection in every version of the library; closing it is leaving it.
            return connect(
                url + query,
                ssl=tls,
                origin=Origin(base),
                additional_headers=headers,
                compression=None,
                max_size=None,
                proxy=None,
                open_timeout=10,
            ).__enter__()
        except InvalidStatus as refused:
            raise _refusal(refused) from refused
        except (OSError, WebSocketException) as error:
            raise Unreachable(f"{base}: {error}") from error

    def _receive(self) -> None:
        while not self.closed:
            try:
                for batch in self._socket:
                    if isinstance(batch, bytes):
                        self._take(batch)
            except (OSError, WebSocketException):
                pass
            except ValueError as error:
                self._end(PlumblineError(f"{self._vehicle}: {error}"))
                return
            self._reopen()
        # One that was opened while it was closed.
        self._socket.close()

    def _reopen(self) -> None:
        while not self.closed:
            time.sleep(AGAIN_S)
            try:
                self._socket = self._open()
                self.reconnected += 1
                return
            except Unreachable:
                continue
            except Problem as refused:
                self._end(refused)

    def _end(self, error: PlumblineError | None) -> None:
        with self._changed:
            self.closed = True
            self.error = error
            self._changed.notify_all()

    def _take(self, batch: bytes) -> None:
        status: Frame | None = None
        with self._changed:
            for frame in frames(batch):
                if frame.kind not in KINDS:
                    continue
                self._latest[frame.kind, frame.instance] = frame
                for subscription in self._subscriptions:
                    subscription._offer(frame)
                if frame.kind == _STATUS:
                    status = frame
            self._changed.notify_all()
        if status is not None and self._attending is not None and self._attending():
            self._answer(status)

    def _answer(self, status: Frame) -> None:
        try:
            challenge = v1.Status.FromString(status.payload).challenge
        except DecodeError:
            return
        if challenge:
            self._socket.send(v1.OperatorAlive(challenge=challenge).SerializeToString())
            self.alive_sent += 1


def _refusal(refused: InvalidStatus) -> Problem:
    """What an answer to the upgrade says; it has the form of every other error."""
    response = refused.response
    headers = list(response.headers.raw_items())
    return problem(httpx.Response(response.status_code, headers=headers, content=bytes(response.body or b"")))
