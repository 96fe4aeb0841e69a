"""Means and components of plane curves beside numpy, Procrustes means of landmarks beside numpy."""

import numpy as np
from data import cells, random_contours, real
from measure import Row, beside, close
from scipy import fft, linalg

MODES = 20
TIE = 1e-12
CONVERGED = 1e-13


def rows(ours, setting):
    count = 200 if setting.quick else 650
    yield curves(ours, setting, "cyclic mean", cells(setting.data, count), "cyclic")
    yield curves(ours, setting, "mean", cells(setting.data, count), "landmarks")
    many = 10_000 if setting.quick else 100_000
    if not setting.quick:
        yield curves(ours, setting, "cyclic mean of 1e5", random_contours(many, 32), "cyclic", rounds=1)
    yield components(ours, setting, many, 256)
    yield procrustes(ours, setting, 2000 if setting.quick else 10_000, 50)


# --- curves -----------------------------------------------------------------------------------------------------------


def curves(ours, setting, key, z, search, rounds=None):
    """Mean, alignment, 20 modes and all scores, under similarities."""
    (points, count), z = z.shape, np.ascontiguousarray(z.T)
    shapes = ours.file("shapes", real(z.T))
    own, peer, found, reference = beside(
        lambda t: ours.run(
            "mean",
            shapes,
            points,
            search,
            ours.file("mean"),
            threads=t,
            repeats=setting.repeats if rounds is None else 1,
        ),
        lambda t: modes(*aligned(z, search == "cyclic", t)),
        rounds or setting.rounds,
    )
    if search == "cyclic":
        mean = ours.read("mean").reshape(2, points)
        compared, agrees, placed = same_optimum(z, mean[0] + 1j * mean[1], found, reference)
        bound = f"{found['rounds']} × {count} complex transforms of {points}"
        seconds = found["rounds"] * count * ours.transforms(points)
        reference = modes(*placed)
    else:
        compared, agrees = close([found["objective"]], [reference[0]], 1e-9, "objective")
        bound = f"two sums of outer products of {2 * points} at the rate of dgemm"
        seconds = 2 * count * (2 * points) ** 2 / setting.dgemm["1"]
    other, same = close(found["eigenvalues"], reference[1], 1e-7, "eigenvalues")
    name = "start points searched" if search == "cyclic" else "points correspond"
    return Row(
        key,
        f"{count} curves × {points}, {name}: mean, alignment, {MODES} modes",
        own,
        "numpy, scipy",
        peer,
        bound,
        {"1": seconds},
        f"{compared}; {other}",
        agrees and same,
    )


def same_optimum(z, mean, found, reference):
    """Whether numpy, from our mean, moves no shape and finds our objective; also what it found there.

    The alternation ends at one of many optima, and which one depends on last bits: that of numpy's own run is told,
    too.
    """
    placed = aligned(z, True, 2, mean / np.linalg.norm(mean))
    compared, agrees = close([found["objective"]], [placed[1]], 1e-9, "objective")
    other = found["objective"] / reference[0] - 1
    text = f"{compared}; {other:+.0e} beside that of numpy's own search; rounds {found['rounds']} and {reference[2]}"
    return text, agrees and placed[2] <= 2, placed


def aligned(z, search, threads, mean=None):
    """Shapes nearest to their mean, one a row; the objective of the mean, and the rounds.

    Spectra once, one transform a shape and round, and the mean by power iteration; begins with `mean` if it is given.
    """
    placed, rounds = z.copy(), 1
    mean = power(placed, placed[0]) if mean is None else mean
    if search:
        spectra, shifts = fft.fft(z, axis=1, workers=threads), np.zeros(len(z), int)
        every = np.arange(len(z))
        while True:
            scores = np.abs(fft.ifft(spectra * np.conj(fft.fft(mean)), axis=1, workers=threads)) ** 2
            best = scores.argmax(axis=1)
            moved = np.flatnonzero(scores[every, best] > scores[every, shifts] * (1 + TIE))
            if not len(moved) or rounds == 1000:
                break
            shifts[moved] = best[moved]
            turn = (np.arange(z.shape[1]) + shifts[moved, None]) % z.shape[1]
            placed[moved] = np.take_along_axis(z[moved], turn, axis=1)
            mean, rounds = power(placed, mean), rounds + 1
    turns = placed.conj() @ mean
    # The mean space has two real dimensions: the mean, and the mean turned by a right angle.
    return placed * turns[:, None], 2 * np.sum(np.abs(turns) ** 2), rounds


