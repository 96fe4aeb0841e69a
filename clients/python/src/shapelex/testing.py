"""Plugin of pytest: a service with throw-away data, and an example cohort.

It is found by itself where the package is installed. Without a program (`shapelex.server.find_binary`), tests that ask
for a fixture are skipped with the reason.

    def test_mean(shapelex_cohort):
        assert shapelex_cohort.mean().n_shapes == 40
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from . import Client, Cohort, Server, Shapes

# Two groups of twenty outlines each.
COUNT, POINTS = 40, 64


def example_shapes(seed: int = 0, count: int = COUNT, points: int = POINTS) -> Shapes:
    """Outlines of two groups, drawn from a seed: ellipses, dented in the second group, with noise in two more waves.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.
    count : int
        Number of shapes.
    points : int
        Points on each.

    Returns
    -------
    Shapes
        With ids `shape-0`, …, labels `a` and `b`, and the attributes `group` and `age` (years).
    """
    from . import Shapes

    random = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(points) / points
    group = np.arange(count) % 2
    dent = 0.25 * group + 0.04 * random.standard_normal(count)
    waves = 0.04 * random.standard_normal((count, 2))
    radius = 1 - dent[:, None] * np.cos(2 * angle) ** 4
    radius += waves[:, :1] * np.cos(3 * angle) + waves[:, 1:] * np.sin(2 * angle)
    turn, size = 2 * np.pi * random.random(count), 5 + random.random(count)
    outline = radius * np.exp(1j * angle)
    outline = (1.5 * outline.real + 1j * outline.imag) * (size * np.exp(1j * turn))[:, None]
    outline += 20 * (random.standard_normal(count) + 1j * random.standard_normal(count))[:, None]
    rows = [{"group": "ab"[k], "age": int(age)} for k, age in zip(group, random.integers(20, 80, count))]
    labels = ["ab"[k] for k in group]
    names = [f"shape-{k}" for k in range(count)]
    return Shapes(np.stack([outline.real, outline.imag], axis=-1), names, labels=labels, attributes=rows, closed=True)


@pytest.fixture(scope="session")
def shapelex_server() -> Iterator[Server]:
    """A service with throw-away data, one for all tests."""
    from . import NoServer, Server

    try:
        server = Server.start(options=("--threads=2",))
    except NoServer as reason:
        pytest.skip(str(reason))
    with server:
        yield server


@pytest.fixture
def shapelex_client(shapelex_server: Server) -> Iterator[Client]:
    """A client of the service."""
    with shapelex_server.client() as client:
        yield client


@pytest.fixture
def shapelex_cohort(shapelex_client: Client) -> Cohort:
    """A new cohort of forty seeded outlines in two groups, `a` and `b`, under a name of no other test."""
    name = f"example-{uuid.uuid4().hex}"
    return shapelex_client.create_cohort(name, example_shapes(), control_points=24, length_unit="mm")
