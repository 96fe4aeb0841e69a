"""Pages of the operations of the service, made from its OpenAPI document: one for each tag, and those of the types."""

import json
import re

# Folder of the pages.
FOLDER = "openapi"
# Pages of types.
PARTS = 6
METHODS = ("get", "post", "put", "patch", "delete")
# Media types in words, where they have some.
SHORT = {
    "application/json": "JSON",
    "application/x-ndjson": "NDJSON",
    "application/problem+json": "a [problem](../docs/problems.md)",
    "image/svg+xml": "SVG",
    "image/png": "PNG",
    "text/csv": "CSV",
    "application/vnd.apache.arrow.stream": "Arrow",
    "application/vnd.apache.parquet": "Parquet",
    "application/x-npy": "NPY",
    "application/x-npz": "NPZ",
}


def pages(document):
    """Markdown of all pages by their paths."""
    described = json.loads(document.read_text(encoding="utf-8"))
    schemas = described["components"]["schemas"]
    operations = [
        (operation["tags"][0], method, path, operation)
        for path, item in described["paths"].items()
        for method, operation in item.items()
        if method in METHODS
    ]
    places = places_of(schemas)
    homes = {operation["operationId"]: f"{tag}.md#{operation['operationId']}" for tag, _, _, operation in operations}
    found, tags = {}, {tag["name"]: tag.get("description", "") for tag in described["tags"]}
    lines = []
    for tag, description in tags.items():
        inside = [one[1:] for one in operations if one[0] == tag]
        text = "\n".join(operation_text(*one, places) for one in inside)
        found[f"{FOLDER}/{tag}.md"] = f"# Operations: {tag}\n\n{description}.\n\n{text}"
        lines.append(f"| [{tag}]({tag}.md) | {description} | {len(inside)} |")
    for file, names in files_of(schemas).items():
        text = "\n".join(type_text(name, schemas[name], places) for name in names)
        found[f"{FOLDER}/{file}"] = f"# Types {names[0]} to {names[-1]}\n\nTypes of bodies and answers.\n\n{text}"
    found[f"{FOLDER}/README.md"] = overview(described, lines, files_of(schemas))
    # Links between operations, as the page of a running service has them.
    led = re.compile(r"\(#/operations/(\w+)\)")
    return {path: led.sub(lambda link: f"({homes[link.group(1)]})", text) for path, text in found.items()}


def overview(described, lines, files):
    """The first page of the reference."""
    said = "\n".join(lines)
    types = "\n".join(f"| [{names[0]} to {names[-1]}]({file}) | {len(names)} |" for file, names in files.items())
    return (
        "# API reference\n\n"
        f"All operations of version {described['info']['version']}, made from the document that the service answers at "
        "`/openapi.json`. A running service shows the same at `/docs`, where requests can be sent.\n\n"
        f"| operations | about | number |\n|---|---|---|\n{said}\n\n"
        f"| types of bodies and answers | number |\n|---|---|\n{types}\n"
    )


