"""Permutation tests of two groups beside numpy."""

import numpy as np
from measure import Row, beside, close

# Principal coordinates of Hotelling's statistic, a quarter of the shapes: a choice of ours, which the peer gets.
COMPONENTS = 50


def rows(ours, setting):
    draws = 999 if setting.quick else 9999
    yield test(ours, setting, draws, "F")
    yield test(ours, setting, draws, "pair")


def test(ours, setting, draws, what, count=200, length=200):
    rng = np.random.default_rng(5)
    y = rng.standard_normal((count, length)) / np.sqrt(np.arange(1, length + 1))
    y[count // 2 :] += 0.05
    shapes = ours.file("shapes", y.T)
    own, peer, found, reference = beside(
        lambda t: ours.run("permutations", shapes, length, count, draws, what, threads=t, repeats=setting.repeats),
        lambda t: statistics(y, draws, None if what == "F" else COMPONENTS),
        setting.rounds,
    )
    values = found["statistics"]
    if what == "F":
        compared, agrees = close(values, reference[:1], 1e-9, "F")
        operations, name = 2 * count * length * draws, "F"
    else:
        compared, agrees = close(values[:3], reference, 1e-9, "F, T², largest T² of a point")
        agrees &= values[3] == COMPONENTS
        operations, name = 2 * count * (2 * length + COMPONENTS) * draws, "F, Hotelling's T², largest T² of a point"
    return Row(
        f"test, {what}",
        f"{draws} relabellings of {count} shapes × {length}: {name}",
        own,
        "numpy, one product",
        peer,
        "the products at the rate of dgemm",
        {t: operations / rate for t, rate in setting.dgemm.items()},
        compared,
        agrees,
    )


def statistics(y, draws, components):
    """Statistics of the first and the second half; those of relabellings are formed from the sums of one group and
    counted."""
    count, half = len(y), len(y) // 2
    y = y - y.mean(axis=0)
    labels = np.zeros((count, draws + 1))
    rng = np.random.default_rng(6)
    labels[half:, 0] = 1
    for k in range(1, draws + 1):
        labels[rng.permutation(count)[:half], k] = 1
    factor = half * (count - half) / count * (1 / half + 1 / (count - half)) ** 2

    def explained(columns):
        return factor * (columns.T @ labels) ** 2

    odds = lambda v: (count - 2) * v / (1 - v)
    r2 = explained(y).sum(axis=0) / np.sum(y**2)
    observed = [odds(r2)[0]]
    reached = [np.sum(r2[1:] >= r2[0])]
    if components:
        _, s, vectors = np.linalg.svd(y, full_matrices=False)
        v = explained(y @ (vectors[:components].T / s[:components])).sum(axis=0)
        points = y.shape[1] // 2
        pairs = np.stack([y[:, :points], y[:, points:]], axis=2).transpose(1, 0, 2)
        roots = np.linalg.cholesky(np.linalg.inv(pairs.transpose(0, 2, 1) @ pairs))
        white = (pairs @ roots).transpose(1, 0, 2).reshape(count, -1)
        largest = explained(white).reshape(points, 2, -1).sum(axis=1).max(axis=0)
        observed += [odds(v)[0], odds(largest)[0]]
        reached += [np.sum(v[1:] >= v[0]), np.sum(largest[1:] >= largest[0])]
    return observed
