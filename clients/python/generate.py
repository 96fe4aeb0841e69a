#!/usr/bin/env python3
"""Writes the generated part of the client.

    python clients/python/generate.py            writes the files
    python clients/python/generate.py --check    ends with 1 where a committed file differs

`src/shapelex/_generated/types.py` has a type for every schema of `openapi/openapi.json`, `_generated/async_calls.py` a
call for every operation. The blocking halves are derived from the asynchronous ones word by word:
`_generated/calls.py`, `_sync.py` from `_aio.py`, and `_sync_transport.py` from `_aio_transport.py`. Nothing but
Python's library is needed.
"""

from __future__ import annotations

import argparse
import json
import keyword
import pathlib
import re
import sys
import textwrap
from typing import Any

HERE = pathlib.Path(__file__).resolve().parent
DOCUMENT = HERE.parent.parent / "openapi" / "openapi.json"
SOURCE = HERE / "src" / "shapelex"

WIDTH = 116
OFF = "# fmt: off\n"
MAIN_PARTS = ("get", "post", "put", "patch", "delete")
JSON = "application/json"
STREAM = "text/event-stream"

SCALARS = {"string": "str", "number": "float", "integer": "int", "boolean": "bool", "null": "None"}

# Words of the asynchronous half, and those of the blocking one.
REPLACED = [
    (r"\basync def\b", "def"),
    (r"\basync with\b", "with"),
    (r"\basync for\b", "for"),
    (r"\bawait ", ""),
    (r"\basyncio\.sleep\b", "time.sleep"),
    (r"\bimport asyncio\b", "import time"),
    (r"\bAwaitable, ", ""),
    (r"\bAwaitable\[(Reply\[\w+\])\]", r"\1"),
    (r"\bAsyncIterator\b", "Iterator"),
    (r"\bAsyncIterable\b", "Iterable"),
    (r"\bAsync(?=[A-Z])", ""),
    (r"\b__aenter__\b", "__enter__"),
    (r"\b__aexit__\b", "__exit__"),
    (r"\baclose\b", "close"),
    (r"\baread\b", "read"),
    (r"\baiter_lines\b", "iter_lines"),
    (r"\b_aio_transport\b", "_sync_transport"),
    (r"\basync_calls\b", "calls"),
    (r"\bAsynchronous\b", "Blocking"),
    (r"\basynchronous\b", "blocking"),
]


def wrapped(text: str, indent: int, first: str = "") -> list[str]:
    """Lines of a text within the width, behind so many spaces; paragraphs are kept."""
    lines: list[str] = []
    for paragraph in text.replace("\\", "\\\\").split("\n\n"):
        space = " " * indent
        filled = textwrap.wrap(
            first + " ".join(paragraph.split()),
            WIDTH - 2,
            initial_indent=space,
            subsequent_indent=space,
            break_long_words=False,
            break_on_hyphens=False,
        )
        lines += ([""] if lines else []) + filled
        first = ""
    return lines


def docstring(parts: list[str], indent: int) -> list[str]:
    """A docstring of ready lines, the first of which is its summary."""
    space = " " * indent
    body = [*parts]
    body[0] = f'{space}"""{body[0].strip()}'
    if len(body) == 1 and len(body[0]) + 3 <= WIDTH:
        return [body[0] + '"""']
    return [*body, f'{space}"""']


def identifier(name: str) -> str:
    """A name of the document as one of Python: `Idempotency-Key` as `idempotency_key`, `return` as `return_`."""
    plain = re.sub(r"\W", "_", name).lower() if "-" in name else name
    return f"{plain}_" if keyword.iskeyword(plain) else plain


def union(parts: list[str]) -> str:
    """Types joined by `|`, each once, `None` last."""
    kept = list(dict.fromkeys(word for part in parts for word in [part] if word != "None"))
    return " | ".join([*kept, *(["None"] if "None" in parts else [])])


