"""One connection to a ground: requests, answers, and the session that signs them."""

from __future__ import annotations

import contextlib
import ssl
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import httpx

from .errors import Unreachable, problem

COOKIE = "plumbline_session"
OPERATOR = "X-Plumbline-Operator"
#: Flight time of the newest message that the script had when it asked, µs.
SEEN = "X-Plumbline-Seen"

#: Field, then name and content, of each file of a form.
Files = Sequence[tuple[str, tuple[str, IO[bytes]]]]
Query = Mapping[str, str | int | float | bool | None]


class Connection:
    """Speaks HTTP with one ground as one operator."""

    def __init__(self, url: str, operator: str, tls: ssl.SSLContext | bool, timeout_s: float) -> None:
        self.url = url.rstrip("/")
        self.operator = operator
        self.tls = tls
        # A ground is in the laboratory: no proxy of the surroundings is asked.
        self.client = httpx.Client(
            base_url=self.url,
            headers={OPERATOR: operator, "Origin": self.url},
            verify=tls,
            timeout=timeout_s,
            trust_env=False,
        )

    @property
    def token(self) -> str | None:
        """The session, for `connect(token=…)` elsewhere; none where nobody signs in."""
        return self.client.cookies.get(COOKIE)

    def request(
        self,
        method: str,
        path: str,
        body: object = None,
        query: Query | None = None,
        seen_us: int | None = None,
        files: Files | None = None,
    ) -> httpx.Response:
        """Asks, and raises what the ground refuses. A recording that is sent may take its time."""
        headers = {} if seen_us is None else {SEEN: str(seen_us)}
        timeout = httpx.USE_CLIENT_DEFAULT if files is None else None
        try:
            response = self.client.request(
                method, path, json=body, params=_given(query), headers=headers, files=files, timeout=timeout
            )
        except httpx.TransportError as error:
            raise Unreachable(f"{self.url}: {error}") from error
        if response.status_code >= 400:
            raise problem(response)
        return response

    def json(
        self,
        method: str,
        path: str,
        body: object = None,
        query: Query | None = None,
        seen_us: int | None = None,
        files: Files | None = None,
    ) -> Any:
        """The same, for an answer in JSON."""
        response = self.request(method, path, body, query, seen_us, files)
        try:
            return response.json()
        except ValueError as error:
            raise Unreachable(f"{self.url} answers, but is no ground: {error}") from error

    @contextlib.contextmanager
    def download(self, path: str, query: Query | None = None) -> Iterator[httpx.Response]:
        """An answer that is read as it comes."""
        try:
            with self.client.stream("GET", path, params=_given(query)) as response:
                if response.status_code >= 400:
                    response.read()
                    raise problem(response)
                yield response
        except httpx.TransportError as error:
            raise Unreachable(f"{self.url}: {error}") from error

    def save(self, path: str, target: str | Path, query: Query | None = None) -> Path:
        """Writes an answer to a file, which has its name only once it is whole."""
        target = Path(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        unfinished = target.with_name(target.name + ".unfinished")
        try:
            with self.download(path, query) as response, unfinished.open("wb") as file:
                for piece in response.iter_bytes():
                    file.write(piece)
            unfinished.replace(target)
        finally:
            unfinished.unlink(missing_ok=True)
        return target

    def close(self) -> None:
        """Lets go of its sockets."""
        self.client.close()


def _given(query: Query | None) -> dict[str, str | int | float | bool] | None:
    if query is None:
        return None
    return {name: value for name, value in query.items() if value is not None}
