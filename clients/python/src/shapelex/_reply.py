"""Requests and answers as values: what both halves of the client share, without any network."""

from __future__ import annotations

import io
import json
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast
from urllib.parse import quote

import numpy as np

from .errors import MissingPackage, ShapelexError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from numpy.typing import NDArray

T = TypeVar("T")

ARROW = "application/vnd.apache.arrow.stream"
PARQUET = "application/vnd.apache.parquet"
NPY = "application/x-npy"
NPZ = "application/x-npz"
NDJSON = "application/x-ndjson"
JSON = "application/json"
OCTETS = "application/octet-stream"


def imported(name: str, use: str) -> Any:
    """A module of an optional package.

    Raises
    ------
    MissingPackage
        Where it is not installed, with its name.
    """
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = {"sklearn": "scikit-learn"}.get(name.split(".")[0], name.split(".")[0])
        raise MissingPackage(f"{use} needs the package {package}: pip install {package}") from error


def quoted(text: str) -> str:
    """A text as one part of a path."""
    return quote(str(text), safe="")


@dataclass(frozen=True)
class Event:
    """An event of a stream.

    Attributes
    ----------
    kind : str
        Its kind, such as `progress`.
    data : Any
        Its content.
    id : str or None
        Number to resume from, as `last_event_id`.
    """

    kind: str
    data: Any
    id: str | None = None


class Events:
    """Events of lines of `text/event-stream`, one line at a time."""

    def __init__(self) -> None:
        self.fields: dict[str, str] = {}

    def add(self, line: str) -> Event | None:
        """Takes a line; the event that it ends, if it ends one."""
        if line:
            name, _, value = line.partition(":")
            value = value.removeprefix(" ")
            if name in ("event", "id"):
                self.fields[name] = value
            elif name == "data":
                self.fields["data"] = f"{self.fields['data']}\n{value}" if "data" in self.fields else value
            return None
        fields, self.fields = self.fields, {}
        if "data" not in fields:
            return None
        try:
            data = json.loads(fields["data"])
        except ValueError:
            data = fields["data"]
        return Event(fields.get("event", "message"), data, fields.get("id"))


class Reply(Generic[T]):
    """A successful answer.

    Attributes
    ----------
    status : int
        Status of HTTP.
    headers : Mapping
        Headers, by names without regard to case.
    content : bytes
        The body.
    """

    def __init__(self, status: int, headers: Mapping[str, str], content: bytes) -> None:
        self.status, self.headers, self.content = status, headers, content

    def __repr__(self) -> str:
        return f"<Reply {self.status} {self.media_type or 'without a body'}, {len(self.content)} bytes>"

    @property
    def media_type(self) -> str:
        """Media type of the body, without parameters."""
        return self.headers.get("content-type", "").split(";")[0].strip()

    @property
    def text(self) -> str:
        """The body as text."""
        return self.content.decode()

    @property
    def warnings(self) -> list[str]:
        """Warnings of an answer of JSON."""
        document = json.loads(self.content) if self.media_type == JSON else {}
        return list(document.get("warnings", [])) if isinstance(document, dict) else []

    def json(self) -> T:
        """The body of JSON; None where there is no body."""
        return cast(T, json.loads(self.content) if self.content else None)

    def lines(self) -> Iterator[Any]:
        """The lines of NDJSON, read one after the other."""
        return (json.loads(line) for line in self.content.splitlines() if line.strip())

    def array(self) -> NDArray[Any]:
        """The array of a body of NPY."""
        return cast("NDArray[Any]", np.load(io.BytesIO(self.content), allow_pickle=False))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of a body of NPZ, by name."""
        with np.load(io.BytesIO(self.content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}

    def arrow(self) -> pa.Table:
        """The table of a body of Arrow or Parquet."""
        if self.media_type == PARQUET:
            return imported("pyarrow.parquet", "Parquet").read_table(io.BytesIO(self.content))
        return imported("pyarrow", "Arrow").ipc.open_stream(self.content).read_all()

    def frame(self) -> pd.DataFrame:
        """The table of a body of Arrow, Parquet, CSV or NDJSON as a frame of pandas."""
        pandas = imported("pandas", "a frame")
        if self.media_type == "text/csv":
            return cast("pd.DataFrame", pandas.read_csv(io.BytesIO(self.content)))
        if self.media_type == NDJSON:
            return cast("pd.DataFrame", pandas.json_normalize(list(self.lines())))
        return cast("pd.DataFrame", self.arrow().to_pandas())

    def save(self, path: str | Path) -> Path:
        """Writes the body to a file, and returns its path."""
        Path(path).write_bytes(self.content)
        return Path(path)


def pairs(query: Mapping[str, object]) -> list[tuple[str, str]]:
    """Parameters of a query as names and texts: lists repeat a name, maps are written with brackets."""
    found: list[tuple[str, str]] = []
    for name, value in query.items():
        if value is None:
            continue
        if isinstance(value, Mapping):
            found += [(f"{name}[{key}]", text) for key, text in pairs(dotted(value))]
        elif isinstance(value, (list, tuple, set)):
            found += [pair for entry in value for pair in pairs({name: entry})]
        elif isinstance(value, (bool, np.bool_)):
            found.append((name, "true" if value else "false"))
        else:
            found.append((name, str(value)))
    return found


def dotted(conditions: Mapping[str, object]) -> dict[str, object]:
    """Conditions with operators by dots: `{"age": {"gte": 30}}` as `{"age.gte": 30}`."""
    found: dict[str, object] = {}
    for name, value in conditions.items():
        if isinstance(value, Mapping):
            found |= {f"{name}.{operator}": bound for operator, bound in value.items()}
        else:
            found[name] = value
    return found


def plain(value: object) -> object:
    """Values of NumPy and paths as JSON has them."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"expected a value that JSON has, got {type(value).__name__}")


