"""Spline surfaces through the running service: refinement, sharp poles, poles along a meridian, fluxes, sizes for a
tolerance; prints the section of docs/evaluation.md.

    python benches/evaluation/splines.py [--binary PROGRAM]

Shapes are formulas and seeded random control points. Nothing beyond the standard library.
"""

import argparse
import math
import tempfile
from random import Random

from run import ROOT, Service

TAU = 2 * math.pi
CIRCLE = [[0, 0], [0, TAU], [0, -TAU]]
HALF = {"name": "interpolator", "family": "half_integer_shifts", "domain_poles": CIRCLE}
EVEN = {"name": "interpolator", "family": "half_integer_shifts", "domain_poles": [[0, 0], [0, 0], [0, TAU], [0, -TAU]]}
EXPONENTIAL = {"name": "exponential", "domain_poles": CIRCLE}
SPLINE = {"name": "bspline", "degree": 3}


def surface(topology, size, generators=None):
    representation = {"kind": "surface", "topology": topology, "control_points": size}
    return {**representation, "generators": generators} if generators else representation


def points(service, representation, shape, places):
    body = {"representation": representation, "shapes": [shape], "parameters": places}
    return service.call("POST", "/v1/evaluate", body)["evaluations"][0]["points"]


def apart(one, other):
    return max(math.dist(p, q) for p, q in zip(one, other))


def refinement(service, random):
    cases = [
        ("torus, half-integer shifts, 3 poles", "torus", [HALF, HALF], [4, 4], 16, 2),
        ("torus, the same", "torus", [HALF, HALF], [4, 4], 16, 4),
        ("cylinder, half-integer shifts, 3 and 4 poles", "cylinder", [HALF, EVEN], [6, 5], 6 * 10, 2),
        ("sphere, exponential and cubic B-splines", "sphere", [EXPONENTIAL, SPLINE], [6, 5], 6 * 4 + 6, 2),
        ("sharp sphere, cubic B-splines", "sharp_sphere", [SPLINE, SPLINE], [6, 5], 6 * 6 + 2, 3),
        ("sphere, half-integer shifts along the meridian", "sphere", [EXPONENTIAL, HALF], [6, 5], 6 * 4 + 6, 2),
        ("torus, trigonometric", "torus", None, [4, 4], 16, 2),
    ]
    print(
        "| random control points in ±1, refined | factor | `exact` | largest distance of 2 000 points | `l2_change` |"
    )
    print("|---|---|---|---|---|")
    for text, topology, generators, size, rows, factor in cases:
        coarse = surface(topology, size, generators)
        shape = {"control_points": [[random.uniform(-1, 1) for _ in range(3)] for _ in range(rows)]}
        answer = service.call("POST", "/v1/refine", {"representation": coarse, "shapes": [shape], "factor": factor})
        shifts, fine = answer["parameter_shifts"], answer["shapes"][0]
        places = [[random.random(), random.random()] for _ in range(2000)]
        moved = [[u + shifts[0], v + shifts[1]] for u, v in places]
        found = apart(
            points(service, coarse, shape, places),
            points(service, answer["representation"], {"control_points": fine["control_points"]}, moved),
        )
        change = fine.get("l2_change")
        told = "–" if change is None else f"{change:.3f}"
        print(f"| {text} | {factor} | {str(answer['exact']).lower()} | {found:.1e} | {told} |", flush=True)
    print()


def grid(size, at):
    return {"points": [[at(k / size[0], l / size[1]) for l in range(size[1] + 1)] for k in range(size[0])]}


def lemon(u, v):
    radius = 4 * v * (1 - v)
    return [radius * math.cos(TAU * u), radius * math.sin(TAU * u), 1 - 2 * v]


def ball(u, v):
    radius = math.sin(math.pi * v)
    return [radius * math.cos(TAU * u), radius * math.sin(TAU * u), math.cos(math.pi * v)]


def poles(service, random):
    print(
        "| lemon with cones at its poles, `trigonometric` and `cubic` | largest distance of 2 000 points, 6 × 4 | "
        "12 × 8 | 24 × 16 |"
    )
    print("|---|---|---|---|")
    places = [[random.random(), random.random()] for _ in range(2000)]
    wanted = [lemon(u, v) for u, v in places]
    for topology in ["sharp_sphere", "sphere"]:
        found = []
        for size in [[6, 4], [12, 8], [24, 16]]:
            representation = surface(topology, size, [{"name": "trigonometric"}, {"name": "cubic"}])
            found.append(apart(points(service, representation, grid(size, lemon), places), wanted))
        print(f"| `{topology}` | {' | '.join(f'{x:.1e}' for x in found)} |", flush=True)
    print()


def flux(service):
    print("| field through the unit sphere, 6 × 5 | flux | error |")
    print("|---|---|---|")
    for degree in range(1, 9, 2):
        unit = [[int(c == i) for i in range(3)] for c in range(3)]
        terms = [{"powers": [degree * x for x in axis], "coefficients": axis} for axis in unit]
        body = {"representation": surface("sphere", [6, 5]), "shapes": [grid([6, 5], ball)], "field": {"terms": terms}}
        found = service.call("POST", "/v1/measure", body)["results"][0]["flux"]
        # ∭ 3 d z^(d − 1) dV over the ball.
        wanted = 12 * math.pi / (degree + 2)
        print(f"| (x^{degree}, y^{degree}, z^{degree}) | {found:.12f} | {abs(found - wanted):.1e} |", flush=True)
    print()


def meridian(service):
    along = {"name": "exponential", "domain_poles": [[0, 0], [0, math.pi], [0, -math.pi]]}
    representation = surface("sphere", [9, 9], [EXPONENTIAL, along])
    body = {"representation": representation, "surfaces": [{"surface": {"name": "sphere", "radius": 1}}]}
    shape = service.call("POST", "/v1/idealised", body)["shapes"][0]
    volume = service.call("POST", "/v1/measure", {"representation": representation, "shapes": [shape]})["results"][0][
        "volume"
    ]
    error = volume - 4 * math.pi / 3
    print(
        f"Unit sphere of exponential B-splines, 9 × 9, domain poles 0, ±2πj and 0, ±πj: volume − 4π/3 = {error:.1e}.\n"
    )


def bean(u, v):
    x, y, z = ball(u, v)
    bump = 1 + 0.15 * math.sin(1 + 2 * x) * y + 0.1 * math.cos(0.7) * x * z
    return [1.2 * bump * x, 0.8 * bump * y + 0.2 * z * z, 1.5 * bump * z]


def tolerance(service):
    print("| tolerance, a bean of 60 × 41 points | size | residual |")
    print("|---|---|---|")
    shape = {"points": [[bean(k / 60, l / 40) for l in range(41)] for k in range(60)]}
    for wanted in [0.03, 0.01, 0.003, 0.001, 0.0003]:
        representation = {"kind": "surface", "topology": "sphere", "tolerance": wanted}
        found = service.call("POST", "/v1/fit", {"representation": representation, "shapes": [shape]})["results"][0]
        size = found["representation"]["control_points"]
        print(f"| {wanted} | {size[0]} × {size[1]} | {found['residual']:.5f} |", flush=True)
    print()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default=ROOT / "target/release/shapelex")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        service = Service(arguments.binary, folder)
        try:
            refinement(service, Random(1))
            poles(service, Random(2))
            meridian(service)
            flux(service)
            tolerance(service)
        finally:
            service.process.terminate()


if __name__ == "__main__":
    main()