class Types:
    """Types of Python for the schemas of the document.

    Parameters
    ----------
    schemas : dict
        `components.schemas` of the document.
    """

    def __init__(self, schemas: dict[str, Any]) -> None:
        self.schemas = schemas
        self.written: dict[str, list[str]] = {}

    def named(self, reference: str) -> str:
        return reference.rsplit("/", 1)[1]

    def flat(self, schema: dict[str, Any]) -> dict[str, Any]:
        """An `allOf` of objects as one object."""
        if "$ref" in schema:
            return self.flat(self.schemas[self.named(schema["$ref"])])
        if "allOf" not in schema:
            return schema
        merged: dict[str, Any] = {"type": "object", "properties": {}, "required": []}
        for part in map(self.flat, schema["allOf"]):
            if "properties" not in part:
                sys.exit(f"expected objects in allOf, got {part}")
            merged["properties"] |= part["properties"]
            merged["required"] += part.get("required", [])
        return merged

    def of(self, schema: dict[str, Any], name: str, prefix: str = "") -> str:
        """The type of a schema; objects within it are declared by `name`. `prefix` stands before declared names."""
        if "$ref" in schema:
            return prefix + self.named(schema["$ref"])
        if "const" in schema:
            return f"Literal[{json.dumps(schema['const'])}]"
        if "enum" in schema:
            return f"Literal[{', '.join(json.dumps(value) for value in schema['enum'])}]"
        for key in ("oneOf", "anyOf"):
            if key in schema:
                return union([self.of(part, name, prefix) for part in schema[key]])
        if "allOf" in schema or "properties" in schema:
            self.declare(name, schema)
            return prefix + name
        kinds = schema.get("type", [])
        return (
            union([self.simple(kind, schema, name, prefix) for kind in ([kinds] if isinstance(kinds, str) else kinds)])
            or "Any"
        )

    def simple(self, kind: str, schema: dict[str, Any], name: str, prefix: str) -> str:
        if kind == "array":
            return f"list[{self.of(schema.get('items', {}), name + 'Item', prefix)}]"
        if kind == "object":
            values = schema.get("additionalProperties")
            return f"dict[str, {self.of(values, name + 'Value', prefix) if isinstance(values, dict) else 'Any'}]"
        return "bytes | Path" if schema.get("format") == "binary" else SCALARS[kind]

    def declare(self, name: str, schema: dict[str, Any]) -> None:
        """Writes down the declaration of a schema under a name."""
        flat, text = self.flat(schema), schema.get("description", "")
        if "properties" not in flat:
            self.written[name] = self.alias(name, self.of(flat, name), text)
            return
        required = set(flat.get("required", []))
        fields: dict[str, str] = {}
        for field, inner in flat["properties"].items():
            camel = "".join(part.capitalize() for part in field.split("_"))
            kind = self.of(inner, f"{name}{camel}")
            fields[field] = kind if field in required else f"NotRequired[{kind}]"
        self.written[name] = self.typed_dict(name, fields, text or name)

    def alias(self, name: str, kind: str, text: str) -> list[str]:
        quoted = kind.replace('"', "'")
        line = f'{name}: TypeAlias = "{quoted}"'
        if len(line) > WIDTH:
            words = quoted.split(" | ") if " | " in quoted else quoted.split(", ")
            joint = " | " if " | " in quoted else ", "
            pieces = [word + joint for word in words[:-1]] + words[-1:]
            line = "\n".join([f"{name}: TypeAlias = (", *(f'    "{piece}"' for piece in pieces), ")"])
        return [line, *docstring(wrapped(text, 0), 0)] if text else [line]

    def typed_dict(self, name: str, fields: dict[str, str], text: str) -> list[str]:
        if any(keyword.iskeyword(field) or not field.isidentifier() for field in fields):
            rows = [f'        "{field}": "{kind.replace(chr(34), chr(39))}",' for field, kind in fields.items()]
            declared = [f"{name} = TypedDict(", f'    "{name}",', "    {", *rows, "    },", ")"]
            return [*declared, *docstring(wrapped(text, 0), 0)]
        rows = [f"    {field}: {kind}" for field, kind in fields.items()]
        return [f"class {name}(TypedDict):", *docstring(wrapped(text, 4), 4), *([""] if rows else []), *rows]


def types_file(types: Types) -> str:
    """The file of all types."""
    for name, schema in types.schemas.items():
        types.declare(name, schema)
    head = [
        '"""Types of the bodies and answers of the service. Generated by `generate.py` from `openapi/openapi.json`."""',
        "",
        OFF.strip(),
        "",
        "from __future__ import annotations",
        "",
        "from pathlib import Path",
        "from typing import Any, Literal, TypeAlias",
        "",
        "from typing_extensions import NotRequired, TypedDict",
    ]
    blocks = ["\n".join(lines) for _, lines in sorted(types.written.items())]
    listed = ["__all__ = [", *(f'    "{name}",' for name in sorted(types.written)), "]"]
    return "\n".join(head) + "\n\n" + "\n".join(listed) + "\n\n\n" + "\n\n\n".join(blocks) + "\n"