def encoded(document: object) -> bytes:
    """A document as JSON; arrays of NumPy are written as lists."""
    return json.dumps(document, default=plain, separators=(",", ":")).encode()


@dataclass
class Request:
    """A request that can be sent, and sent again.

    Attributes
    ----------
    method, path : str
        As sent; the path has no query.
    query : list of tuple
        Names and values.
    headers : dict
        Headers of this request.
    content : bytes or Path or None
        The body; a path is streamed from its file at every try.
    repeatable : bool
        Whether it may be sent again when its answer got lost.
    """

    method: str
    path: str
    query: list[tuple[str, str]] = field(default_factory=list)
    headers: dict[str, str] = field(default_factory=dict)
    content: bytes | Path | None = None
    repeatable: bool = False


def file_part(name: str, value: object) -> tuple[str, bytes, str]:
    """File name, bytes and media type of a part of a form."""
    if isinstance(value, Path):
        return value.name, value.read_bytes(), OCTETS
    if isinstance(value, bytes):
        return name, value, OCTETS
    return "", encoded(value), JSON


def form_body(form: Mapping[str, object]) -> tuple[bytes, str]:
    """A form (`multipart/form-data`) and its media type: documents first, then files."""
    boundary = secrets.token_hex(16)
    parts = [(name, *file_part(name, value)) for name, value in form.items() if value is not None]
    body = bytearray()
    for name, file_name, content, media_type in sorted(parts, key=lambda part: part[3] != JSON):
        shown = f'; filename="{quote(file_name)}"' if file_name else ""
        head = f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"{shown}\r\nContent-Type: {media_type}'
        body += f"{head}\r\n\r\n".encode() + content + b"\r\n"
    body += f"--{boundary}--\r\n".encode()
    return bytes(body), f"multipart/form-data; boundary={boundary}"


def request(
    method: str,
    path: str,
    *,
    query: Mapping[str, object] | None = None,
    headers: Mapping[str, object] | None = None,
    body: object = None,
    form: object = None,
    content_type: str | None = None,
    options: Mapping[str, object] | None = None,
    keyed: bool = False,
    repeatable: bool = False,
) -> Request:
    """The request of a call."""
    sent = {name: str(value) for name, value in (headers or {}).items() if value is not None}
    if keyed:
        sent.setdefault("Idempotency-Key", secrets.token_hex(16))
    given = [(name, json_or_text(value)) for name, value in (options or {}).items() if value is not None]
    content: bytes | Path | None = None
    if isinstance(form, Mapping):
        content, sent["Content-Type"] = form_body(form)
    elif body is not None or form is not None:
        value = body if body is not None else form
        raw = isinstance(value, (bytes, Path))
        content = value if isinstance(value, (bytes, Path)) else encoded(value)
        sent["Content-Type"] = content_type or (OCTETS if raw else JSON)
    return Request(method, path, pairs(query or {}) + given, sent, content, repeatable)


def json_or_text(value: object) -> str:
    """A value of a parameter: text as it is, anything else as JSON."""
    return value if isinstance(value, str) else encoded(value).decode()


def expect(condition: bool, sentence: str) -> None:
    """Refuses input of the client itself.

    Raises
    ------
    ShapelexError
        With the sentence.
    """
    if not condition:
        raise ShapelexError(sentence)
