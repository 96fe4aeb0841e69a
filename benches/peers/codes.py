"""Sparse codes and dictionaries beside SPAMS; in detail: dictionaries.py."""

from math import ceil

import numpy as np
import spams
from data import aligned, atoms_and_signals, cells, real
from dictionaries import evaluate, shuffled
from measure import Row, beside, close, in_turn, timed

LAMBDA = 0.05
NONZEROS = 5
# Not whole: 0.5 is a pass over the half of the signals, 1.5 are two over three quarters. SPAMS reads 512 signals in an
# iteration.
PASSES = (0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)


def rows(ours, setting):
    for atoms in (64, 256) if setting.quick else (64, 128, 256, 512, 1024):
        d, x = atoms_and_signals(atoms, 500 if setting.quick else 4000)
        yield lasso(ours, setting, f"{atoms} atoms", d, x)
        yield pursuit(ours, setting, f"{atoms} atoms", d, x)
    x = real(aligned(cells(setting.data, 454)))
    for atoms in (25,) if setting.quick else (10, 25, 50):
        d = np.asfortranarray(spams.trainDL(x, K=atoms, lambda1=LAMBDA, iter=100, numThreads=2, verbose=False))
        yield lasso(ours, setting, f"cells, {atoms} atoms", d, x)
    x = atoms_and_signals(64, 2000 if setting.quick else 10_000)[1]
    for iterations in (30,) if setting.quick else (10, 30, 100, 300, 1000):
        yield learning(ours, setting, x, 64, iterations)


def encoding(ours, setting, kind, name, d, x, how, peer):
    files = ours.file("x", x), ours.file("d", d)
    own, theirs, found, codes = beside(
        lambda t: ours.run("encode", *files, *d.shape, how, threads=t, repeats=5), peer, setting.rounds
    )
    residual = x - d @ codes.toarray()
    squares = np.sum(residual**2) / x.shape[1]
    row = Row(f"{kind}, {name}", f"{kind} of {x.shape[1]} × {len(x)}, {name}", own, "SPAMS", theirs)
    operations = 2 * d.size * x.shape[1]
    row.bound, row.bounds = (
        "products with all atoms at the rate of dgemm",
        {t: operations / rate for t, rate in setting.dgemm.items()},
    )
    return row, found, codes, squares


def lasso(ours, setting, name, d, x):
    row, found, codes, squares = encoding(
        ours,
        setting,
        "lasso",
        name,
        d,
        x,
        f"lambda={LAMBDA}",
        lambda t: spams.lasso(x, D=d, lambda1=LAMBDA, mode=2, numThreads=t),
    )
    objective = squares / 2 + LAMBDA * np.abs(codes.data).sum() / x.shape[1]
    row.compared, row.agrees = close([found["objective"]], [objective], 1e-9, "objective")
    return row


def pursuit(ours, setting, name, d, x):
    row, found, _, squares = encoding(
        ours,
        setting,
        f"pursuit of {NONZEROS}",
        name,
        d,
        x,
        f"nonzeros={NONZEROS}",
        lambda t: spams.omp(x, D=d, L=NONZEROS, numThreads=t),
    )
    # SPAMS chooses atoms by another rule: each of the two may find the better code.
    ratio = found["squared residual"] / squares
    row.compared, row.agrees = f"squared residual {ratio:.3f} of the peer's", ratio < 1.05
    return row


def learning(ours, setting, x, atoms, iterations):
    """Seconds until the objective that SPAMS has after so many iterations; least of the passes that reach it."""
    seeds = range(1 if setting.quick else 3)

    def peer():
        runs = [
            timed(
                lambda seed=seed: spams.trainDL(
                    shuffled(x, seed),
                    K=atoms,
                    lambda1=LAMBDA,
                    iter=iterations,
                    numThreads=2,
                    verbose=False,
                    batchsize=512,
                )
            )
            for seed in seeds
        ]
        return min(evaluate(x, d, LAMBDA) for d, _ in runs), float(np.median([seconds for _, seconds in runs]))

    def own(passes, seed):
        whole = ceil(passes)
        return ours.learn(x[:, : int(passes / whole * x.shape[1])], atoms, LAMBDA, whole, seed)

    objective, reference = peer()
    for passes in PASSES:
        runs = [own(passes, seed) for seed in seeds]
        reached = min(evaluate(x, d, LAMBDA) for d, _ in runs)
        if reached <= objective:
            break
    least, _ = in_turn(
        {"ours": lambda: (None, float(np.median([own(passes, seed)[1] for seed in seeds]))), "peer": peer},
        setting.rounds,
    )
    return Row(
        f"learning, {iterations} iterations",
        f"{atoms} atoms of {x.shape[1]} × {len(x)} to the objective of {iterations} iterations",
        {"2": least["ours"]},
        "SPAMS",
        {"2": min(reference, least["peer"])},
        compared=f"objective {objective:.6f}, ours {reached:.6f} after {passes} passes",
        agrees=reached <= objective,
    )