def files_of(schemas):
    """Names of types by the pages on which they stand."""
    names = sorted(schemas)
    size = -(-len(names) // PARTS)
    return {f"types-{k + 1}.md": names[k * size : (k + 1) * size] for k in range(PARTS)}


def places_of(schemas):
    """Page and anchor of each type."""
    return {name: f"{file}#{name}" for file, names in files_of(schemas).items() for name in names}


def cell(text):
    """A text in a cell of a table: one line, bars as they are."""
    return " ".join((text or "").split()).replace("|", "\\|").replace("<", "&lt;")


def paragraphs(text):
    """A description, as it is: angle brackets that are no code are shown."""
    return re.sub(r"`[^`]*`|<", lambda found: found.group(0) if found.group(0) != "<" else "&lt;", text or "")


def type_name(schema, places):
    """What a value is, in words with links."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        return f"[{name}]({places[name]})"
    for key in ("oneOf", "anyOf"):
        if key in schema:
            names = [type_name(one, places) for one in schema[key]]
            return " or ".join(dict.fromkeys(names))
    if "allOf" in schema:
        return " and ".join(type_name(one, places) for one in schema["allOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    kinds = schema.get("type", "any")
    kinds = kinds if isinstance(kinds, list) else [kinds]
    return " or ".join(dict.fromkeys(one_type(kind, schema, places) for kind in kinds))


def one_type(kind, schema, places):
    """A type of JSON with that of its parts."""
    if kind == "array":
        return f"list of {type_name(schema.get('items', {}), places)}"
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"map of {type_name(schema['additionalProperties'], places)}"
    return "any value" if kind == "any" else kind


def bounds(schema):
    """Bounds of a value, as far as the document states them."""
    words = {"minimum": "≥", "maximum": "≤", "minItems": "items ≥", "maxItems": "items ≤", "maxLength": "length ≤"}
    found = [f"{word} {schema[key]}" for key, word in words.items() if key in schema]
    return f" ({', '.join(found)})" if found else ""


def described_in(schema):
    """The description of a value, which may stand in one of its alternatives."""
    parts = [schema, *schema.get("oneOf", []), *schema.get("anyOf", [])]
    return next((part["description"] for part in parts if part.get("description")), "")


def fields(schema, places):
    """Rows of the fields of an object."""
    required = set(schema.get("required", []))
    for name, value in schema.get("properties", {}).items():
        said = cell(type_name(value, places) + bounds(value)).replace("&lt;", "<")
        yield f"| `{name}`{' *' if name in required else ''} | {said} | {cell(described_in(value))} |"


def type_text(name, schema, places):
    """A type: what it is, and its fields; those with a star are always there."""
    parts = [f"## {name} {{#{name}}}", "", paragraphs(schema.get("description")), ""]
    objects = [part for part in [schema, *schema.get("allOf", [])] if part.get("properties")]
    others = [part for part in schema.get("allOf", []) if "$ref" in part]
    if others:
        parts += [f"All fields of {', '.join(type_name(part, places) for part in others)}.", ""]
    if objects:
        rows = [row for part in objects for row in fields(part, places)]
        parts += ["| field (* required) | type | meaning |", "|---|---|---|", *rows, ""]
    elif not others:
        parts += [f"{type_name(schema, places)}{bounds(schema)}", ""]
    return "\n".join(parts)


def body_text(operation, places):
    """What an operation takes: media types, the type of JSON, an example."""
    contents = operation.get("requestBody", {}).get("content", {})
    if not contents:
        return []
    named = [SHORT.get(kind, f"`{kind}`") for kind in contents]
    structured = contents.get("application/json", {})
    said = f", JSON as {type_name(structured['schema'], places)}" if "schema" in structured else ""
    parts = [f"**Body**: {', '.join(named)}{said}.", ""]
    example = structured.get("example")
    if example is not None:
        parts += ["```json", json.dumps(example, ensure_ascii=False), "```", ""]
    return parts


def answers_text(operation, places):
    """What an operation answers, a row for each status."""
    rows = []
    for status, answer in operation["responses"].items():
        contents = answer.get("content", {})
        structured = contents.get("application/json", {}).get("schema")
        said = [type_name(structured, places)] if structured else []
        said += [SHORT.get(kind, f"`{kind}`") for kind in contents if kind != "application/json"]
        rows.append(f"| {status} | {cell(answer.get('description'))} | {', '.join(said)} |")
    return ["| status | meaning | answer |", "|---|---|---|", *rows, ""]


def operation_text(method, path, operation, places):
    """A section on an operation."""
    parts = [f"## {method.upper()} `{path}` {{#{operation['operationId']}}}", "", paragraphs(operation["summary"]), ""]
    parts += [paragraphs(operation.get("description")), ""]
    if operation.get("x-role"):
        parts += [f"Role: {operation['x-role']}. Name of the call in clients: `{operation['operationId']}`.", ""]
    listed = [one for one in operation.get("parameters", []) if "name" in one]
    if listed:
        parts += ["| parameter (* required) | in | type | meaning |", "|---|---|---|---|"]
        for one in listed:
            star = " *" if one.get("required") else ""
            kind = cell(type_name(one["schema"], places) + bounds(one["schema"])).replace("&lt;", "<")
            parts.append(f"| `{one['name']}`{star} | {one['in']} | {kind} | {cell(one.get('description'))} |")
        parts.append("")
    return "\n".join([*parts, *body_text(operation, places), *answers_text(operation, places)])
