"""Shapes that both sides get. Without a folder of data: the example cells of the repository, and smooth random
contours."""

import json

import numpy as np
from build import ROOT


def contours(folder):
    with open(folder / "curves.ndjson") as lines:
        return [np.array(json.loads(line)["points"], float) for line in lines]


def resampled(points, count, closed):
    """`count` points equally spaced by arc length, as complex numbers."""
    z = points[:, 0] + 1j * points[:, 1]
    z = z[np.r_[True, np.abs(np.diff(z)) > 0]]
    if closed:
        z = np.append(z[:-1] if z[0] == z[-1] else z, z[0])
    length = np.r_[0, np.cumsum(np.abs(np.diff(z)))]
    at = np.linspace(0, length[-1], count, endpoint=not closed)
    return np.interp(at, length, z.real) + 1j * np.interp(at, length, z.imag)


def counter_clockwise(z):
    area = np.sum(np.imag(np.conj(z) * np.roll(z, -1)))
    return z if area > 0 else np.r_[z[:1], z[:0:-1]]


def canonical_start(z):
    """The contour from the end of its major axis that is farther from the centroid."""
    f = np.fft.fft(z) / len(z)
    shift = int(round((np.angle(f[-1]) - np.angle(f[1])) / 2 / (2 * np.pi) * len(z)))
    ends = [np.roll(z, -(shift + half)) for half in (0, len(z) // 2)]
    return max(ends, key=lambda w: abs(w[0] - w.mean()))


def shapes(folder, count, closed):
    """Centred contours of unit norm with corresponding points, one complex column each."""
    columns = []
    for points in contours(folder):
        z = resampled(points, count, closed)
        z = canonical_start(counter_clockwise(z)) if closed else z
        z = z - z.mean()
        columns.append(z / np.linalg.norm(z))
    return np.stack(columns, axis=1)


def aligned(z):
    """Every shape turned to the full Procrustes mean."""
    _, vectors = np.linalg.eigh(z @ z.conj().T)
    turn = vectors[:, -1].conj() @ z
    return z * np.conj(turn) / np.abs(turn)


def real(z):
    return np.asfortranarray(np.concatenate([z.real, z.imag]))


def deformed(z, copy):
    """A smooth deformation of a contour that is no similarity."""
    bend = (
        0.02
        * copy
        * (
            np.sin(3 * (z.real + 0.7 * z.imag) / np.ptp(z.real) + copy)
            + 1j * np.sin(4 * (z.real + 0.7 * z.imag) / np.ptp(z.real) + copy)
        )
    )
    return z + np.ptp(z.real) * bend


def filled(contours, count):
    """The first `count` contours, filled up with deformed ones; centred, of unit norm, one a column."""
    columns = [deformed(contours[k % len(contours)], k // len(contours)) for k in range(count)]
    z = np.stack([c - c.mean() for c in columns], axis=1)
    return z / np.linalg.norm(z, axis=0)


def cells(folder, count, points=200):
    """Contours of cells that begin anywhere."""
    path = (
        folder / "curves-osteosarcoma-cells" / "curves.ndjson"
        if folder
        else ROOT / "examples" / "cells" / "cells.ndjson"
    )
    with open(path) as lines:
        outlines = [np.array(json.loads(line)["points"], float) for line in lines]
    return filled([counter_clockwise(resampled(outline, points, True)) for outline in outlines], count)


def silhouettes(folder, count, points=100):
    """MPEG-7 silhouettes, or random contours."""
    if not folder:
        return random_contours(count, points)
    return filled(
        [counter_clockwise(resampled(outline, points, True)) for outline in contours(folder / "curves-mpeg7")], count
    )


def random_contours(count, points, seed=1):
    """Smooth contours of eight random harmonics, centred, of unit norm, one a column; each begins anywhere."""
    rng = np.random.default_rng(seed)
    spectra = np.zeros((points, count), complex)
    for k in range(1, 9):
        for index in (k, -k):
            spectra[index] = (rng.standard_normal(count) + 1j * rng.standard_normal(count)) / k**2
    spectra[1] += 2
    spectra *= np.exp(2j * np.pi * np.outer(np.fft.fftfreq(points, 1 / points), rng.random(count)))
    z = np.fft.ifft(spectra, axis=0)
    return z / np.linalg.norm(z, axis=0)


def atoms_and_signals(atoms, count=4000, length=128, seed=0):
    """Atoms of unit norm, and combinations of five of them with noise, of unit norm."""
    rng = np.random.default_rng(seed)
    d = rng.standard_normal((length, atoms))
    d /= np.linalg.norm(d, axis=0)
    codes = np.zeros((atoms, count))
    for k in range(count):
        codes[rng.choice(atoms, 5, replace=False), k] = rng.standard_normal(5)
    x = d @ codes + 0.02 * rng.standard_normal((length, count))
    return np.asfortranarray(d), np.asfortranarray(x / np.linalg.norm(x, axis=0))
