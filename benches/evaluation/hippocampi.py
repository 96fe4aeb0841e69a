"""Statistics of surfaces whose parameters were never brought into correspondence: 60 hippocampi, each fitted alone.

    target/peers/bin/python benches/evaluation/hippocampi.py --data FOLDER --program PROGRAM [--shapes 24]

Every mesh is fitted by the service with parameters of its own (14 × 14 control points), and with the same parameters
turned at random about the centre of the parameter sphere. For both: mean and modes where points correspond as given
(`landmarks`) and where the rotations of the parameter sphere are searched (`cyclic`). Prints the table of
docs/evaluation.md. Angles of modes are those between displacements of control points, in the frame of the mean.
"""

import argparse
import importlib.util
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
spec = importlib.util.spec_from_file_location("surfaces", HERE.parent / "surfaces" / "run.py")
surfaces = importlib.util.module_from_spec(spec)
spec.loader.exec_module(surfaces)

RIGID = {"transformation": "rigid", "alignment": "procrustes", "frame": "canonical"}
REPRESENTATION = surfaces.surface("sphere", [14, 14])


def rotation(random):
    """A rotation drawn uniformly."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def turned(parameters, by):
    """Longitudes and colatitudes after a rotation of the parameter sphere."""
    u, v = np.asarray(parameters).T
    directions = np.stack(
        [np.sin(np.pi * v) * np.cos(2 * np.pi * u), np.sin(np.pi * v) * np.sin(2 * np.pi * u), np.cos(np.pi * v)]
    )
    x, y, z = by @ directions
    return np.stack([np.arctan2(y, x) / (2 * np.pi) % 1, np.arctan2(np.hypot(x, y), z) / np.pi], axis=1).tolist()


def statistics(service, fits, correspondence, volumes):
    body = {
        "representation": REPRESENTATION,
        **RIGID,
        "correspondence": correspondence,
        "shapes": [{"control_points": fit["control_points"]} for fit in fits],
    }
    start = time.perf_counter()
    answer = service.post("/v1/align", body)
    seconds = time.perf_counter() - start
    measured = surfaces.measures(service, REPRESENTATION, [answer["mean"]])[0]
    aligned = np.array([one["control_points"] for one in answer["aligned"]]).reshape(len(fits), -1)
    centred = aligned - aligned.mean(axis=0)
    _, singular, modes = np.linalg.svd(centred, full_matrices=False)
    explained = singular**2 / (singular**2).sum()
    changes = [one["motion"]["change"] for one in answer["aligned"] if "motion" in one]
    return {
        "volume": measured["volume"] / np.mean(volumes) - 1,
        "explained": explained[:3],
        "modes": modes[:3],
        "seconds": seconds,
        "residual": float(np.sqrt(np.mean([one["residual"] ** 2 for one in answer["aligned"]]))),
        "mean": answer["mean"],
        "change": max(changes, default=None),
        "rounds": answer["rounds"],
        "warnings": len(answer["warnings"]),
    }


def angle(a, b):
    return np.degrees(np.arccos(min(1, abs(float(a @ b)))))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--program", required=True)
    parser.add_argument("--shapes", type=int, default=60)
    arguments = parser.parse_args()
    given = list(surfaces.meshes(arguments.data / "surfaces-hippocampus" / "meshes").values())[: arguments.shapes]
    random = np.random.default_rng(7)
    with tempfile.TemporaryDirectory() as folder:
        service = surfaces.Service(arguments.program, folder, None)
        try:
            alone = surfaces.fit(service, REPRESENTATION, given)
            again = [
                {**one, "parameters": turned(fit["parameters"], rotation(random))} for one, fit in zip(given, alone)
            ]
            turned_fits = surfaces.fit(service, REPRESENTATION, again)
            volumes = [measure["volume"] for measure in surfaces.measures(service, REPRESENTATION, alone)]
            cases = [("alone", alone), ("turned at random", turned_fits), ("the same, backwards", turned_fits[::-1])]
            turned = [measure["volume"] for measure in surfaces.measures(service, REPRESENTATION, turned_fits)]
            ratio = np.mean(turned) / np.mean(volumes)
            print(f"{len(given)} meshes; volumes of the turned fits / of those alone: {ratio:.4f}\n")
            surfaces.table(
                "parameters",
                "correspondence",
                "volume of the mean − mean of the volumes",
                "root mean square residual, mm·L₂",
                "modes 1, 2, 3",
                "angles to the modes of `alone`",
                "largest change by a motion",
                "rounds",
                "warned",
                "seconds",
            )
            for correspondence in ("landmarks", "cyclic"):
                reference = None
                for name, fits in cases:
                    found = statistics(service, fits, correspondence, volumes)
                    reference = reference or found
                    angles = ", ".join(f"{angle(a, b):.1f}°" for a, b in zip(found["modes"], reference["modes"]))
                    explained = ", ".join(f"{100 * part:.0f} %" for part in found["explained"])
                    change = "–" if found["change"] is None else f"{100 * found['change']:.1f} %"
                    surfaces.row(
                        name,
                        f"`{correspondence}`",
                        f"{100 * found['volume']:+.1f} %",
                        f"{found['residual']:.3f}",
                        explained,
                        angles,
                        change,
                        found["rounds"],
                        "yes" if found["warnings"] else "no",
                        f"{found['seconds']:.1f}",
                    )
        finally:
            service.process.terminate()


if __name__ == "__main__":
    sys.exit(main())
