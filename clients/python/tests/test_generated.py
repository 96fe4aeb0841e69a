"""The generated part against the OpenAPI document."""

import ast
import importlib.util
import inspect
import json
import pathlib
import sys

import pytest

from shapelex import AsyncClient, Client, types
from shapelex._generated.async_calls import AsyncCalls
from shapelex._generated.calls import Calls

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent.parent
DOCUMENT = json.loads((ROOT / "openapi" / "openapi.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def generator():
    """The generator as a module."""
    specification = importlib.util.spec_from_file_location("generate", HERE.parent / "generate.py")
    module = importlib.util.module_from_spec(specification)
    sys.modules["generate"] = module
    specification.loader.exec_module(module)
    return module


def operations():
    """Operation ids of the document."""
    return {entry["operationId"] for item in DOCUMENT["paths"].values() for entry in item.values()}


def calls_of(kind):
    """Public functions of a class that are its own."""
    return {name for name, _ in inspect.getmembers(kind, inspect.isfunction) if name in vars(kind) and name[0] != "_"}


def test_every_operation_has_its_call_in_both_halves():
    assert len(operations()) > 100
    assert calls_of(Calls) == operations()
    assert calls_of(AsyncCalls) == operations()


def test_every_schema_has_its_type():
    missing = set(DOCUMENT["components"]["schemas"]) - set(types.__all__ if hasattr(types, "__all__") else vars(types))
    assert missing == set()


def test_the_committed_files_are_those_of_a_fresh_generation(generator):
    for path, text in generator.files().items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name} is old: run clients/python/generate.py"


def test_parameters_of_the_calls_are_those_of_the_document(generator):
    for item in DOCUMENT["paths"].values():
        for entry in item.values():
            named = {generator.identifier(parameter["name"]) for parameter in entry.get("parameters", [])}
            given = set(inspect.signature(getattr(Calls, entry["operationId"])).parameters)
            assert named <= given, entry["operationId"]
            assert ("body" in given) == ("requestBody" in entry), entry["operationId"]


def test_both_halves_have_the_same_methods():
    assert calls_of(Client) == {name.replace("aclose", "close") for name in calls_of(AsyncClient)}


def lines_of_code(text):
    """Lines that hold code: no blank ones, no comments, no documentation."""
    skipped = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Module)) and ast.get_docstring(
            node
        ):
            skipped |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    rows = enumerate(text.splitlines(), 1)
    return sum(1 for k, row in rows if k not in skipped and row.strip() and not row.strip().startswith("#"))


def test_the_high_level_is_small():
    source = HERE.parent / "src" / "shapelex"
    derived = {"_sync.py", "_sync_transport.py"}
    lines = {file.name: lines_of_code(file.read_text()) for file in source.glob("*.py") if file.name not in derived}
    assert sum(lines.values()) <= 2500, lines


def test_public_names_have_documentation():
    source = HERE.parent / "src" / "shapelex"
    for file in source.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)) and not node.name.startswith(
                "_"
            ):
                inner = isinstance(node, ast.FunctionDef) and node.name in ("part", "texts")
                assert inner or ast.get_docstring(node), f"{file.name}: {node.name}"
