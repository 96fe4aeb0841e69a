"""Blocking transport: sends requests, tries again what may be, and turns refusals into exceptions."""

# Derived from `_aio_transport.py` by `generate.py`.
# ruff: noqa: I001, UP028
# fmt: off

from __future__ import annotations

import time
import os
import random
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

import httpx
from typing_extensions import Self

from ._reply import Event, Events, Reply, Request, request
from .errors import Problem, Unreachable, refusal

DEFAULT_URL = "http://127.0.0.1:8080"

# Requests that were not begun are repeated whatever they do: the service says so by these.
NOT_BEGUN = (429, 503)
# Answers of proxies for a service that starts again.
OF_PROXIES = (502, 504)
# Refusals of 503 that the same request would meet again.
FINAL = ("took-too-long",)
# Seconds of the first pause between tries, and of the longest one.
FIRST_PAUSE, LONGEST_PAUSE = 0.2, 30.0
# Bytes of a file that are read at once.
CHUNK = 1 << 20


class Transport:
    """Blocking connection to a service.

    Parameters
    ----------
    url : str, optional
        Address of the service. Default: `SHAPELEX_SERVER`, else `http://127.0.0.1:8080`.
    key : str, optional
        Key or token. Default: `SHAPELEX_KEY`, else none.
    tries : int
        Times that a request is sent at most, with growing pauses: when the service is busy (429, 503) or cannot be
        reached, and, of requests that change nothing or have an `Idempotency-Key`, when the answer got lost.
    timeout : float
        Seconds without a byte of the answer.
    http : httpx.Client, optional
        Client to send with, such as one with a proxy or certificates; it is not closed.
    """

    def __init__(
        self,
        url: str | None = None,
        key: str | None = None,
        *,
        tries: int = 6,
        timeout: float = 300.0,
        http: httpx.Client | None = None,
    ) -> None:
        self.url = (url or os.environ.get("SHAPELEX_SERVER") or DEFAULT_URL).rstrip("/")
        key = key or os.environ.get("SHAPELEX_KEY")
        self.tries = tries
        self._headers = {"Accept": "*/*"} | ({"Authorization": f"Bearer {key}"} if key else {})
        # On one machine, compression and proxies cost and bring nothing.
        near = urlsplit(self.url).hostname in ("127.0.0.1", "localhost", "::1")
        if near:
            self._headers["Accept-Encoding"] = "identity"
        limits = httpx.Timeout(timeout, connect=min(timeout, 10.0), pool=None)
        self._owned = http is None
        self._http = http or httpx.Client(timeout=limits, trust_env=not near)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connections."""
        if self._owned:
            self._http.close()

    def _send(self, method: str, path: str, **parts: Any) -> Reply[Any]:
        """Sends a request until it is answered, or its tries are used up."""
        wanted = request(method, path, **parts)
        for attempt in range(1, self.tries + 1):
            last = attempt == self.tries
            try:
                return self._try(wanted)
            except Problem as refused:
                if last or not is_passing(refused, wanted):
                    raise
                pause = refused.retry_after
            except httpx.TransportError as error:
                if last or not (wanted.repeatable or isinstance(error, NOT_SENT)):
                    raise Unreachable(f"{method} {self.url}{path}: {reason(error)}") from error
                pause = None
            time.sleep(pause_before(attempt, pause))
        raise Unreachable(f"{method} {self.url}{path}: expected at least one try, got {self.tries}")

    def _try(self, wanted: Request) -> Reply[Any]:
        """Sends a request once."""
        headers = self._headers | wanted.headers
        content: Any = wanted.content
        if isinstance(content, Path):
            headers["Content-Length"] = str(content.stat().st_size)
            content = self._file(content)
        query = httpx.QueryParams(tuple(wanted.query)) if wanted.query else None
        address = self.url + wanted.path
        response = self._http.request(wanted.method, address, params=query, headers=headers, content=content)
        if response.is_success or response.status_code == httpx.codes.NOT_MODIFIED:
            return Reply(response.status_code, response.headers, response.content)
        raise refusal(response.status_code, response.content, retry_after(response.headers))

    def _file(self, path: Path) -> Iterator[bytes]:
        """The bytes of a file, piece by piece."""
        with path.open("rb") as file:
            while piece := file.read(CHUNK):
                yield piece

    def _events(self, method: str, path: str, **parts: Any) -> Iterator[Event]:
        """The events of a stream, until the service ends it."""
        wanted, events = request(method, path, **parts), Events()
        headers = self._headers | wanted.headers | {"Accept": "text/event-stream"}
        address, query = self.url + wanted.path, httpx.QueryParams(tuple(wanted.query))
        with self._http.stream(method, address, params=query, headers=headers, timeout=None) as response:
            if not response.is_success:
                raise refusal(response.status_code, response.read(), retry_after(response.headers))
            for line in response.iter_lines():
                if event := events.add(line):
                    yield event


NOT_SENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)


def is_passing(refused: Problem, wanted: Request) -> bool:
    """Whether a refusal may pass, and the request may be sent again."""
    if refused.status in NOT_BEGUN:
        return refused.code not in FINAL
    return refused.status in OF_PROXIES and wanted.repeatable


def pause_before(attempt: int, asked: float | None) -> float:
    """Seconds before the next try: those that the service asks for, else twice as many each time, with some chance."""
    if asked is not None:
        return min(asked, LONGEST_PAUSE)
    return min(FIRST_PAUSE * 2.0 ** (attempt - 1), LONGEST_PAUSE) * (0.5 + random.random() / 2)


def retry_after(headers: Mapping[str, str]) -> float | None:
    """Seconds of the header `Retry-After`."""
    try:
        return max(float(headers["retry-after"]), 0.0)
    except (KeyError, ValueError):
        return None


def reason(error: Exception) -> str:
    """Text of an exception, or its name where it has none."""
    return str(error) or type(error).__name__