def power(z, mean):
    """The leading eigenvector of the sum of outer products of the rows."""
    while True:
        following = z.T @ (z.conj() @ mean)
        following /= np.linalg.norm(following)
        step, mean = np.abs(np.vdot(following, mean)) / np.linalg.norm(mean), following
        if 1 - step <= CONVERGED:
            return mean


def modes(shapes, objective, rounds):
    x = np.concatenate([shapes.real, shapes.imag], axis=1)
    eigenvalues, _ = principal(x)
    return objective, eigenvalues, rounds


# --- vectors ----------------------------------------------------------------------------------------------------------


def principal(x):
    """The leading eigenvalues of the scatter of the rows, and the scores."""
    y = x - x.mean(axis=0)
    n = y.shape[1]
    values, vectors = linalg.eigh(y.T @ y, subset_by_index=[n - MODES, n - 1])
    return values[::-1], y @ vectors[:, ::-1]


def components(ours, setting, count, length):
    x = np.random.default_rng(3).standard_normal((count, length)) / np.arange(1, length + 1) ** 0.5
    shapes = ours.file("shapes", x.T)
    own, peer, found, reference = beside(
        lambda t: ours.run("components", shapes, length, threads=t, repeats=setting.repeats),
        lambda t: principal(x),
        setting.rounds,
    )
    compared, agrees = close(found["eigenvalues"], reference[0], 1e-10, "eigenvalues")
    operations = count * (length**2 + 2 * MODES * length)
    bounds = {t: operations / rate for t, rate in setting.dgemm.items()}
    return Row(
        "components",
        f"{MODES} components and scores, {count} × {length}",
        own,
        "numpy, scipy",
        peer,
        "sum of outer products and scores at the rate of dgemm",
        bounds,
        compared,
        agrees,
    )


# --- landmarks --------------------------------------------------------------------------------------------------------


def procrustes(ours, setting, count, points):
    rng = np.random.default_rng(4)
    mean = rng.standard_normal((points, 3))
    turns, _ = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    x = (mean + 0.3 * rng.standard_normal((count, points, 3))) @ turns
    x -= x.mean(axis=1, keepdims=True)
    x /= np.linalg.norm(x, axis=(1, 2))[:, None, None]
    shapes = ours.file("shapes", x.transpose(0, 2, 1).reshape(count, -1).T)
    own, peer, found, reference = beside(
        lambda t: ours.run("procrustes", shapes, points, ours.file("mean"), threads=t, repeats=setting.repeats),
        lambda t: generalised(x),
        setting.rounds,
    )
    mine = residual(x, ours.read("mean").reshape(3, points).T)
    compared, agrees = close([mine], [residual(x, reference[0])], 1e-9, "residual")
    return Row(
        "procrustes",
        f"generalised Procrustes mean, {count} × {points} in space",
        own,
        "numpy, batched decompositions",
        peer,
        compared=f"{compared}; rounds {found['rounds']} and {reference[1]}",
        agrees=agrees,
    )


def fits(x, mean):
    """Rotations of the shapes to the mean, and their correlations with it."""
    u, s, v = np.linalg.svd(np.einsum("kni,nj->kij", x, mean))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(v))
    u[:, :, -1] *= sign[:, None]
    s[:, -1] *= sign
    return u @ v, s.sum(axis=1)


def generalised(x):
    """Mean of the shapes, each turned and scaled to it, from the shape with the usual profile."""
    profiles = np.linalg.norm(x, axis=2)
    mean = x[np.linalg.norm(profiles - profiles.mean(axis=0), axis=1).argmin()]
    for rounds in range(1, 1000):
        turns, scales = fits(x, mean)
        following = np.einsum("k,kni,kij->nj", scales, x, turns, optimize=True)
        following /= np.linalg.norm(following)
        moved, mean = np.linalg.norm(following - mean), following
        if moved <= 1e-10:
            return mean, rounds


def residual(x, mean):
    return np.sum(1 - fits(x, mean / np.linalg.norm(mean))[1] ** 2)
