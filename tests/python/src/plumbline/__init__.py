"""Flies, records and studies a lab quadrotor through Plumbline's ground station.

    import plumbline

    with plumbline.connect() as ground, ground.vehicle().control() as fly:
        fly.wait_ready()
        fly.arm()
        fly.mode("altitude_hold")
        fly.setpoint(altitude_m=0.8)
        fly.wait_altitude(0.8)

SI units, world ENU, body FLU, radians. The same script flies the simulator and the vehicle.
"""

from . import errors, v1
from .errors import (
    Conflict,
    Forbidden,
    Held,
    Invalid,
    NotAttended,
    NotFound,
    PlumblineError,
    Problem,
    Rejected,
    SignInNeeded,
    Throttled,
    TimedOut,
    Unanswered,
    Unavailable,
    Unreachable,
)
from .experiments import Experiment, ExperimentFailed
from .flights import Flight, Flights
from .ground import Ground, connect
from .live import Live, Received, Subscription
from .trust import Untrusted
from .vehicle import Control, Vehicle

__all__ = [
    "Conflict",
    "Control",
    "Experiment",
    "ExperimentFailed",
    "Flight",
    "Flights",
    "Forbidden",
    "Ground",
    "Held",
    "Invalid",
    "Live",
    "NotAttended",
    "NotFound",
    "PlumblineError",
    "Problem",
    "Received",
    "Rejected",
    "SignInNeeded",
    "Subscription",
    "Throttled",
    "TimedOut",
    "Unanswered",
    "Unavailable",
    "Unreachable",
    "Untrusted",
    "Vehicle",
    "connect",
    "errors",
    "v1",
]
