"""What schemathesis does not know by itself: how NDJSON is written, headers that change the answer, and a count of
answers."""

import collections
import itertools
import json
import os

import schemathesis

# One of these comes with every third request, in turn; what the document says must hold all the same.
HEADERS = itertools.cycle(
    [
        ("Accept", "image/svg+xml"),
        ("Prefer", "wait=5"),
        ("If-None-Match", "*"),
        ("Accept", "text/csv, application/json;q=0.5"),
        ("Accept", "application/x-npy"),
        ("Accept-Encoding", "identity;q=0, *;q=0"),
        ("Accept", "text/html"),
        ("Prefer", 'wait="1", foo="a, b"; c'),
        ("Content-Encoding", "gzip"),
        ("Content-Type", "text/plain"),
        ("If-None-Match", 'W/"a", "b"'),
        ("X-Request-Id", "contract"),
    ]
)
TURN = itertools.cycle([False, False, True])
ANSWERS = collections.defaultdict(collections.Counter)


@schemathesis.serializer("application/x-ndjson")
def write_lines(ctx, value):
    """One document a line."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, str):
        return value.encode("utf-8", "surrogatepass")
    lines = value if isinstance(value, list) else [value, value]
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


@schemathesis.hook
def before_call(context, case, kwargs):
    """Adds a header that nobody drew; takes away a key that was drawn where there are none; keeps the key in use."""
    if os.environ.get("CONTRACT_OPEN"):
        for headers in [case.headers, kwargs.get("headers") or {}]:
            headers.pop("Authorization", None)
    key = (case.path_parameters or {}).get("key")
    if case.method == "DELETE" and key and key == os.environ.get("CONTRACT_KEY"):
        # Without this key, every later answer would be 401.
        case.path_parameters["key"] = "none"
    if next(TURN):
        name, value = next(HEADERS)
        case.headers[name] = value


@schemathesis.hook
def after_call(context, case, response):
    """Counts the answers of an operation by their status; `run.py` says which operations never succeeded."""
    ANSWERS[f"{case.method} {case.path}"][str(response.status_code)] += 1
    path = os.environ.get("CONTRACT_ANSWERS")
    if path and sum(ANSWERS[f"{case.method} {case.path}"].values()) % 5 == 1:
        with open(path, "w") as file:
            json.dump(ANSWERS, file)
