"""Dictionary learning and sparse coding beside SPAMS and scikit-learn, in detail: the tables of README.md.

    target/peers/bin/python benches/peers/dictionaries.py --data FOLDER [learn] [encode] [moved]

FOLDER holds `curves-osteosarcoma-cells`, `curves-mpeg7` and `curves-hands`, each with a `curves.ndjson` of contours.
All programs get the same matrices and two threads; every objective is evaluated by the same code (`evaluate`).
"""

import argparse
from itertools import zip_longest
from pathlib import Path

import numpy as np
import spams
from data import aligned, atoms_and_signals, real, shapes
from measure import Ours, timed
from sklearn.decomposition import DictionaryLearning, MiniBatchDictionaryLearning, sparse_encode
from threadpoolctl import threadpool_limits

THREADS = 2
SEEDS = range(3)
REPEATS = 9
DRAWS = 7


def evaluate(x, d, lam):
    """Mean of ½‖x − Dα‖² + λ‖α‖₁ over the columns, in atoms inside the unit ball."""
    d = np.asfortranarray(d / np.maximum(np.linalg.norm(d, axis=0), 1.0))
    a = spams.lasso(x, D=d, lambda1=lam, mode=2, numThreads=THREADS)
    r = x - d @ a.toarray()
    return 0.5 * np.sum(r * r) / x.shape[1] + lam * np.abs(a.data).sum() / x.shape[1]


def shuffled(x, seed):
    """SPAMS draws the same numbers in every run: another order of the shapes is another draw."""
    return np.asfortranarray(x[:, np.random.default_rng(seed).permutation(x.shape[1])])


def spams_learn(x, atoms, lam, iterations, seed=0):
    y = shuffled(x, seed)
    return timed(
        lambda: spams.trainDL(
            y,
            K=atoms,
            lambda1=lam,
            iter=iterations,
            numThreads=THREADS,
            verbose=False,
            posAlpha=False,
            batchsize=min(512, x.shape[1]),
        )
    )


def sklearn_learn(x, atoms, lam, estimator, **settings):
    learner = estimator(
        n_components=atoms,
        alpha=lam,
        fit_algorithm="lars" if x.shape[1] < 1000 else "cd",
        random_state=0,
        n_jobs=THREADS,
        **settings,
    )
    fitted, seconds = timed(lambda: learner.fit(x.T))
    return fitted.components_.T, seconds


SPAMS_ITERATIONS = (10, 30, 100, 300, 1000)
OUR_EPOCHS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)


def compare_learning(ours, name, x, atoms, lam, long_peers):
    print(f"\n### {name}, {atoms} atoms, λ = {lam}\n")
    print("| program | setting | seconds | objective |\n|---|---|---|---|")
    best_peer, rows = np.inf, []

    def row(program, setting, seconds, objective):
        print(f"| {program} | {setting} | {seconds:.3f} | {objective:.6f} |", flush=True)
        rows.append((program, seconds, objective))
        return objective

    # Interleaved: a busy moment of the machine meets both.
    for iterations, epochs in zip_longest(SPAMS_ITERATIONS, OUR_EPOCHS):
        if iterations:
            runs = [spams_learn(x, atoms, lam, iterations, seed) for seed in SEEDS]
            objective = min(evaluate(x, d, lam) for d, _ in runs)
            best_peer = min(best_peer, row("SPAMS", f"iter={iterations}", np.median([s for _, s in runs]), objective))
        runs = [ours.learn(x, atoms, lam, epochs, seed) for seed in SEEDS]
        objective = min(evaluate(x, d, lam) for d, _ in runs)
        row("Shapelex", f"max_epochs={epochs}", np.median([s for _, s in runs]), objective)
    d, seconds = sklearn_learn(x, atoms, lam, MiniBatchDictionaryLearning, max_iter=100, batch_size=256)
    best_peer = min(best_peer, row("scikit-learn", "MiniBatchDictionaryLearning", seconds, evaluate(x, d, lam)))
    if long_peers:
        d, seconds = sklearn_learn(x, atoms, lam, DictionaryLearning, max_iter=100, tol=1e-6)
        best_peer = min(best_peer, row("scikit-learn", "DictionaryLearning", seconds, evaluate(x, d, lam)))
    best_ours = min(objective for program, _, objective in rows if program == "Shapelex")
    print(f"\nour best objective over the best peer's: {best_ours / best_peer:.5f}")
    for program, seconds, objective in rows:
        if program == "SPAMS":
            reached = [s for p, s, o in rows if p == "Shapelex" and o <= objective]
            if reached:
                print(f"SPAMS reaches {objective:.6f} in {seconds:.3f} s, Shapelex in {min(reached):.3f} s")
            else:
                print(f"SPAMS reaches {objective:.6f} in {seconds:.3f} s, Shapelex does not")


def encode(ours, x, d, how):
    """Every repetition after the first counts, in which memory is touched for the first time."""
    return ours.run("encode", ours.file("x", x), ours.file("d", d), *d.shape, how, repeats=REPEATS + 1)


