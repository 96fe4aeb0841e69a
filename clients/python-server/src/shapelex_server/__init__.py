"""The program `shapelex`, as pip has installed it."""

from __future__ import annotations

import importlib.metadata
import pathlib

__all__ = ["binary"]

PROGRAM = "shapelex"


def binary() -> pathlib.Path | None:
    """Path of the program that came with this package; None where it was removed."""
    recorded = [pathlib.Path(str(file.locate())) for file in importlib.metadata.files("shapelex-server") or []]
    # `pip install --target` moves programs to a folder beside the packages, and records another one.
    beside = pathlib.Path(__file__).resolve().parents[1] / "bin" / PROGRAM
    found = [path for path in [*recorded, beside] if path.name == PROGRAM and path.is_file()]
    return found[0].resolve() if found else None
