"""Small requests over loopback, beside bare axum that echoes the same JSON, through the same client."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from measure import Row

from service import Service

CONNECTIONS = (1, 2, 4, 8, 16, 32, 64, 128, 256)
QUICK = (1, 8, 64)
POINTS = 12


def contour(seed):
    rng = np.random.default_rng(seed)
    t = 2 * np.pi * np.arange(POINTS) / POINTS
    bumps = sum(
        (rng.standard_normal() + 1j * rng.standard_normal()) * np.exp(1j * k * t) / 8 for k in (-3, -2, -1, 2, 3)
    )
    return 2 * np.exp(1j * t) + bumps + complex(*rng.standard_normal(2))


def body():
    """A projection of one contour, and its squared distance as numpy finds it.

    The spline is a polygon, whose integrals are sums with the circulant of (1, 4, 1)/6.
    """
    x, reference = contour(1), contour(2)
    points = lambda z: {"points": np.stack([z.real, z.imag], axis=1).tolist()}
    curve = {
        "kind": "closed_curve",
        "dimension": 2,
        "control_points": POINTS,
        "generator": {"name": "bspline", "degree": 1},
    }
    gram = lambda z: (np.roll(z, 1) + 4 * z + np.roll(z, -1)) / 6 / POINTS
    a, b = x - x.mean(), reference - reference.mean()
    inner = lambda p, q: np.vdot(p, gram(q))
    distance = (inner(a, a) - abs(inner(a, b)) ** 2 / inner(b, b)).real
    request = {
        "representation": curve,
        "transformation": "similarity",
        "reference": points(reference),
        "shapes": [points(x)],
    }
    return json.dumps(request), distance


def growth(ours, setting):
    """Rates and latencies for every number of connections, of the service and of the echo in turn."""
    text, expected = body()
    files = {"project": Path(ours.file("project.json")), "livez": Path(ours.file("empty"))}
    files["project"].write_text(text)
    files["livez"].write_text("")
    seconds, found = 0.5 if setting.quick else 2, []
    with tempfile.TemporaryDirectory(prefix="shapelex-peers-") as folder:
        service = Service(setting.binary, Path(folder))
        service.start()
        echo = subprocess.Popen([ours.program, "2", "1", "echo"], stdout=subprocess.PIPE, text=True)
        addresses = {"service": f"127.0.0.1:{service.port}", "echo": echo.stdout.readline().strip()}
        try:
            for connections in QUICK if setting.quick else CONNECTIONS:
                at = {"connections": connections}
                for name, method, path in (("project", "POST", "/v1/project"), ("livez", "GET", "/livez")):
                    runs = {side: [] for side in addresses}
                    for _ in range(setting.rounds):
                        for side, address in addresses.items():
                            runs[side].append(
                                ours.run("load", address, method, path, files[name], connections, seconds)
                            )
                    for side in addresses:
                        best = max(runs[side], key=lambda run: run["rate"])
                        best["refused"] = sum(run["refused"] for run in runs[side])
                        answer = best.pop("body")
                        if (side, name) == ("service", "project"):
                            squared = json.loads(answer)["results"][0]["squared_distance"]
                            best["apart"] = abs(squared / expected - 1)
                        at[f"{side} {name}"] = best
                found.append(at)
                print(json.dumps(at), file=sys.stderr, flush=True)
        finally:
            service.process.kill()
            echo.kill()
            echo.wait()
    return found


def rows_of(clients):
    for at in clients:
        if at["connections"] not in QUICK:
            continue
        for name, route in (("project", "`POST /v1/project`, 12 points"), ("livez", "`GET /livez`")):
            own, echo = at[f"service {name}"], at[f"echo {name}"]
            latencies = (
                f"p50 {1e6 * own['p50']:.0f}, p99 {1e6 * own['p99']:.0f} µs; echo {1e6 * echo['p50']:.0f}, "
                f"{1e6 * echo['p99']:.0f} µs; {own['refused']} refused"
            )
            apart = own.get("apart", 0)
            yield Row(
                f"{name}, {at['connections']} connections",
                f"{route}, {at['connections']} connections: time a request",
                {"2": 1 / own["rate"]},
                bound="axum that echoes the JSON",
                bounds={"2": 1 / echo["rate"]},
                compared=latencies + (f"; distance {apart:.0e} apart" if name == "project" else ""),
                agrees=own["refused"] == 0 and apart < 1e-9,
            )