class Operation:
    """One operation of the document, as a call.

    Parameters
    ----------
    method, path : str
        As in the document.
    entry : dict
        The operation object.
    types : Types
        Types of its body, parameters and answers.
    """

    def __init__(self, method: str, path: str, entry: dict[str, Any], types: Types) -> None:
        self.method, self.path, self.entry, self.types = method, path, entry, types
        self.name = entry["operationId"]
        self.parameters = entry.get("parameters", [])
        self.bodies = entry.get("requestBody", {}).get("content", {})
        self.streams = any(STREAM in answer.get("content", {}) for answer in entry["responses"].values())
        self.keyed = any(parameter["name"] == "Idempotency-Key" for parameter in self.parameters)

    def repeatable(self) -> bool:
        """Whether the request may be sent again when its answer was lost: it only reads, replaces, or has a key."""
        return self.keyed or self.method in ("get", "put") or self.entry.get("x-role") == "reader"

    def in_place(self, place: str) -> list[dict[str, Any]]:
        return [parameter for parameter in self.parameters if parameter["in"] == place]

    def answer(self) -> str:
        """The type of the JSON of all successful answers."""
        kinds: list[str] = []
        for status, response in self.entry["responses"].items():
            content = response.get("content", {})
            if status.startswith("2") and JSON in content:
                kinds.append(self.types.of(content[JSON].get("schema", {}), "Answer", "t."))
            elif status.startswith("2") and not content:
                kinds.append("None")
        return union(kinds) or "Any"

    def body(self) -> list[tuple[str, str, str]]:
        """Parameters of the body: name, type, default or nothing."""
        if "multipart/form-data" in self.bodies and JSON not in self.bodies:
            form = self.types.of(self.bodies["multipart/form-data"]["schema"], "Form", "t.")
            raw = [kind for kind in self.bodies if kind != "multipart/form-data"]
            return [("body", f"{form} | bytes | Path" if raw else form, "")]
        kinds = []
        if JSON in self.bodies:
            kinds.append(self.types.of(self.bodies[JSON]["schema"], "Body", "t."))
        if any(kind != JSON for kind in self.bodies):
            kinds.append("bytes | Path")
        return [("body", union(kinds), "")] if kinds else []

    def optional(self) -> list[tuple[str, str, str]]:
        """Parameters by keyword: name, type, default or nothing."""
        found = []
        for parameter in self.in_place("query") + self.in_place("header"):
            schema = parameter["schema"]
            deep = schema.get("type") == "object"
            kind = (
                "Mapping[str, object]"
                if deep
                else self.types.of(schema, "Parameter", "t.").replace("list[", "Sequence[")
            )
            needed = parameter.get("required", False)
            kind = kind if needed or "None" in kind.split(" | ") else f"{kind} | None"
            found.append((identifier(parameter["name"]), kind, "" if needed else " = None"))
        return found + ([("accept", "str | None", " = None")] if self.forms() else [])

    def forms(self) -> list[str]:
        """Media types of the answer, where there are several."""
        answers = [answer for status, answer in self.entry["responses"].items() if status.startswith("2")]
        found = sorted({kind for answer in answers for kind in answer.get("content", {})})
        return found if len(found) > 1 else []

    def raw(self) -> list[tuple[str, str, str]]:
        """What a body that is a file needs besides: its media type, and parameters that are fields of the JSON body."""
        if not any(kind not in (JSON, "multipart/form-data") for kind in self.bodies):
            return []
        return [("content_type", "str | None", " = None"), ("options", "Mapping[str, object] | None", " = None")]

    def documentation(self) -> list[str]:
        """The docstring in the style of NumPy."""
        lines = wrapped(self.entry["summary"], 8)
        if self.entry.get("description"):
            lines += ["", *wrapped(self.entry["description"], 8)]
        rows: list[str] = []
        for parameter in self.parameters:
            rows += [
                f"        {identifier(parameter['name'])}",
                *wrapped(parameter.get("description", "As named."), 12),
            ]
        if self.forms():
            said = "Media type of the answer, in place of `format`, such as `application/x-ndjson`."
            rows += ["        accept", *wrapped(said + (" Default: JSON." if JSON in self.forms() else ""), 12)]
        if self.raw():
            rows += [
                "        content_type",
                *wrapped(f"Media type of a body of bytes: {', '.join(sorted(set(self.bodies) - {JSON}))}.", 12),
            ]
            rows += [
                "        options",
                *wrapped("Further parameters of the query: fields of the JSON body, options of reading.", 12),
            ]
        if rows:
            lines += ["", "        Parameters", "        ----------", *rows]
        return docstring(lines, 8)

    def lines(self) -> list[str]:
        """The asynchronous call."""
        positional = [(parameter["name"], "str", "") for parameter in self.in_place("path")] + self.body()
        named = sorted(self.optional() + self.raw(), key=lambda part: bool(part[2]))
        rows = ["self", *(f"{name}: {kind}{default}" for name, kind, default in positional)]
        rows += ["*", *(f"{name}: {kind}{default}" for name, kind, default in named)] if named else []
        answer = "AsyncIterator[Event]" if self.streams else f"Reply[{self.answer()}]"
        word = "def" if self.streams else "async def"
        head = f"    {word} {self.name}({', '.join(rows)}) -> {answer}:"
        if len(head) > WIDTH:
            head = "\n".join([f"    {word} {self.name}(", *(f"        {row}," for row in rows), f"    ) -> {answer}:"])
        return [head, *self.documentation(), *self.call()]

    def call(self) -> list[str]:
        path = re.sub(r"\{(\w+)\}", r"{quoted(\1)}", self.path)
        given = [f'"{self.method.upper()}"', f'f"{path}"' if "{" in path else f'"{path}"']
        for place, word in (("query", "query"), ("header", "headers")):
            pairs = [f'"{entry["name"]}": {identifier(entry["name"])}' for entry in self.in_place(place)]
            pairs += ['"Accept": accept'] if place == "header" and self.forms() else []
            if pairs:
                given.append(f"{word}={{{', '.join(pairs)}}}")
        if self.body():
            given.append("form=body" if "multipart/form-data" in self.bodies else "body=body")
        if self.raw():
            given += ["content_type=content_type", "options=options"]
        if not self.streams:
            given += ["keyed=True"] if self.keyed else []
            given += ["repeatable=True"] if self.repeatable() else []
        verb = "self._events" if self.streams else "await self._send"
        line = f"        return {verb}({', '.join(given)})"
        if len(line) <= WIDTH:
            return [line]
        rows: list[str] = []
        for part in given:
            rows += self.opened(part) if len(part) + 13 > WIDTH else [f"            {part},"]
        return [f"        return {verb}(", *rows, "        )"]

    def opened(self, part: str) -> list[str]:
        word, inner = part.split("={", 1)
        return [
            f"            {word}={{",
            *(f"                {pair}," for pair in inner[:-1].split(", ")),
            "            },",
        ]


