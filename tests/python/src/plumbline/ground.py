"""Connecting to a ground, and what is reached from there."""

from __future__ import annotations

import contextlib
import ssl
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, cast
from urllib.parse import urlsplit

from typing_extensions import Self

from ._http import COOKIE, Connection
from .errors import NotFound
from .experiments import Experiment, text_of
from .flights import Flight, Flights, flights, known
from .trust import from_file, pinned
from .vehicle import Vehicle

if TYPE_CHECKING:
    from . import models

LOCAL = "http://127.0.0.1:4747"


def connect(
    url: str = LOCAL,
    *,
    name: str | None = None,
    password: str | None = None,
    code: str = "",
    token: str | None = None,
    fingerprint: str | None = None,
    certificate: str | Path | None = None,
    operator: str = "python",
    timeout_s: float = 30.0,
) -> Ground:
    """Connects to a ground, and signs in where `name` and `password` are given (`code` of an authenticator) or by a `token`.

    A ground that makes its own certificate is trusted by the `fingerprint` that it prints at its start, or by its
    `certificate` file; otherwise https trusts what the system trusts. `operator` is the name in the lease where nobody
    signs in. Raises `Unreachable`, `Untrusted`, `SignInNeeded`.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.path not in ("", "/"):
        raise ValueError(f"{url!r} is no address of a ground: http://HOST:PORT or https://HOST:PORT")
    tls: ssl.SSLContext | bool = True
    if parts.scheme == "https":
        if fingerprint is not None:
            tls = pinned(parts.hostname, parts.port or 443, fingerprint, timeout_s)
        elif certificate is not None:
            tls = from_file(certificate)
        else:
            tls = ssl.create_default_context()
    elif fingerprint is not None or certificate is not None:
        raise ValueError(f"{url} is not served by TLS: there is no certificate to trust")
    connection = Connection(f"{parts.scheme}://{parts.netloc}", operator, tls, timeout_s)
    try:
        if token is not None:
            connection.client.cookies.set(COOKIE, token)
        if name is not None:
            connection.json("POST", "/api/v1/session", {"name": name, "password": password or "", "code": code})
        ground = Ground(connection)
        # Says at once whether somebody is there and lets us in.
        ground.info()
    except BaseException:
        connection.close()
        raise
    return ground


class Ground:
    """A ground that answers. Close it, or use it as a context."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Ground({self.url!r})"

    def close(self) -> None:
        """Lets go of its connections; the session stays for whoever has the token."""
        self._connection.close()

    @property
    def url(self) -> str:
        """Where it is."""
        return self._connection.url

    @property
    def token(self) -> str | None:
        """The session, for `connect(token=…)`. Whoever has it is you: keep it as you keep a password."""
        return self._connection.token

    def info(self) -> models.Ground:
        """What it is and how it fares."""
        info: models.Ground = self._connection.json("GET", "/api/v1/ground")
        return info

    def session(self) -> models.Session:
        """Who asks, and their role."""
        session: models.Session = self._connection.json("GET", "/api/v1/session")
        return session

    def sign_out(self) -> None:
        """Ends the session."""
        self._connection.request("DELETE", "/api/v1/session")

    def vehicles(self) -> list[models.Vehicle]:
        """Every vehicle seen."""
        vehicles: list[models.Vehicle] = self._connection.json("GET", "/api/v1/vehicles")
        return vehicles

    def vehicle(self, id: str | None = None) -> Vehicle:
        """The vehicle of this id, or the only one that is connected. Raises `NotFound`."""
        known = self.vehicles()
        if id is None:
            connected = [vehicle["id"] for vehicle in known if vehicle["connected"]]
            if len(connected) != 1:
                raise NotFound(f"connected are {', '.join(connected) or 'none'}: say which vehicle", status=404)
            return Vehicle(self._connection, connected[0])
        if all(vehicle["id"] != id for vehicle in known):
            names = ", ".join(vehicle["id"] for vehicle in known) or "none"
            raise NotFound(f"there is no vehicle {id!r}; known are {names}", status=404)
        return Vehicle(self._connection, id)

    def flights(
        self,
        search: str | None = None,
        *,
        vehicle: str | None = None,
        from_unix_us: int | None = None,
        to_unix_us: int | None = None,
        sort: str | None = None,
        descending: bool = True,
        limit: int | None = None,
    ) -> Flights:
        """Recorded flights, newest first: those with every word of `search`, all where no `limit` is given.

        `vehicle` is an id; `from_unix_us` and `to_unix_us` bound when they began, the second exclusively.
        """
        query: dict[str, str | int | None] = {
            "search": search,
            "vehicle": vehicle,
            "from_unix_us": from_unix_us,
            "to_unix_us": to_unix_us,
            "sort": sort,
            "descending": "true" if descending else "false",
        }
        return flights(self._connection, query, limit)

    def flight(self, id: str) -> Flight:
        """One of them. Raises `NotFound`."""
        return Flight(self._connection, cast("models.Flight", {"id": id})).refresh()

    def import_recording(self, path: str | Path) -> Flight:
        """Takes in a flight of Plumbline, a log of PX4, a recording of BROAD or RotorPy, or the folder of one of a Phantom 4.

        What another program recorded is flown through every estimator. One that is there already is answered as it is. Raises
        `Invalid` where it is no recording.
        """
        path = Path(path)
        paths = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
        with contextlib.ExitStack() as opened:
            names = [f"{path.name}/{file.name}" if path.is_dir() else file.name for file in paths]
            files = [("file", (name, opened.enter_context(file.open("rb")))) for name, file in zip(names, paths)]
            imported: models.Imported = self._connection.json("POST", "/api/v1/flights", files=files)
        return self.flight(imported["flight"])

    def archive(self, flights: Iterable[Flight | str], target: str | Path, format: str = "mcap") -> Path:
        """Writes the files of many flights as one tar, which `plumbline-ground archive` checks and restores; in another format it is no backup."""
        ids = [flight if isinstance(flight, str) else flight.id for flight in flights]
        return self._connection.save("/api/v1/archive", target, {"ids": ",".join(ids), "format": known(format)})

    def due(self) -> list[models.Due]:
        """Flights that the ground's retention will delete, and when; `Flight.label` keeps one."""
        due: list[models.Due] = self._connection.json("GET", "/api/v1/archive/due")
        return due

    def experiments(self) -> list[Experiment]:
        """Every experiment that is kept, newest first."""
        found: list[Experiment] = []
        while True:
            page: models.Experiments = self._connection.json("GET", "/api/v1/experiments", query={"offset": len(found)})
            found += [Experiment(self._connection, state) for state in page["experiments"]]
            if len(found) >= page.get("total", 0) or not page["experiments"]:
                return found

    def experiment(self, id: str) -> Experiment:
        """One of them. Raises `NotFound`."""
        found = Experiment(self._connection, cast("models.State", {"id": id}))
        found.results()
        return found

    def size(self, plan: str | Path) -> models.Size:
        """What a plan comes to: conditions, flights, expected time. Nothing is kept. Raises `Invalid` with its line."""
        size: models.Size = self._connection.json("POST", "/api/v1/experiments/size", {"plan": text_of(plan)})
        return size

    def run(self, plan: str | Path) -> Experiment:
        """Keeps a plan (TOML, or the file with it) and starts flying it; the same plan goes on where it was."""
        state: models.State = self._connection.json("POST", "/api/v1/experiments", {"plan": text_of(plan)})
        return Experiment(self._connection, state)
