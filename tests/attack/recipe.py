"""Requests written as recipes: JSON in which a node with a `$` stands for something large.

    {"$repeat": X, "times": n}            n copies of X in the list around it; with "vary", `$points` in X get seeds of
    their own
    {"$points": {"kind": "circle", ...}}  a list of points, see `points`
    {"$string": "a", "times": n}          a long string
    {"$nest": n}                          n lists inside of each other
    {"$raw": "1e400"}                     text that is no JSON value of Python's
    {"$object": [[key, X], ...]}          an object whose keys may be variables
    {"$keys": n}                          an object of n keys
    {"$var": "n"}                         a variable of the case; "$n" as a number of a recipe is one too

A body of a few hundred characters can so be sent as 60 MB, saved and sent again.
"""

import gzip
import json
import zlib
from math import cos, pi, sin
from random import Random

# Level of compression: what is repeated shrinks by a factor of about 1000 at any level from 6 on.
LEVEL = 6
# Between the parts of a form.
BOUNDARY = "boundary-of-parts"
# Characters of one repetition: four times the longest body that the service reads. A search multiplies recipes inside
# of each other, and must not fill the memory of its own machine.
LONGEST = 256 << 20


class Recipe:
    """Turns recipes into bytes; `variables` are those of the case."""

    def __init__(self, variables=None):
        self.variables = variables or {}

    def number(self, value, default=None):
        """A number of a recipe, which may be the name of a variable."""
        if value is None:
            return default
        return self.variables[value[1:]] if isinstance(value, str) and value.startswith("$") else value

    def text(self, node, turn=0):
        """The JSON text of a node; `turn` tells copies that vary from each other."""
        if isinstance(node, dict):
            directive = next((key for key in node if key.startswith("$")), None)
            if directive:
                return getattr(self, f"_{directive[1:]}")(node, turn)
            return "{" + ",".join(f"{json.dumps(key)}:{self.text(value, turn)}" for key, value in node.items()) + "}"
        if isinstance(node, list):
            return "[" + ",".join(filter(None, (self.text(item, turn) for item in node))) + "]"
        return json.dumps(node)

    def _repeat(self, node, turn):
        times = int(self.number(node["times"]))
        if node.get("vary"):
            return ",".join(self.text(node["$repeat"], turn + k) for k in range(times))
        one = self.text(node["$repeat"], turn)
        times = min(times, LONGEST // (len(one) + 1))
        return (one + ",") * (times - 1) + (one if times > 0 else "")

    def _points(self, node, turn):
        settings = {
            key: self.number(value) if not isinstance(value, str) or value[:1] == "$" else value
            for key, value in node["$points"].items()
        }
        settings["seed"] = settings.get("seed", 1) + turn
        return json.dumps(points(**settings), separators=(",", ":"))

    def _string(self, node, _):
        return json.dumps(node["$string"] * int(self.number(node["times"])))

    def _nest(self, node, _):
        depth = int(self.number(node["$nest"]))
        return "[" * depth + "]" * depth

    def _raw(self, node, _):
        return node["$raw"]

    def _object(self, node, turn):
        pairs = ((self.number(key), self.text(value, turn)) for key, value in node["$object"])
        return "{" + ",".join(f"{json.dumps(key)}:{value}" for key, value in pairs) + "}"

    def _keys(self, node, _):
        return "{" + ",".join(f'"{k:x}":0' for k in range(int(self.number(node["$keys"])))) + "}"

    def _var(self, node, _):
        return json.dumps(self.variables[node["$var"]])

    def body(self, request):
        """The bytes of a request on the wire, and how many they are decompressed; nothing when it has no body.

        With `form`, the JSON text is the part of that name of a form.
        """
        if "raw" in request:
            return self._lines(request)
        if "body" not in request:
            return None, 0
        text = self.text(request["body"]) + " " * int(self.number(request.get("pad"), 0))
        if part := request.get("form"):
            text = f'--{BOUNDARY}\r\ncontent-disposition: form-data; name="{part}"\r\n\r\n{text}\r\n--{BOUNDARY}--\r\n'
        plain = text.encode()
        return (gzip.compress(plain, LEVEL, mtime=0) if self.number(request.get("gzip")) else plain), len(plain)

    def _lines(self, request):
        """Pieces of text one after the other, each so many times; compressed as they are made, for they may be
        gigabytes."""
        packer = zlib.compressobj(LEVEL, wbits=31) if self.number(request.get("gzip")) else None
        chunks, size = [], 0
        for piece in request["raw"]:
            text, times = piece["text"].encode(), int(self.number(piece.get("times"), 1))
            at_once = max(1, (1 << 20) // max(1, len(text)))
            block = text * min(times, at_once)
            packed = lambda data: packer.compress(data) if packer else data
            for _ in range(times // at_once):
                chunks.append(packed(block))
            chunks.append(packed(text * (times % at_once)))
            size += times * len(text)
        if packer:
            chunks.append(packer.flush())
        return b"".join(chunks), size


def points(kind="circle", count=8, dimension=2, scale=1.0, offset=0.0, seed=1, at=None, by=1.0, which=3):
    """Points of a shape.

    `circle` (with three bumps of its own), `round` (without), `random` (in a box), `line`, `spike` (all equal but one,
    moved by `by` in the first coordinate), `collapsed` (all equal), `walk` (steps at random), `zigzag`, `sphere`
    (spread over one). `scale` and then `offset` act on all coordinates.
    """
    random = Random(seed)
    centre = at if isinstance(at, list) else [0.0 if at is None else at] * dimension
    rows = _MAKERS[kind](int(count), int(dimension), random)
    if kind == "spike" and rows:
        rows[int(which) % len(rows)][0] += by / scale if scale else 0.0
    return [[float(f"{scale * x + c + offset:.9g}") for x, c in zip(row, centre)] for row in rows]


def _circle(count, dimension, random):
    bump, phase = random.uniform(0.05, 0.3), random.uniform(0, 2 * pi)
    rows = []
    for k in range(count):
        t = 2 * pi * k / count
        r = 1 + bump * cos(3 * t + phase)
        rows.append([1.4 * r * cos(t), r * sin(t), 0.3 * sin(2 * t + phase)][:dimension])
    return rows


def _walk(count, dimension, random):
    place, rows = [0.0] * dimension, []
    for _ in range(count):
        place = [x + random.gauss(0, 1) for x in place]
        rows.append(list(place))
    return rows


def _sphere(count, dimension, random):
    golden = pi * (3 - 5**0.5)
    rows = []
    for k in range(count):
        z = 1 - 2 * (k + 0.5) / count
        r = (1 - z * z) ** 0.5 * (1 + 0.05 * random.random())
        rows.append([r * cos(golden * k), r * sin(golden * k), z][:dimension])
    return rows


_MAKERS = {
    "circle": _circle,
    "round": lambda count, dimension, _: [
        [cos(2 * pi * k / count), sin(2 * pi * k / count), 0.0][:dimension] for k in range(count)
    ],
    "walk": _walk,
    "sphere": _sphere,
    "random": lambda count, dimension, random: [
        [random.uniform(-1, 1) for _ in range(dimension)] for _ in range(count)
    ],
    "line": lambda count, dimension, _: [[float(k)] + [0.0] * (dimension - 1) for k in range(count)],
    "zigzag": lambda count, dimension, _: [[k / count, float(k % 2), 0.0][:dimension] for k in range(count)],
    "collapsed": lambda count, dimension, _: [[0.0] * dimension for _ in range(count)],
    "spike": lambda count, dimension, _: [[0.0] * dimension for _ in range(count)],
}
