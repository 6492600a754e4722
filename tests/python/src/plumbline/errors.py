"""What a ground refuses, as exceptions: one for each stable `code` of its `application/problem+json`."""

from __future__ import annotations

import contextlib
from typing import ClassVar

import httpx


class PlumblineError(Exception):
    """Anything that this package raises of its own accord."""


class Unreachable(PlumblineError):
    """There is no ground at the address, or the connection to it broke."""


class NotAttended(PlumblineError):
    """The live link is closed: the vehicle has no operator's sign of life any more."""


class TimedOut(PlumblineError):
    """What was waited for did not come."""


class Problem(PlumblineError):
    """The ground refused a request. `detail` is for people, `code` for programs."""

    code: ClassVar[str] = ""

    def __init__(self, detail: str, *, status: int = 0, code: str = "", request_id: str | None = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.status = status
        self.reported_code = code or self.code
        self.request_id = request_id
        self.holder: str | None = None
        self.command_id: int | None = None
        self.revision: int | None = None
        self.retry_after_s: float | None = None


class Invalid(Problem):
    """A path, query or body makes no sense; the detail has the offending value."""

    code = "invalid"


class NotFound(Problem):
    """There is no such thing."""

    code = "not_found"


class MethodNotAllowed(Problem):
    """The ground is of another version than this package."""

    code = "method_not_allowed"


class SignInNeeded(Problem):
    """Nobody is signed in, or name, password or code is wrong."""

    code = "sign_in"


class Forbidden(Problem):
    """The role may not, or the address is not one the ground serves."""

    code = "forbidden"


class Held(Problem):
    """Another operator, `holder`, holds control."""

    code = "held"


class Rejected(Problem):
    """The vehicle refused a command: `command_id`, and `revision` of gains."""

    code = "rejected"


class Conflict(Problem):
    """Not as things are: a flight that is being recorded, an experiment that runs."""

    code = "conflict"


class TooLarge(Problem):
    """The body is larger than the ground takes."""

    code = "too_large"


class RangeNotSatisfiable(Problem):
    """The range asked for lies beyond the end of the file."""

    code = "range_not_satisfiable"


class Late(Problem):
    """The rest of a request did not come in time."""

    code = "late"


class Throttled(Problem):
    """Too much at once; `retry_after_s` says when again."""

    code = "throttled"


class UpgradeRequired(Problem):
    """Only a WebSocket is served there."""

    code = "upgrade_required"


class Unavailable(Problem):
    """The vehicle is not connected, or the ground is busy or not ready."""

    code = "unavailable"


class Unanswered(Problem):
    """The vehicle did not acknowledge a command in time."""

    code = "unanswered"


class Internal(Problem):
    """The ground's own fault; its log has more, under `request_id`."""

    code = "internal"


BY_CODE: dict[str, type[Problem]] = {kind.code: kind for kind in Problem.__subclasses__()}


def problem(response: httpx.Response) -> Problem:
    """The exception for an answer that is none of 2xx; its body must have been read."""
    told: dict[str, object] = {}
    if response.headers.get("content-type", "").startswith("application/problem+json"):
        with contextlib.suppress(ValueError):
            body = response.json()
            told = body if isinstance(body, dict) else {}
    code = str(told.get("code", ""))
    detail = str(told.get("detail") or f"the ground answered {response.status_code}")
    request_id = response.headers.get("x-request-id")
    found = BY_CODE.get(code, Problem)(detail, status=response.status_code, code=code, request_id=request_id)
    holder, command_id, revision = told.get("holder"), told.get("command_id"), told.get("revision")
    found.holder = holder if isinstance(holder, str) else None
    found.command_id = command_id if isinstance(command_id, int) else None
    found.revision = revision if isinstance(revision, int) else None
    wait = response.headers.get("retry-after", "")
    found.retry_after_s = float(wait) if wait.isdigit() else None
    return found
