"""Exceptions: refusals of the service in its own words, and services that cannot be reached."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any


class ShapelexError(Exception):
    """Any failure of the client."""


class Unreachable(ShapelexError):
    """No answer: no service at the address, or a connection that broke after all tries. The reason is `__cause__`."""


class MissingPackage(ShapelexError, ImportError):
    """An optional package that a function needs."""


@dataclass(frozen=True)
class Fault:
    """A single fault of an input.

    Attributes
    ----------
    detail : str
        The fault, with the numbers of the input.
    pointer : str or None
        JSON pointer (RFC 6901) into the body, or into the line of a stream.
    parameter : str or None
        Name of a parameter of the query or the path.
    index : int or None
        Position of the shape in the request, from 0.
    line : int or None
        Line of a stream or file, from 1.
    place : dict or None
        Place in a file of another program: `entry`, `line`, `byte`, `tag`, `item`.
    """

    detail: str
    pointer: str | None = None
    parameter: str | None = None
    index: int | None = None
    line: int | None = None
    place: dict[str, Any] | None = None

    @classmethod
    def of(cls, document: dict[str, Any]) -> Fault:
        """The fault of an entry of `errors`."""
        known = ("pointer", "parameter", "index", "line", "place")
        return cls(document.get("detail", ""), **{name: document.get(name) for name in known})

    def __str__(self) -> str:
        where = self.pointer or self.parameter or ""
        shape = "" if self.index is None else f" (shape {self.index})"
        line = "" if self.line is None else f" (line {self.line})"
        return f"{where}{shape}{line}: {self.detail}".lstrip(": ")


@dataclass(eq=False)
class Problem(ShapelexError):
    """A refusal: a problem document (RFC 9457) of the service.

    Attributes
    ----------
    type : str
        Stable URI of the problem type, `urn:shapelex:problem:` and the code.
    code : str
        Last part of `type`, such as `invalid-input`.
    title : str
        The same for every occurrence of the type.
    status : int
        Status of HTTP.
    detail : str
        What happened and what to do, with the numbers.
    faults : list of Fault
        All faults of the input, at most 100.
    request_id : str or None
        Id of the request, as in the log of the service.
    retry_after : float or None
        Seconds after which the service asks to try again.
    """

    type: str
    code: str
    title: str
    status: int
    detail: str
    faults: list[Fault] = field(default_factory=list)
    request_id: str | None = None
    retry_after: float | None = None

    @property
    def pointer(self) -> str | None:
        """JSON pointer of the first fault that has one."""
        return next((fault.pointer for fault in self.faults if fault.pointer is not None), None)

    @property
    def index(self) -> int | None:
        """Position of the first shape with a fault, from 0."""
        return next((fault.index for fault in self.faults if fault.index is not None), None)

    @property
    def cause(self) -> str:
        """The sentence of the first fault, or of the whole refusal where no fault is named."""
        return self.faults[0].detail if self.faults else self.detail

    def __str__(self) -> str:
        shown = [f"\n  {fault}" for fault in self.faults[:5]]
        more = f"\n  and {len(self.faults) - 5} more" if len(self.faults) > 5 else ""
        return f"{self.detail} [{self.code}, {self.status}]{''.join(shown)}{more}"

    def __reduce__(self) -> tuple[Any, ...]:
        values = (self.type, self.code, self.title, self.status, self.detail, self.faults, self.request_id)
        return (self.__class__, (*values, self.retry_after))


class InvalidInput(Problem, ValueError):
    """The input is refused (400, 406, 413, 415, 422); `faults` has the places. It is a `ValueError` too."""


class AccessDenied(Problem):
    """No key or token, or one without the role (401, 403)."""


class NotFound(Problem):
    """No such cohort, shape, job or dictionary (404, 410)."""


class Conflict(Problem):
    """A name or an id is taken, or a version has changed (409, 412)."""


class Busy(Problem):
    """The service asks to come back later (429, 503), after all tries of the client."""


class JobFailed(Problem):
    """A job failed: the problem that it keeps, with the status of a request with the same fault."""


class JobCancelled(ShapelexError):
    """A job was cancelled before it ended."""


KINDS: dict[int, type[Problem]] = {
    **dict.fromkeys((400, 406, 413, 415, 422), InvalidInput),
    **dict.fromkeys((401, 403), AccessDenied),
    **dict.fromkeys((404, 410), NotFound),
    **dict.fromkeys((409, 412), Conflict),
    **dict.fromkeys((429, 503), Busy),
}


def problem(document: dict[str, Any], kind: type[Problem] | None = None, retry_after: float | None = None) -> Problem:
    """The exception of a problem document."""
    status = int(document.get("status", 0))
    return (kind or KINDS.get(status, Problem))(
        type=document.get("type", "about:blank"),
        code=document.get("code", ""),
        title=document.get("title", ""),
        status=status,
        detail=document.get("detail", ""),
        faults=[Fault.of(entry) for entry in document.get("errors", [])],
        request_id=document.get("request_id"),
        retry_after=retry_after,
    )


def refusal(status: int, content: bytes, retry_after: float | None = None) -> Problem:
    """The exception of a refusal; what is no problem document, as of a proxy, is told by its beginning."""
    try:
        document = json.loads(content)
    except ValueError:
        document = None
    if not isinstance(document, dict) or "code" not in document:
        text = content[:200].decode("utf-8", "replace").strip() or "an answer without a body"
        document = {"detail": f"expected a problem document, got {text}", "title": "No problem document"}
    return problem({**document, "status": status}, retry_after=retry_after)
