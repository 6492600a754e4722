"""One vehicle: watching it, and flying it under the lease."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import quote

from google.protobuf.message import Message

from . import v1
from ._http import Connection
from .errors import Held, PlumblineError, TimedOut
from .live import Live

if TYPE_CHECKING:
    from . import models

M = TypeVar("M", bound=Message)

#: A vehicle that lands from the highest limit is down within this, s.
LANDING_S = 60.0


class Vehicle:
    """A vehicle that the ground knows."""

    def __init__(self, connection: Connection, id: str) -> None:
        self._connection = connection
        #: The agent's id.
        self.id = id

    def __repr__(self) -> str:
        return f"Vehicle({self.id!r})"

    def path(self, route: str) -> str:
        """Path of one of its routes."""
        return f"/api/v1/vehicles/{quote(self.id, safe='')}/{route}"

    def live(self, history_s: float = 0.0) -> Live:
        """Its live telemetry, beginning so many seconds back (two minutes at most)."""
        return Live(self._connection, self.id, history_s)

    def foxglove_address(self) -> models.LiveAddress:
        """Where Foxglove sees it live: where people sign in once, within minutes, with your role and while you are signed in."""
        address: models.LiveAddress = self._connection.json("POST", self.path("foxglove"))
        return address

    def lease(self) -> models.Lease:
        """Who holds control."""
        lease: models.Lease = self._connection.json("GET", self.path("lease"))
        return lease

    def gains(self) -> models.Gains:
        """The gains in use, with their certificate, and every revision."""
        gains: models.Gains = self._connection.json("GET", self.path("gains"))
        return gains

    def cut(self) -> models.Answer:
        """Cuts the motors at once: the vehicle falls. Asks no lease."""
        answer: models.Answer = self._connection.json("POST", self.path("cut"))
        return answer

    @contextlib.contextmanager
    def control(
        self, *, take_over: bool = False, patience_s: float | None = None, land: bool = True
    ) -> Iterator[Control]:
        """Takes control, keeps the operator's sign of life, and gives both back at the end of the block.

        Raises `Held` when another operator has control, unless `take_over`. The sign of life is the answer to each
        status of the vehicle; it ends with this process, with the thread that entered the block, with the link, and, given
        `patience_s`, when the script has commanded nothing and waited for nothing so long: then the vehicle freezes its
        setpoint after 3 s and descends after 10 s. However the block ends, a vehicle that is still armed is landed first,
        unless `land` is false.
        """
        live = self.live()
        try:
            holder = self.lease().get("holder")
            if holder is not None and holder != self._who() and not take_over:
                held = Held(f"operator {holder!r} holds control", status=423)
                held.holder = holder
                raise held
            self._connection.json("PUT", self.path("lease"))
            control = Control(self, live, patience_s)
            try:
                yield control
            finally:
                if land:
                    control._land_at_the_end()
                with contextlib.suppress(PlumblineError):
                    self._connection.json("DELETE", self.path("lease"))
        finally:
            live.close()

    def _who(self) -> str:
        session: models.Session = self._connection.json("GET", "/api/v1/session")
        return session.get("name") or self._connection.operator


class Control:
    """Commands of whoever holds control; each returns the vehicle's answer, or raises `Rejected` with its reason.

    Each carries the flight time of the newest message that was there, so that the vehicle refuses what was asked on an old
    picture.
    """

    def __init__(self, vehicle: Vehicle, live: Live, patience_s: float | None) -> None:
        self.vehicle = vehicle
        #: Its live telemetry.
        self.live = live
        self._thread = threading.current_thread()
        self._patience_s = patience_s
        self._used = time.monotonic()
        self._waiting = 0
        self._schedule_before: int | None = None
        live.attend(self._attended)

    def _attended(self) -> bool:
        idle = time.monotonic() - self._used
        patient = self._patience_s is None or self._waiting > 0 or idle < self._patience_s
        return self._thread.is_alive() and patient

    def _send(self, method: str, route: str, body: object = None) -> models.Answer:
        self._used = time.monotonic()
        connection, path = self.vehicle._connection, self.vehicle.path(route)
        answer: models.Answer = connection.json(method, path, body, seen_us=self.live.newest_us)
        return answer

    def arm(self) -> models.Answer:
        """Arms; refused with the checks that fail."""
        return self._send("POST", "arm")

    def disarm(self) -> models.Answer:
        """Disarms; refused in flight, unless the rig catches the vehicle: there the motors stop and it falls into its
        strings."""
        return self._send("POST", "disarm")

    def cut(self) -> models.Answer:
        """Cuts the motors at once, latched: the vehicle falls."""
        return self._send("POST", "cut")

    def release_cut(self) -> models.Answer:
        """Frees the latch of a cut, at rest and disarmed."""
        return self._send("POST", "release-cut")

    def mode(self, mode: str) -> models.Answer:
        """`stabilise`, `altitude_hold`, `hold` or `land`."""
        return self._send("POST", "mode", {"mode": mode})

    def setpoint(
        self,
        *,
        altitude_m: float | None = None,
        x_m: float | None = None,
        y_m: float | None = None,
        roll_rad: float | None = None,
        pitch_rad: float | None = None,
        yaw_rad: float | None = None,
        throttle: float | None = None,
    ) -> models.Answer:
        """Changes the setpoint (world ENU, body FLU; `throttle` is thrust over weight); what is absent stays."""
        asked = {
            "altitude_m": altitude_m,
            "x_m": x_m,
            "y_m": y_m,
            "roll_rad": roll_rad,
            "pitch_rad": pitch_rad,
            "yaw_rad": yaw_rad,
            "throttle": throttle,
        }
        return self._send("POST", "setpoint", {name: value for name, value in asked.items() if value is not None})

    def trajectory(self, trajectory: models.Trajectory) -> models.Answer:
        """Flies a path from where the setpoint is."""
        return self._send("POST", "trajectory", trajectory)

    def stop_trajectory(self) -> models.Answer:
        """Stops it."""
        return self._send("DELETE", "trajectory")

    def attack(self, attacks: Sequence[models.PlannedAttack]) -> models.Answer:
        """Uploads a schedule of attacks whole; `start_s` counts from its acceptance, on the vehicle's flight time."""
        before = self.live.latest(v1.AttackState)
        answer = self._send("PUT", "attacks", {"attacks": list(attacks)})
        self._schedule_before = before.schedule_id if before is not None else None
        return answer

    def wait_attacked(self, timeout_s: float = 60.0) -> v1.AttackState:
        """Until every attack of the schedule uploaded last has ended; those of an earlier flight do not count."""

        def ended(state: v1.AttackState) -> bool:
            known = state.schedule_id != self._schedule_before
            return known and bool(state.attacks) and all(a.HasField("ended_time_us") for a in state.attacks)

        return self.wait(v1.AttackState, ended, timeout_s)

    def abort_attacks(self) -> models.Answer:
        """Ends what attacks."""
        return self._send("DELETE", "attacks")

    def estimator(self, estimator: str) -> models.Answer:
        """Puts an estimator in the loop."""
        return self._send("POST", "estimator", {"estimator": estimator})

    def decoder(self, decoder: str) -> models.Answer:
        """Chooses the secure estimator's decoder."""
        return self._send("POST", "decoder", {"decoder": decoder})

    def gains(self, design: models.Design) -> models.Answer:
        """Pushes a design; the vehicle solves, certifies, and applies it or refuses with loop, margin and numbers."""
        return self._send("PUT", "gains", design)

    def revert_gains(self, revision: int | None = None) -> models.Answer:
        """Pushes an earlier design again, the last accepted one where none is named."""
        return self._send("POST", "gains/revert", {} if revision is None else {"revision": revision})

    def record(self, on: bool = True) -> models.Answer:
        """Begins or ends a recording by hand; arming begins one by itself."""
        return self._send("POST", "recording", {"on": on})

    def replay(self, speed: float, step: int = 0) -> models.Answer:
        """Speed of a replay, times real time; 0 stands still, or goes so many ticks on."""
        return self._send("POST", "replay", {"speed": speed, "step": step})

    def simulator(self, *, battery: bool = False, reset: bool = False) -> models.Answer:
        """What only a simulated vehicle can be given: a new battery, or, disarmed, its place at the beginning."""
        return self._send("POST", "simulator", {"battery": battery, "reset": reset})

    def wait(
        self, message: type[M], condition: Callable[[M], bool], timeout_s: float = 30.0, instance: int | None = None
    ) -> M:
        """As `Live.wait`; whoever waits is attending."""
        self._waiting += 1
        try:
            return self.live.wait(message, condition, timeout_s, instance)
        finally:
            self._waiting -= 1
            self._used = time.monotonic()

    def status(self) -> v1.Status:
        """The newest status."""
        return self.wait(v1.Status, lambda _: True, 10.0)

    def estimate(self) -> v1.Estimate:
        """The newest estimate of the estimator in the loop."""
        return self.wait(v1.Estimate, lambda _: True, 10.0, self.status().estimator_in_loop)

    def wait_ready(self, timeout_s: float = 30.0) -> v1.Status:
        """Until nothing hinders arming; says what does when time is over."""
        try:
            return self.wait(v1.Status, lambda status: status.ready_to_arm, timeout_s)
        except TimedOut as error:
            failing = [f"{check.name}: {check.reason}" for check in self.status().checks if not check.passed]
            raise TimedOut(f"not ready to arm after {timeout_s} s: {'; '.join(failing)}") from error

    def wait_altitude(
        self, altitude_m: float, within_m: float = 0.05, for_s: float = 1.0, timeout_s: float = 30.0
    ) -> v1.Estimate:
        """Until the estimate in the loop has been so near to an altitude for so long."""
        since: int | None = None

        def settled(estimate: v1.Estimate) -> bool:
            nonlocal since
            near = abs(estimate.position_enu_m.z - altitude_m) <= within_m
            since = (estimate.time_us if since is None else since) if near else None
            return since is not None and estimate.time_us - since >= for_s * 1e6

        return self.wait(v1.Estimate, settled, timeout_s, self.status().estimator_in_loop)

    def wait_disarmed(self, timeout_s: float = LANDING_S) -> v1.Status:
        """Until the motors stand."""
        return self.wait(v1.Status, lambda status: not status.armed, timeout_s)

    def land(self, timeout_s: float = LANDING_S) -> v1.Status:
        """Lands and waits until the motors stand."""
        self.mode("land")
        return self.wait_disarmed(timeout_s)

    @property
    def flight_id(self) -> str | None:
        """Id of the flight being recorded, or recorded last while this link was open."""
        mark = self.live.latest(v1.FlightMark)
        return mark.flight_id if mark is not None and mark.flight_id else self.status().flight_id or None

    def _land_at_the_end(self) -> None:
        # What went wrong in the block is what the caller shall see, not what went wrong afterwards.
        with contextlib.suppress(PlumblineError):
            status = self.live.latest(v1.Status)
            if status is not None and status.armed:
                self.land()