def operations(document: dict[str, Any], types: Types) -> list[Operation]:
    """All operations, by name."""
    found = [
        Operation(method, path, entry, types)
        for path, item in document["paths"].items()
        for method, entry in item.items()
        if method in MAIN_PARTS
    ]
    return sorted(found, key=lambda operation: operation.name)


def calls_file(found: list[Operation]) -> str:
    """The file of all asynchronous calls."""
    head = [
        '"""Asynchronous calls of all operations. Generated by `generate.py` from `openapi/openapi.json`."""',
        "",
        OFF.strip(),
        "",
        "from __future__ import annotations",
        "",
        "from collections.abc import AsyncIterator, Mapping, Sequence",
        "from pathlib import Path",
        "from typing import TYPE_CHECKING, Any, Literal",
        "",
        "from .._aio_transport import AsyncTransport",
        "from .._reply import Event, Reply, quoted",
        "",
        "if TYPE_CHECKING:",
        "    from . import types as t",
        "",
        "",
        "class AsyncCalls(AsyncTransport):",
        '    """Asynchronous calls, one for each operation of the OpenAPI document, by its `operationId`."""',
        "",
    ]
    return "\n".join(head) + "\n" + "\n\n".join("\n".join(operation.lines()) for operation in found) + "\n"


def blocking(text: str, origin: str) -> str:
    """The blocking half of an asynchronous file."""
    for pattern, word in REPLACED:
        text = re.sub(pattern, word, text)
    title, rest = text.split("\n", 1)
    if not title.endswith('"""'):
        sys.exit(f"expected a first line of {origin} that is its docstring, got {title}")
    off = "" if OFF in rest else OFF
    return f"{title}\n\n# Derived from `{origin}` by `generate.py`.\n# ruff: noqa: I001, UP028\n{off}{rest}"


def files() -> dict[pathlib.Path, str]:
    """All generated files with their content."""
    document = json.loads(DOCUMENT.read_text(encoding="utf-8"))
    types = Types(document["components"]["schemas"])
    made = {SOURCE / "_generated" / "types.py": types_file(types)}
    calls = calls_file(operations(document, types))
    made[SOURCE / "_generated" / "async_calls.py"] = calls
    made[SOURCE / "_generated" / "calls.py"] = blocking(calls, "async_calls.py")
    for origin, target in (("_aio.py", "_sync.py"), ("_aio_transport.py", "_sync_transport.py")):
        made[SOURCE / target] = blocking((SOURCE / origin).read_text(encoding="utf-8"), origin)
    return made


def main() -> int:
    """Writes or compares the files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare only")
    check, old = parser.parse_args().check, []
    for path, text in files().items():
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        old.append(str(path.relative_to(HERE)))
        if not check:
            path.write_text(text, encoding="utf-8")
    print(f"{'differ' if check else 'written'}: {', '.join(old) or 'none'}")
    return 1 if check and old else 0


if __name__ == "__main__":
    sys.exit(main())
