"""Experiments: plans of many flights, their results and reports."""

from __future__ import annotations

import io
import time
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from ._http import Connection
from .errors import PlumblineError, TimedOut
from .flights import Flight, _pandas

if TYPE_CHECKING:
    import pandas
    import polars

    from . import models

#: Flights of one answer.
PAGE = 1000
#: How often a running experiment is looked at, s.
LOOK_S = 0.5


class ExperimentFailed(PlumblineError):
    """A run ended before its end."""


class Experiment:
    """One experiment that the ground keeps."""

    def __init__(self, connection: Connection, state: models.State) -> None:
        self._connection = connection
        #: How it stood when last asked.
        self.state = state

    def __repr__(self) -> str:
        return f"Experiment({self.id!r}, {self.state['done']} of {self.state['flights']} flights)"

    @property
    def id(self) -> str:
        """Its id, by which the ground's folder of it is named as well."""
        return self.state["id"]

    def path(self, route: str = "") -> str:
        """Path of one of its routes."""
        return f"/api/v1/experiments/{quote(self.id, safe='')}" + (f"/{route}" if route else "")

    def results(self) -> models.Results:
        """What is there, condition by condition."""
        results: models.Results = self._connection.json("GET", self.path())
        self.state = results["state"]
        return results

    def start(self) -> Experiment:
        """Flies what is not there yet."""
        self.state = self._connection.json("POST", self.path("start"))
        return self

    def stop(self) -> Experiment:
        """Stops after the flights in the air; `start` goes on with it."""
        self.state = self._connection.json("POST", self.path("stop"))
        return self

    def wait(
        self, timeout_s: float | None = None, progress: Callable[[models.State], None] | None = None
    ) -> Experiment:
        """Until it is not being flown any more. Raises `ExperimentFailed` with the reason, or `TimedOut`."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            state = self.results()["state"]
            if progress is not None:
                progress(state)
            if not state["running"]:
                if state.get("error"):
                    raise ExperimentFailed(f"{self.id}: {state['error']}")
                return self
            if until is not None and time.monotonic() > until:
                raise TimedOut(f"{self.id}: {state['done']} of {state['flights']} flights after {timeout_s} s")
            time.sleep(LOOK_S)

    def flights(self, condition: int | None = None) -> Iterator[models.ExperimentFlight]:
        """Its flights, one by one."""
        at = 0
        while True:
            query = {"from": at, "count": PAGE, "condition": condition}
            page: models.ExperimentFlights = self._connection.json("GET", self.path("flights"), query=query)
            yield from page["flights"]
            at += len(page["flights"])
            if not page["flights"] or at >= page["total"]:
                return

    def parquet(self) -> bytes:
        """A row a flight, encoded."""
        return self._connection.request("GET", self.path("flights.parquet")).content

    def to_pandas(self) -> pandas.DataFrame:
        """A row a flight: factors, seed, measures; null where nothing was measured."""
        return _pandas(self.parquet())

    def to_polars(self) -> polars.DataFrame:
        """The same as a Polars frame."""
        import polars

        return polars.read_parquet(io.BytesIO(self.parquet()))

    def fly_again(self, index: int) -> Flight:
        """Flies one again from its seed, bit for bit, and records it."""
        opened: models.Opened = self._connection.json("POST", self.path(f"flights/{index}"))
        return Flight(self._connection, self._connection.json("GET", f"/api/v1/flights/{opened['flight']}"))

    def by_hand(self) -> models.ByHand:
        """Of one that an operator flies: the next flight, and what was said of those before. Raises `NotFound` of another."""
        told: models.ByHand = self._connection.json("GET", self.path("by-hand"))
        return told

    def say(self, index: int, flight: str | Flight, *, accepted: bool, reason: str = "") -> models.ByHand:
        """Accepts a flight of the plan, which is judged then, or says why it is void."""
        id = flight if isinstance(flight, str) else flight.id
        said = {"index": index, "flight": id, "accepted": accepted, "reason": reason}
        told: models.ByHand = self._connection.json("POST", self.path("by-hand"), said)
        return told

    def plan(self) -> str:
        """Its plan, TOML."""
        return self._connection.request("GET", self.path("plan.toml")).text

    def report(self, target: str | Path) -> Path:
        """Writes its report, one self-contained HTML file."""
        return self._connection.save(self.path("report.html"), target)

    def open_report(self) -> str:
        """Shows its report in the browser; returns the address."""
        url = f"{self._connection.url}{self.path('report.html')}"
        webbrowser.open(url)
        return url


def text_of(plan: str | Path) -> str:
    """A plan as its text, or the file that has it."""
    return plan.read_text() if isinstance(plan, Path) else plan
