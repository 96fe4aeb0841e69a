"""Distances between plane curves and the nearest curves, start points searched, beside transforms of numpy and
scipy."""

import numpy as np
from data import random_contours, real, silhouettes
from measure import Row, beside, close
from scipy import fft

TILE = 16
NEAREST = 10


def rows(ours, setting):
    yield matrix(ours, setting, 300 if setting.quick else 1300, "cyclic")
    yield matrix(ours, setting, 300 if setting.quick else 1300, "landmarks")
    for count in (10_000,) if setting.quick else (10_000, 100_000, 1_000_000):
        yield nearest(ours, setting, count)


def matrix(ours, setting, count, search):
    z = silhouettes(setting.data, count)
    shapes, points = ours.file("shapes", real(z)), len(z)
    rows = np.ascontiguousarray(z.T)
    peer_of = all_starts if search == "cyclic" else one_start
    own, peer, _, reference = beside(
        lambda t: ours.run(
            "distances", shapes, points, search, ours.file("matrix"), threads=t, repeats=setting.repeats
        ),
        lambda t: peer_of(rows, t),
        setting.rounds,
    )
    # A distance of d is exact to 1e-15/d: squares are compared, and shapes of one kind are some 1e-8 apart.
    compared, agrees = close(ours.read("matrix").reshape(count, count) ** 2, reference**2, 1e-12, "squared distances")
    if search == "cyclic":
        pairs = count * (count - 1) / 2
        row = Row(
            "distances",
            f"{count}² distances of curves × {points}, start points searched",
            own,
            "scipy, batched transforms",
            peer,
            "one complex transform for each pair",
            {"1": pairs * ours.transforms(points)},
        )
    else:
        operations = 2 * count**2 * points * 2
        row = Row(
            "distances, given points",
            f"{count}² distances of curves × {points}, points correspond",
            own,
            "numpy, one product",
            peer,
            "the product at the rate of dgemm",
            {t: operations / rate for t, rate in setting.dgemm.items()},
        )
    row.compared, row.agrees = compared, agrees
    return row


def of(correlations):
    return np.sqrt(np.maximum(1 - correlations**2, 0))


def all_starts(z, threads):
    """Distances by one transform for each pair above the diagonal, some rows at once."""
    spectra, distances = fft.fft(z, axis=1, workers=threads), np.zeros((len(z), len(z)))
    for first in range(0, len(z), TILE):
        products = np.conj(spectra[first : first + TILE, None]) * spectra[None, first:]
        scores = np.abs(fft.ifft(products, axis=2, workers=threads, overwrite_x=True)).max(axis=2)
        distances[first : first + TILE, first:] = of(scores)
    upper = np.triu(distances, 1)
    return upper + upper.T


def one_start(z, _):
    distances = of(np.abs(z.conj() @ z.T))
    np.fill_diagonal(distances, 0)
    return distances


def nearest(ours, setting, count, points=32):
    z = random_contours(count, points)
    shapes = ours.file("shapes", real(z))
    spectra = np.ascontiguousarray(np.fft.fft(z.T, axis=1))
    own, peer, found, reference = beside(
        lambda t: ours.run("neighbours", shapes, points, NEAREST, threads=t, repeats=9),
        lambda t: search(spectra, t),
        setting.rounds if count < 1_000_000 else 1,
    )
    compared, agrees = close(np.square(found["distances"]), np.square(reference[1]), 1e-12, "squared distances")
    same = found["positions"] == list(map(int, reference[0]))
    return Row(
        f"nearest of {count:.0e}".replace("e+0", "e"),
        f"{NEAREST} nearest of {count} curves × {points}, start points searched",
        own,
        "numpy, transforms in memory",
        peer,
        "one complex transform for each curve",
        {"1": count * ours.transforms(points)},
        compared + ("" if same else "; other positions"),
        agrees and same,
    )


def search(spectra, threads):
    """Positions and distances of the nearest curves to the first one."""
    scores = np.empty(len(spectra))
    for first in range(0, len(spectra), 1 << 14):
        products = spectra[first : first + (1 << 14)] * np.conj(spectra[0])
        scores[first : first + (1 << 14)] = np.abs(fft.ifft(products, axis=1, workers=threads, overwrite_x=True)).max(
            axis=1
        )
    chosen = np.argpartition(-scores, NEAREST)[:NEAREST]
    chosen = chosen[np.argsort(-scores[chosen], kind="stable")]
    return chosen, of(scores[chosen])
