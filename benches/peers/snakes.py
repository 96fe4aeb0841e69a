"""Level sets of scikit-image and SimpleITK on the phantoms of the evaluation of segmentation.

    python benches/peers/snakes.py

writes `snakes.json` beside this file: Dice and seconds of CPU time by object and program. The phantoms, first shapes
and truths are those of `crates/shapelex-segmentation/tests/suite/phantoms.rs`; the evaluation puts its own figures
beside them.
"""

import json
import time
from pathlib import Path

import numpy as np
import SimpleITK as sitk
import skimage
from skimage.segmentation import (
    inverse_gaussian_gradient,
    morphological_chan_vese,
    morphological_geodesic_active_contour,
)


def normal(seed, count):
    """Normal numbers by SplitMix64 and Box and Muller."""
    with np.errstate(over="ignore"):
        i = np.arange(1, count + 2, dtype=np.uint64)
        z = np.uint64(seed) + i * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    u = ((z ^ (z >> np.uint64(31))) >> np.uint64(11)).astype(float) * 2.0**-53
    u = u[: len(u) // 2 * 2].reshape(-1, 2)
    radius, angle = np.sqrt(-2 * np.log(1 - u[:, 0])), 2 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1).reshape(-1)[:count]


def axes(size):
    z, y, x = np.indices((size, size, size), dtype=float)
    return x, y, z


def nucleus(std):
    """Volume, truth, first shape."""
    x, y, z = axes(64)
    dx, dy, dz = x - 31.3, y - 30.6, z - 32.2
    r = np.sqrt(dx**2 + dy**2 + dz**2)
    u, v, w = dx / (r + 1e-9), dy / (r + 1e-9), dz / (r + 1e-9)
    lobes = 0.08 * np.cos(3 * np.arctan2(v, u)) * np.maximum(1 - w * w, 0) ** 1.5
    factor = 1 + 0.54 * u * v - 0.15 * (3 * w * w - 1) / 2 + 0.10 * (5 * w**3 - 3 * w) / 2 + lobes
    distance = r - 18 * factor
    volume = 40 + 140 * np.clip(0.5 - distance, 0, 1)
    volume = volume + std * normal(9, volume.size).reshape(volume.shape)
    start = (x - 32.5) ** 2 + (y - 31.5) ** 2 + (z - 31.0) ** 2 <= 11**2
    return volume, distance <= 0, start


def cylinder(std):
    """Volume with a hollow cylinder, its lumen, first shape."""
    x, y, z = axes(100)
    rho = np.hypot(x - 49.5, y - 49.5)
    along = (z >= 10) & (z <= 89)
    wall = np.clip(0.5 + np.minimum(rho - 14, 16 - rho), 0, 1)
    volume = np.where(along, 255 * wall, 0.0)
    volume = volume + std * normal(72, volume.size).reshape(volume.shape)
    start = (np.hypot(x - 51, y - 48.5) <= 6) & (z >= 24) & (z <= 76)
    return volume, (rho <= 14) & along, start


def dice(found, truth):
    return 2 * np.count_nonzero(found & truth) / (np.count_nonzero(found) + np.count_nonzero(truth))


def chan_vese(volume, start):
    return morphological_chan_vese(volume, 60, init_level_set=start, smoothing=1).astype(bool)


def geodesic(volume, start):
    edges = inverse_gaussian_gradient(volume / np.ptp(volume), alpha=1000, sigma=2)
    return morphological_geodesic_active_contour(
        edges, 100, init_level_set=start, smoothing=1, balloon=1, threshold="auto"
    ).astype(bool)


def level_set(volume, start):
    """Geodesic active contours of SimpleITK, set up as in its examples."""
    image = sitk.GetImageFromArray(volume.astype(np.float32))
    speed = sitk.GradientMagnitudeRecursiveGaussian(image, 2.0)
    magnitude = sitk.GetArrayViewFromImage(speed)
    middle = float(np.percentile(magnitude, 97)) / 2
    speed = sitk.Sigmoid(speed, -middle / 3, middle, 1.0, 0.0)
    first = sitk.SignedMaurerDistanceMap(
        sitk.GetImageFromArray(start.astype(np.uint8)), insideIsPositive=False, useImageSpacing=True
    )
    contours = sitk.GeodesicActiveContourLevelSetImageFilter()
    contours.SetPropagationScaling(1.0)
    contours.SetCurvatureScaling(0.5)
    contours.SetAdvectionScaling(1.0)
    contours.SetMaximumRMSError(0.005)
    contours.SetNumberOfIterations(500)
    found = contours.Execute(sitk.Cast(first, sitk.sitkFloat32), speed)
    return sitk.GetArrayFromImage(found) <= 0


PROGRAMS = {
    f"scikit-image {skimage.__version__}, morphological Chan-Vese": chan_vese,
    f"scikit-image {skimage.__version__}, morphological geodesic": geodesic,
    f"SimpleITK {sitk.Version.VersionString()}, geodesic level set": level_set,
}


def main():
    results = []
    for name, make in [("nucleus", nucleus), ("cylinder", cylinder)]:
        for std in [0, 30]:
            volume, truth, start = make(std)
            for program, run in PROGRAMS.items():
                before = time.process_time()
                found = run(volume, start)
                seconds = time.process_time() - before
                overlap = dice(found, truth)
                print(f"{name}, noise {std}, {program}: {overlap:.3f} in {seconds:.2f} s", flush=True)
                row = {"object": name, "noise": std, "program": program}
                results.append(row | {"dice": round(overlap, 3), "seconds": round(seconds, 2)})
    Path(__file__).with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
