"""Recorded flights: listed, fetched as frames, downloaded."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, overload
from urllib.parse import quote

from ._http import Connection
from .errors import TimedOut

if TYPE_CHECKING:
    import pandas
    import polars

    from . import models

#: Flights of one page.
PAGE = 1000
#: Suffixes of what a flight is served as.
FORMATS = {"mcap": "mcap", "csv": "csv", "parquet": "parquet", "mat": "mat", "ros2": "ros2.mcap", "foxglove": "foxglove.mcap"}
#: What no single cell of a table holds.
NESTED = ("counts", "steps", "attacks")


def known(format: str) -> str:
    """That format. Raises `ValueError` where there is no such one."""
    if format not in FORMATS:
        raise ValueError(f"format {format!r} is none of {', '.join(FORMATS)}")
    return format


class Flight:
    """One recorded flight."""

    def __init__(self, connection: Connection, info: models.Flight) -> None:
        self._connection = connection
        #: What the list says of it.
        self.info = info

    def __repr__(self) -> str:
        return f"Flight({self.id!r}, {self.info['duration_s']:.1f} s, {self.info['completeness']})"

    @property
    def id(self) -> str:
        """Its id."""
        return self.info["id"]

    def path(self, route: str = "") -> str:
        """Path of one of its routes."""
        return f"/api/v1/flights/{quote(self.id, safe='')}" + (f"/{route}" if route else "")

    def refresh(self) -> Flight:
        """What the ground says of it now."""
        self.info = self._connection.json("GET", self.path())
        return self

    def wait_complete(self, timeout_s: float = 30.0) -> Flight:
        """Until every message of it is on the ground. Raises `TimedOut`; a truncated flight will never be."""
        until = time.monotonic() + timeout_s
        while self.refresh().info["completeness"] != "complete":
            if time.monotonic() > until or self.info["completeness"] == "truncated":
                missing = self.info["missing"]
                raise TimedOut(f"{self.id} is {self.info['completeness']} after {timeout_s} s, {missing} messages missing")
            time.sleep(0.2)
        return self

    def parquet(
        self,
        columns: Iterable[str] | None = None,
        from_s: float | None = None,
        to_s: float | None = None,
        rate_hz: float | None = None,
    ) -> bytes:
        """Its table, encoded: a row for each control tick, at most `rate_hz` a second (100; 0 for all).

        `columns` are names, or their beginnings up to a dot: `["control", "height_2.sensed_m", "events"]`; residuals
        (`"residuals_9"`, of estimator 9) are there where they are named. Units stand in the metadata, under `units`.
        """
        query = {
            "columns": None if columns is None else ",".join(columns),
            "from_s": from_s,
            "to_s": to_s,
            "rate_hz": rate_hz,
        }
        return self._connection.request("GET", self.path("parquet"), query=query).content

    def to_pandas(
        self,
        columns: Iterable[str] | None = None,
        from_s: float | None = None,
        to_s: float | None = None,
        rate_hz: float | None = None,
    ) -> pandas.DataFrame:
        """The same as a pandas frame; units are in its `attrs["units"]`."""
        return _pandas(self.parquet(columns, from_s, to_s, rate_hz))

    def to_polars(
        self,
        columns: Iterable[str] | None = None,
        from_s: float | None = None,
        to_s: float | None = None,
        rate_hz: float | None = None,
    ) -> polars.DataFrame:
        """The same as a Polars frame."""
        import polars

        return polars.read_parquet(io.BytesIO(self.parquet(columns, from_s, to_s, rate_hz)))

    def download(self, target: str | Path = ".", format: str = "mcap") -> Path:
        """Writes it to a file or into a folder: `mcap` (as recorded), `csv`, `parquet`, `mat`, `ros2` or `foxglove`."""
        known(format)
        target = Path(target)
        if target.is_dir():
            target = target / f"{self.id}.{FORMATS[format]}"
        return self._connection.save(self.path(format), target)

    def label(self, name: str | None = None, notes: str | None = None) -> Flight:
        """Names and annotates it; what is absent stays."""
        asked = {key: value for key, value in (("name", name), ("notes", notes)) if value is not None}
        self.info = self._connection.json("PATCH", self.path(), asked)
        return self

    def delete(self) -> None:
        """Deletes it, for good."""
        self._connection.request("DELETE", self.path())


class Flights(Sequence[Flight]):
    """Flights in the order asked for."""

    def __init__(self, flights: Iterable[Flight]) -> None:
        self._flights = tuple(flights)

    def __len__(self) -> int:
        return len(self._flights)

    @overload
    def __getitem__(self, index: int) -> Flight: ...
    @overload
    def __getitem__(self, index: slice) -> Flights: ...
    def __getitem__(self, index: int | slice) -> Flight | Flights:
        return Flights(self._flights[index]) if isinstance(index, slice) else self._flights[index]

    def __repr__(self) -> str:
        return f"Flights({list(self._flights)!r})"

    def _rows(self) -> list[dict[str, object]]:
        return [{key: value for key, value in flight.info.items() if key not in NESTED} for flight in self._flights]

    def to_pandas(self) -> pandas.DataFrame:
        """A row a flight."""
        import pandas

        return pandas.DataFrame(self._rows())

    def to_polars(self) -> polars.DataFrame:
        """A row a flight."""
        import polars

        return polars.DataFrame(self._rows())


def flights(connection: Connection, asked: dict[str, str | int | None], limit: int | None) -> Flights:
    """Asks page after page."""
    found: list[Flight] = []
    while limit is None or len(found) < limit:
        count = PAGE if limit is None else min(PAGE, limit - len(found))
        query = {**asked, "offset": len(found), "limit": count}
        page: models.Flights = connection.json("GET", "/api/v1/flights", query=query)
        found += [Flight(connection, info) for info in page["flights"]]
        if len(found) >= page["total"] or not page["flights"]:
            break
    return Flights(found)


def _pandas(table: bytes) -> pandas.DataFrame:
    import pyarrow.parquet

    read = pyarrow.parquet.read_table(io.BytesIO(table))
    frame: pandas.DataFrame = read.to_pandas()
    units = (read.schema.metadata or {}).get(b"units")
    if units is not None:
        frame.attrs["units"] = json.loads(units)
    return frame
