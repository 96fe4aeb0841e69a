"""Loop subdivision of an octahedron beside numpy, and its operator beside a sparse matrix of scipy."""

import numpy as np
from measure import Row, beside, close
from scipy import sparse

OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
WIDTH = 48


def rows(ours, setting):
    yield refinement(ours, setting, 6 if setting.quick else 8)
    yield operator(ours, setting, 3 if setting.quick else 4)


def refinement(ours, setting, level):
    own, peer, _, reference = beside(
        lambda t: ours.run("refine", level, ours.file("vertices"), threads=t, repeats=setting.repeats),
        lambda t: refined(level)[0],
        setting.rounds,
        threads=(1,),
    )
    # The order of vertices is a choice: sorted coordinates are compared.
    ordered = lambda v: np.sort(np.round(v, 12), axis=0)
    compared, agrees = close(
        ordered(ours.read("vertices").reshape(-1, 3)), ordered(reference), 1e-11, "sorted coordinates"
    )
    return Row(
        "subdivision",
        f"octahedron, Loop, level {level}: {len(reference)} vertices",
        own,
        "numpy",
        peer,
        compared=compared,
        agrees=agrees,
    )


def refined(level):
    vertices, faces = OCTAHEDRON, FACES
    for _ in range(level):
        vertices, faces = step(vertices, faces)
    return vertices, faces


def step(vertices, faces):
    """One step of Loop's scheme with its original weights."""
    count = len(vertices)
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    low, high = sides.min(axis=1), sides.max(axis=1)
    _, first, edge = np.unique(low * count + high, return_index=True, return_inverse=True)
    ends = np.stack([low[first], high[first]])
    across = sum_at(edge, vertices[opposite], len(first))
    middles = 3 / 8 * (vertices[ends[0]] + vertices[ends[1]]) + across / 8
    valence = np.bincount(ends.ravel(), minlength=count)
    beta = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / valence) / 4) ** 2) / valence
    ring = sum_at(np.concatenate(ends), vertices[np.concatenate(ends[::-1])], count)
    moved = (1 - valence * beta)[:, None] * vertices + beta[:, None] * ring
    ab, bc, ca = count + edge.reshape(3, -1)
    a, b, c = faces.T
    split = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([moved, middles]), np.concatenate([np.stack(f, axis=1) for f in split])


def sum_at(places, values, count):
    return np.stack([np.bincount(places, column, count) for column in values.T], axis=1)


def operator(ours, setting, level, split=3):
    blocks = 20 if setting.quick else 125
    columns = 2 + 4 ** (split + 1)
    x = np.random.default_rng(7).standard_normal((blocks, columns, WIDTH))
    identity = np.zeros((-(-columns // WIDTH), columns, WIDTH))
    for k in range(columns):
        identity[k // WIDTH, k, k % WIDTH] = 1
    # The matrix for scipy: our operator on all unit vectors.
    parts = []
    for block in identity:
        ours.run("operator", split, level, ours.file("unit", block.T), ours.file("points"))
        parts.append(sparse.csr_array(ours.read("points").reshape(-1, WIDTH)))
    matrix = sparse.hstack(parts, format="csr")[:, :columns]
    shapes = ours.file("shapes", x.transpose(2, 1, 0))
    own, peer, _, reference = beside(
        lambda t: ours.run("operator", split, level, shapes, ours.file("points"), threads=t, repeats=setting.repeats),
        lambda t: [matrix @ block for block in x][-1],
        setting.rounds,
    )
    # scipy multiplies on one thread.
    peer = {"1": min(peer.values())}
    compared, agrees = close(ours.read("points").reshape(-1, WIDTH), reference, 1e-13, "points")
    return Row(
        "operator",
        f"{matrix.shape[0]} × {columns} operator on {16 * blocks} shapes",
        own,
        "scipy, one thread",
        peer,
        compared=compared,
        agrees=agrees,
    )
