"""Plain peers for classes of outlines: Procrustes coordinates or elliptic Fourier coefficients, with LDA and
neighbours.

Needs numpy and scikit-learn. Everything is learnt from the training outlines alone; the peers are reported with the
best of their sizes, by the shapes they are judged by, which flatters them.
"""

import numpy
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.neighbors import KNeighborsClassifier

POINTS = 64
COMPONENTS = (5, 10, 15, 20, 30, 40)
HARMONICS = 16
ROUNDS = 30


def resampled(points):
    """Equally spaced by arc length, counter-clockwise, centred, of unit size, from the end of the major axis."""
    p = numpy.array(points, float)
    p = numpy.vstack([p, p[:1]])
    steps = numpy.hypot(*numpy.diff(p, axis=0).T)
    kept = numpy.r_[True, steps > 0]
    p, along = p[kept], numpy.r_[0, numpy.cumsum(steps[steps > 0])]
    at = numpy.linspace(0, along[-1], POINTS + 1)[:-1]
    z = numpy.interp(at, along, p[:, 0]) + 1j * numpy.interp(at, along, p[:, 1])
    if numpy.imag(numpy.sum(numpy.conj(z) * numpy.roll(z, -1))) < 0:
        z = z[::-1]
    z = z - z.mean()
    spectrum = numpy.fft.fft(z)
    phase = (numpy.angle(spectrum[-1]) - numpy.angle(spectrum[1])) / 2
    starts = [round(t / (2 * numpy.pi) * POINTS) % POINTS for t in (phase, phase + numpy.pi)]
    z = numpy.roll(z, -max(starts, key=lambda s: abs(z[s])))
    return z / numpy.linalg.norm(z)


def placed(shapes, mean):
    """Every shape from the start that matches the mean best."""
    spectra = numpy.fft.fft(shapes, axis=1) * numpy.conj(numpy.fft.fft(mean))[None]
    best = abs(numpy.fft.ifft(spectra, axis=1)).argmax(1)
    return numpy.take_along_axis(shapes, (numpy.arange(POINTS)[None] + best[:, None]) % POINTS, 1)


def full_mean(shapes):
    """Full Procrustes mean (Kent) with its start points."""
    for _ in range(ROUNDS):
        mean = numpy.linalg.eigh(shapes.T @ shapes.conj())[1][:, -1]
        next_shapes = placed(shapes, mean)
        if numpy.array_equal(next_shapes, shapes):
            break
        shapes = next_shapes
    return mean


def procrustes(shapes, mean):
    shapes = placed(shapes, mean)
    aligned = (shapes.conj() @ mean)[:, None] * shapes
    return numpy.hstack([aligned.real, aligned.imag])


def elliptic(shapes):
    """Coefficients of harmonics normalised by the first ellipse: size, turn and start."""
    rows = []
    for z in shapes:
        spectrum = numpy.fft.fft(z)
        a, b = spectrum[1], spectrum[-1]
        start, turn = (numpy.angle(b) - numpy.angle(a)) / 2, (numpy.angle(a) + numpy.angle(b)) / 2
        k = numpy.r_[1 : HARMONICS + 1, -HARMONICS:0]
        c = spectrum[k] * numpy.exp(1j * (k * start - turn)) / (abs(a) + abs(b))
        rows.append(numpy.r_[c.real, c.imag])
    return numpy.array(rows)


def scored(known, labels, asked, truth):
    """Accuracy of every classifier on these features."""
    found = {}
    centre = known.mean(0)
    axes = numpy.linalg.svd(known - centre, full_matrices=False)[2]
    for count in COMPONENTS:
        kept = axes[: min(count, len(axes), len(known) - 1)]
        a, b = (known - centre) @ kept.T, (asked - centre) @ kept.T
        scale = a.std(0) + 1e-300
        model = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto").fit(a / scale, labels)
        found[f"LDA {count}"] = float(numpy.mean(model.predict(b / scale) == truth))
    for votes in (1, 5):
        model = KNeighborsClassifier(votes).fit(known, labels)
        found[f"{votes}-NN"] = float(numpy.mean(model.predict(asked) == truth))
    return found


def accuracies(training, test):
    """Accuracy of every peer, by its name."""
    known, asked = (numpy.array([resampled(s["points"]) for s in shapes]) for shapes in (training, test))
    labels, truth = (numpy.array([s["label"] for s in shapes]) for shapes in (training, test))
    mean = full_mean(known)
    by_procrustes = scored(procrustes(known, mean), labels, procrustes(asked, mean), truth)
    by_fourier = scored(elliptic(known), labels, elliptic(asked), truth)
    found = {f"Procrustes {name}": value for name, value in by_procrustes.items()}
    return found | {f"Fourier {name}": value for name, value in by_fourier.items()}
