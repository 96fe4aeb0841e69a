"""Seconds of both sides in turn, the rows of the table, and our side as a process."""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path

# OpenBLAS takes new processors for older ones; peers get the kernels that fit.
if "avx512f" in Path("/proc/cpuinfo").read_text():
    os.environ.setdefault("OPENBLAS_CORETYPE", "SkylakeX")

import numpy as np  # noqa: E402
from threadpoolctl import threadpool_limits  # noqa: E402

sys.path[1:1] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "load")]
from build import benches  # noqa: E402

THREADS = (1, 2)


@dataclass
class Row:
    """One task beside a peer, a bound of the machine, or both. Seconds, by threads."""

    key: str
    task: str
    ours: dict
    peer: str = ""
    peers: dict = field(default_factory=dict)
    bound: str = ""
    """What the machine does at best, on one thread unless it says otherwise."""
    bounds: dict = field(default_factory=dict)
    compared: str = ""
    """Which answers were compared, and how far they are apart."""
    agrees: bool = True

    def ratio(self):
        """Seconds of the peer over ours, at the best number of threads of each side."""
        return min(self.peers.values()) / min(self.ours.values()) if self.peers else None

    def fraction(self):
        """Part of the bound that is reached, at the best common number of threads."""
        common = [self.bounds[t] / self.ours[t] for t in self.bounds if t in self.ours]
        return max(common) if common else None

    def record(self):
        return asdict(self) | {"agrees": bool(self.agrees), "ratio": self.ratio(), "fraction": self.fraction()}


def close(one, other, tolerance, what):
    """Text for `compared`, and whether the answers agree to a relative tolerance."""
    one, other = np.asarray(one, float), np.asarray(other, float)
    if one.shape != other.shape:
        return f"{what}: {one.shape} and {other.shape}", False
    apart = float(np.max(np.abs(one - other)) / np.max(np.abs(other)))
    return f"{what}: {apart:.0e} apart", bool(apart <= tolerance)


def timed(work):
    start = time.perf_counter()
    value = work()
    return value, time.perf_counter() - start


def in_turn(sides, rounds):
    """Least seconds of each side and its last answer. The sides take turns: a busy moment of the machine meets all of
    them.

    `sides`: functions by name that give an answer and its seconds.
    """
    least, answers = {}, {}
    for _ in range(rounds):
        for name, side in sides.items():
            answers[name], seconds = side()
            least[name] = min(seconds, least.get(name, np.inf))
    return least, answers


def beside(ours, peer, rounds, threads=THREADS):
    """Both sides on every number of threads: seconds of ours, seconds of the peer, and an answer of each.

    `ours(threads)` is an answer of `Ours.run`, with its seconds; `peer(threads)` a value whose time is taken.
    """
    sides = {}
    for t in threads:

        def own(t=t):
            answer = ours(t)
            return answer, min(answer["seconds"])

        def other(t=t):
            with threadpool_limits(t):
                return timed(lambda: peer(t))

        sides["ours", t], sides["peer", t] = own, other
    least, answers = in_turn(sides, rounds)
    seconds = {side: {str(t): least[side, t] for t in threads} for side in ("ours", "peer")}
    return seconds["ours"], seconds["peer"], answers["ours", threads[-1]], answers["peer", threads[-1]]


class Ours:
    """Our side, as a process that reads and writes files of numbers."""

    def __init__(self):
        programs = benches("peers")
        self.program, self.service = programs["peers"], programs["shapelex"]
        self.folder = tempfile.TemporaryDirectory()

    def file(self, name, array=None):
        """Path of a file with the columns of `array`, one after the other."""
        path = Path(self.folder.name) / name
        if array is not None:
            np.asfortranarray(array, dtype="<f8").ravel(order="F").tofile(path)
        return str(path)

    def read(self, name):
        return np.fromfile(self.file(name), "<f8")

    def run(self, command, *words, threads=2, repeats=1):
        words = [self.program, str(threads), str(repeats), command, *map(str, words)]
        return json.loads(subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True).stdout)

    def learn(self, x, atoms, lam, epochs, seed=0, tolerance=0.0, schedule="online"):
        answer = self.run(
            "learn",
            self.file("x", x),
            x.shape[0],
            atoms,
            seed,
            epochs,
            tolerance,
            schedule,
            self.file("atoms"),
            f"lambda={lam}",
        )
        return self.read("atoms").reshape(x.shape[0], atoms, order="F"), answer["seconds"]

    def moved(self, x, cls, atoms, nonzeros, seed):
        return self.run("moved", self.file("x", x), x.shape[0], cls, atoms, seed, 200, 1e-4, f"nonzeros={nonzeros}")

    def transforms(self, n):
        """Seconds of one inverse complex transform of `n` numbers."""
        return min(self.run("transforms", n, 2000, threads=1, repeats=9)["seconds"]) / 2000
