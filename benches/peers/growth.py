"""Times against control points and atoms, for the plots; those against shapes and clients come from stored.py and
latency.py."""

import spams
from codes import LAMBDA, NONZEROS
from data import atoms_and_signals, random_contours, real
from measure import beside


def control_points(ours, setting, count=1000):
    """Mean, alignment, 20 modes and scores of 1000 curves, points given and start points searched, on two threads."""
    found = []
    for points in (16, 32, 64, 128, 256) if setting.quick else (16, 32, 64, 128, 256, 512, 1024, 2048):
        shapes = ours.file("shapes", real(random_contours(count, points)))
        at = {"points": points, "shapes": count, "transform": ours.transforms(points)}
        for search in ("landmarks", "cyclic"):
            runs = [
                ours.run("mean", shapes, points, search, ours.file("mean"), repeats=3 if points < 512 else 1)
                for _ in range(setting.rounds)
            ]
            at[search] = min(min(run["seconds"]) for run in runs)
            at[f"{search} rounds"] = runs[0]["rounds"]
        found.append(at)
    return found


def atoms(ours, setting):
    """Seconds a signal of lasso and pursuit and of SPAMS, on two threads."""
    found = []
    for count in (8, 64, 256) if setting.quick else (8, 16, 32, 64, 128, 256, 512, 1024):
        d, x = atoms_and_signals(count, 500 if setting.quick else 4000)
        files, at = (ours.file("x", x), ours.file("d", d)), {"atoms": count, "length": len(x)}
        for name, how, peer in (
            ("lasso", f"lambda={LAMBDA}", lambda t: spams.lasso(x, D=d, lambda1=LAMBDA, mode=2, numThreads=t)),
            ("pursuit", f"nonzeros={NONZEROS}", lambda t: spams.omp(x, D=d, L=NONZEROS, numThreads=t)),
        ):
            own, theirs, _, codes = beside(
                lambda t: ours.run("encode", *files, *d.shape, how, threads=t, repeats=5),
                peer,
                setting.rounds,
                threads=(2,),
            )
            at |= {
                name: own["2"] / x.shape[1],
                f"SPAMS {name}": theirs["2"] / x.shape[1],
                f"{name} in use": codes.nnz / x.shape[1],
            }
        found.append(at)
    return found
