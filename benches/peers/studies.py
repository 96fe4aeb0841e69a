"""Permutation tests of two groups, and of the terms of linear models, beside numpy."""

import numpy as np
from measure import Row, beside, close

# Principal coordinates of Hotelling's statistic, a quarter of the shapes: a choice of ours, which the peer gets.
COMPONENTS = 50


def rows(ours, setting):
    draws = 999 if setting.quick else 9999
    yield test(ours, setting, draws, "F")
    yield test(ours, setting, draws, "pair")
    size = (1_000, 40, 199) if setting.quick else (10_000, 400, 10_000)
    yield model(ours, setting, "factor", *size)
    yield model(ours, setting, "curve", *size)


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


# Exchanges whose products numpy forms at once: 100 of 10 000 shapes take 24 MB.
TOGETHER = 100


def model(ours, setting, what, count, length, draws):
    rng = np.random.default_rng(7)
    y = rng.standard_normal((count, length)) / np.sqrt(np.arange(1, length + 1))
    shapes = ours.file("modelled", y.T)
    own, peer, found, reference = beside(
        lambda t: ours.run("model", shapes, length, count, draws, what, threads=t, repeats=1),
        lambda t: term(y, draws, what),
        1,
    )
    compared, agrees = close(found["statistics"], reference, 1e-9, "F")
    columns, name = (2, "one factor of three levels") if what == "factor" else (3, "a polynomial of degree 3, rank 4")
    operations = 2 * count * length * columns * draws
    return Row(
        f"model, {what}",
        f"{draws} exchanges of the residuals of {count} shapes × {length}: {name}",
        own,
        f"numpy, a product of {TOGETHER} exchanges",
        peer,
        "the products at the rate of dgemm",
        {t: operations / rate for t, rate in setting.dgemm.items()},
        compared,
        agrees,
    )


def term(y, draws, what):
    """F of the only term of a model; that of exchanged residuals is formed and counted."""
    count = len(y)
    k = np.arange(count)
    own = np.eye(3)[3 * k // count][:, 1:] if what == "factor" else np.vander(k / count, 4, increasing=True)[:, 1:]
    basis = np.linalg.qr(own - own.mean(axis=0))[0]
    y = y - y.mean(axis=0)
    total, df = np.sum(y**2), basis.shape[1]
    f = lambda squares: squares / df / ((total - squares) / (count - df - 1))
    observed = f(np.sum((basis.T @ y) ** 2))
    rng = np.random.default_rng(8)
    reached = 0
    for first in range(0, draws, TOGETHER):
        batch = min(TOGETHER, draws - first)
        exchanged = np.concatenate([basis[rng.permutation(count)].T for _ in range(batch)])
        squares = np.sum((exchanged @ y).reshape(batch, -1) ** 2, axis=1)
        reached += np.sum(f(squares) >= observed)
    return [observed]