def compare_encoding(ours, name, x, atoms, lam, nonzeros):
    d = np.asfortranarray(spams_learn(x, atoms, lam, 100)[0])
    times = {key: [] for key in ("ours", "spams", "ours omp", "spams omp")}
    # Interleaved: a busy moment of the machine meets both.
    for _ in range(5):
        lasso = encode(ours, x, d, f"lambda={lam}")
        times["ours"] += lasso["seconds"][1:]
        times["ours omp"] += encode(ours, x, d, f"nonzeros={nonzeros}")["seconds"][1:]
        for _ in range(REPEATS):
            times["spams"].append(timed(lambda: spams.lasso(x, D=d, lambda1=lam, mode=2, numThreads=THREADS))[1])
            times["spams omp"].append(timed(lambda: spams.omp(x, D=d, L=nonzeros, numThreads=THREADS))[1])
    _, sk = timed(lambda: sparse_encode(x.T, d.T, algorithm="lasso_lars", alpha=lam, n_jobs=THREADS))
    _, sk_omp = timed(lambda: sparse_encode(x.T, d.T, algorithm="omp", n_nonzero_coefs=nonzeros, n_jobs=THREADS))
    micro = {key: 1e6 * np.median(values) / x.shape[1] for key, values in times.items()}
    agree = abs(lasso["objective"] - evaluate(x, d, lam))
    print(
        f"| {name} | {atoms} | {micro['ours']:.1f} | {micro['spams']:.1f} | {1e6 * sk / x.shape[1]:.0f} | "
        f"{micro['spams'] / micro['ours']:.2f} | {micro['ours omp']:.1f} | {micro['spams omp']:.1f} | "
        f"{1e6 * sk_omp / x.shape[1]:.0f} | {micro['spams omp'] / micro['ours omp']:.2f} | {agree:.0e} |",
        flush=True,
    )


def compare_moved(ours, name, z, atoms):
    """Losses at equal numbers of real parameters: an alignment costs two (angle and scale), a moved atom two."""
    x, y = real(z), real(aligned(z))

    def loss(shapes, cls, nonzeros):
        runs = [ours.moved(shapes, cls, atoms, nonzeros, seed) for seed in range(DRAWS)]
        return np.median([np.sum(run["residuals"]) for run in runs])

    def spams_loss(nonzeros):
        losses = []
        for seed in range(DRAWS):
            d = np.asfortranarray(
                spams.trainDL(
                    shuffled(y, seed),
                    K=atoms,
                    mode=3,
                    lambda1=nonzeros,
                    iter=300,
                    numThreads=THREADS,
                    verbose=False,
                    batchsize=min(512, y.shape[1]),
                )
            )
            losses.append(np.sum((y - d @ spams.omp(y, D=d, L=nonzeros, numThreads=THREADS).toarray()) ** 2))
        return np.median(losses)

    for moved in (2, 3, 5):
        invariant = loss(x, "similarity", moved)
        same, peer = loss(y, "uniform_scaling", 2 * moved - 2), spams_loss(2 * moved - 2)
        sparse = loss(y, "uniform_scaling", moved)
        print(
            f"| {name} | {atoms} | {2 * moved} | {moved} | {invariant:.4f} | {same:.4f} | {peer:.4f} | "
            f"{min(same, peer) / invariant:.2f} | {sparse:.4f} | {sparse / invariant:.2f} |",
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("parts", nargs="*", choices=["learn", "encode", "moved", []])
    arguments = parser.parse_args()
    parts = arguments.parts or ["learn", "encode", "moved"]
    threadpool_limits(THREADS)
    ours = Ours()
    cells_z = shapes(arguments.data / "curves-osteosarcoma-cells", 200, True)
    cells, random = real(aligned(cells_z)), atoms_and_signals(64, 10_000)[1]
    if "learn" in parts:
        for atoms in (10, 25, 50):
            compare_learning(ours, f"cells {cells.shape[1]} × {cells.shape[0]}", cells, atoms, 0.05, atoms < 50)
        compare_learning(ours, "synthetic 10000 × 128", random, 64, 0.05, False)
    if "encode" in parts:
        print(
            "\n| set | atoms | lasso µs | SPAMS | scikit-learn | ratio | pursuit µs | SPAMS | scikit-learn | ratio | "
            "objectives differ |\n|---|---|---|---|---|---|---|---|---|---|---|"
        )
        for atoms in (10, 25, 50):
            compare_encoding(ours, "cells", cells, atoms, 0.05, 5)
        compare_encoding(ours, "synthetic", random, 64, 0.05, 5)
    if "moved" in parts:
        print(
            "\n| set | atoms | real numbers | moved atoms | invariant | aligned | aligned, SPAMS | ratio | "
            "aligned, as many atoms | ratio |\n|---|---|---|---|---|---|---|---|---|---|"
        )
        sets = [
            ("hands", shapes(arguments.data / "curves-hands", 56, False), 10),
            ("cells", cells_z, 25),
            ("MPEG-7", shapes(arguments.data / "curves-mpeg7", 100, True), 50),
        ]
        for name, z, atoms in sets:
            compare_moved(ours, name, z, atoms)


if __name__ == "__main__":
    main()
