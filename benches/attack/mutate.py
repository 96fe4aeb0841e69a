"""Requests that grow out of each other: the schemas of the interface document say what may be where, and chance says
what is.

A request is a recipe (tests/attack/recipe.py) with method, path, query and body, so that what is large stays small to
save.
"""

import copy
from collections import namedtuple

# Numbers at which arithmetic, sizes and loops change their mind.
NUMBERS = [0, 1, 2, 3, -1, 0.5, 1e-8, 1e-158, 5e-324, 1e6, 1e15, 1e99, 1.7e308, 2**31, 2**53, 2**64]
COUNTS = [1, 2, 3, 5, 9, 17, 33, 65, 129, 257, 513, 1025, 2048, 4096, 20000, 100000, 1000000]
SCALES = [1, 1, 1, 1e-158, 1e-8, 1e-3, 1e6, 1e15, 1e99]
PLACES = [0, 0, 0, 1, 1000, 1e6, 1e15]
KINDS = ["circle", "round", "random", "walk", "zigzag", "line", "collapsed", "spike", "sphere"]
TINY = [[], {}, 0, None, "", [[]], {"a": 1}, [0, 0], [0, 1, 2]]
# What addresses take, where the document has no list of it.
WORDS = {
    "format": ["json", "svg", "csv", "npy", "obj", "ply", "stl", "gltf"],
    "grid": ["2,2", "64,64", "500,500", "1,100000"],
    "limit": [1, 100, 1000],
    "transformation": ["similarity", "affine", "rigid"],
    "alignment": ["projection", "procrustes"],
    "poles": ["[[0,0],[0,0.5],[0,-0.5]]"],
}
TEXTS = ["a", "\u202e", "\u0000", "é", "[", '"']

Node = namedtuple("Node", "parent key value schemas")


class Schemas:
    """The schemas of a document, with references followed and alternatives laid side by side."""

    def __init__(self, document):
        self.named = document["components"]["schemas"]

    def options(self, schema, depth=0):
        """The concrete schemas that a schema stands for."""
        if depth > 6 or not isinstance(schema, dict):
            return []
        if "$ref" in schema:
            return self.options(self.named.get(schema["$ref"].split("/")[-1], {}), depth + 1)
        for word in ("oneOf", "anyOf"):
            if word in schema:
                return [found for part in schema[word] for found in self.options(part, depth + 1)]
        if "allOf" in schema:
            return self.merged([self.options(part, depth + 1) for part in schema["allOf"]])
        return [schema]

    def merged(self, parts):
        """Every choice of one alternative of each part, as one schema."""
        found = [{"type": "object", "properties": {}, "required": []}]
        for part in parts:
            found = [
                {
                    "type": "object",
                    "properties": {**a["properties"], **b.get("properties", {})},
                    "required": a["required"] + b.get("required", []),
                }
                for a in found
                for b in part or [{}]
            ]
        return found[:24]

    def child(self, schemas, key):
        """The schemas of what lies under a key, or in a list."""
        if isinstance(key, int):
            return [found for schema in schemas for found in self.options(schema.get("items"))]
        return [found for schema in schemas for found in self.options(schema.get("properties", {}).get(key))]

    def instance(self, schema, random, depth=0):
        """Something that a schema allows, mostly."""
        options = [option for option in self.options(schema) if option.get("type") != "null"]
        if not options or depth > 7:
            return None
        chosen = random.choice(options)
        if "enum" in chosen:
            return random.choice(chosen["enum"])
        kind = chosen.get("type")
        kind = next((k for k in kind if k != "null"), None) if isinstance(kind, list) else kind
        if kind == "object":
            wanted = set(chosen.get("required", []))
            return {
                key: self.instance(value, random, depth + 1)
                for key, value in chosen.get("properties", {}).items()
                if key in wanted or random.random() < 0.15
            }
        if kind == "array":
            return [self.instance(chosen.get("items", {}), random, depth + 1) for _ in range(random.randint(0, 3))]
        if kind == "integer":
            return random.choice(COUNTS[:9])
        if kind == "number":
            return random.choice([0.5, 1.0, 2.0, *NUMBERS])
        if kind == "boolean":
            return random.random() < 0.5
        return (
            random.choice(["a", "attacked", "curves", "label", "octahedron/2", "icosahedron"])
            if kind == "string"
            else {}
        )


def is_directive(value):
    """Whether a node stands for something large."""
    return isinstance(value, dict) and any(key.startswith("$") for key in value)


def nodes(body, schemas, found):
    """All nodes of a body with the schemas of their places."""

    def walk(parent, key, value, options):
        yield Node(parent, key, value, options)
        if is_directive(value):
            if "$repeat" in value:
                yield from walk(value, "$repeat", value["$repeat"], options)
            return
        pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for name, inner in list(pairs)[:40]:
            yield from walk(value, name, inner, schemas.child(options, name))

    holder = {"": body}
    return holder, list(walk(holder, "", body, found))


def estimate(node):
    """About how many bytes a recipe is."""
    if is_directive(node):
        if "$repeat" in node:
            return (1 + estimate(node["$repeat"])) * int(node["times"])
        if "$points" in node:
            return 24 * int(node["$points"].get("count", 8)) * int(node["$points"].get("dimension", 2))
        if "$string" in node:
            return len(node["$string"]) * int(node["times"])
        return 2 * int(node.get("$nest", 8))
    if isinstance(node, dict):
        return 2 + sum(4 + len(key) + estimate(value) for key, value in node.items())
    return 2 + sum(1 + estimate(item) for item in node) if isinstance(node, list) else len(str(node))


def toil(node, times=1):
    """Points that have to be made one by one: to send them must cost less than to answer them."""
    if is_directive(node):
        if "$repeat" in node:
            return toil(node["$repeat"], times * int(node["times"]) if node.get("vary") else times)
        return times * int(node["$points"].get("count", 8)) if "$points" in node else 0
    inner = node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()
    return sum(toil(value, times) for value in inner)


class Mutator:
    """Changes requests of one operation."""

    def __init__(self, schemas, operation, random):
        self.schemas, self.operation, self.random = schemas, operation, random
        self.body_options = schemas.options(operation.schema) if operation.schema else []

    def mutated(self, request):
        """A request one to three steps away."""
        request = copy.deepcopy(request)
        for _ in range(self.random.choice([1, 1, 2, 3])):
            self.step(request)
        return request

    def step(self, request):
        """One change, of a kind that fits."""
        if "body" not in request or self.random.random() < 0.1:
            return self.change_query(request)
        changes = [
            self.number,
            self.number,
            self.word,
            self.add,
            self.remove,
            self.renew,
            self.grow,
            self.grow,
            self.tiny,
            self.shape,
            self.shape,
            self.kit,
            self.kit,
            self.kit,
            self.many,
            self.many,
            self.large,
        ]
        if self.random.random() < 0.1:
            return self.wrap(request)
        change = self.random.choice(changes)
        holder, found = nodes(request["body"], self.schemas, self.body_options)
        change(found, request)
        request["body"] = holder[""]
        return None

    def pick(self, found, fits):
        """One of the nodes that fit."""
        fitting = [node for node in found if node.key != "" and fits(node)]
        return self.random.choice(fitting) if fitting else None

    def put(self, node, value):
        """Replaces a node."""
        if node is not None:
            node.parent[node.key] = value

    def number(self, found, _):
        """Another number."""
        node = self.pick(found, lambda n: isinstance(n.value, int | float) and not isinstance(n.value, bool))
        if node:
            value, integral = node.value, isinstance(node.value, int)
            other = self.random.choice([2 * value, 10 * value, value / 2, value + 1, *NUMBERS, *COUNTS])
            self.put(node, int(other) if integral and abs(other) < 1e18 and self.random.random() < 0.95 else other)

    def word(self, found, _):
        """Another of the words that are allowed here."""
        words = lambda node: [word for schema in node.schemas for word in schema.get("enum", [])]
        node = self.pick(found, words)
        self.put(node, self.random.choice(words(node)) if node else None)

    def add(self, found, _):
        """A field that may be here and is not."""

        def missing(node):
            if not isinstance(node.value, dict) or is_directive(node.value):
                return []
            return [
                (key, value)
                for schema in node.schemas
                for key, value in schema.get("properties", {}).items()
                if key not in node.value
            ]

        holders = [node for node in found if missing(node)]
        if holders:
            node = self.random.choice(holders)
            key, schema = self.random.choice(missing(node))
            node.value[key] = self.schemas.instance(schema, self.random)

    def remove(self, found, _):
        """A field less."""
        node = self.pick(found, lambda n: isinstance(n.parent, dict) and n.key != "$repeat")
        if node:
            node.parent.pop(node.key, None)

    def renew(self, found, _):
        """Something else that the schema allows here."""
        node = self.pick(found, lambda n: n.schemas and not is_directive(n.value))
        if node:
            self.put(node, self.schemas.instance(self.random.choice(node.schemas), self.random))

    def grow(self, found, _):
        """What is repeated more often, or an item of a list many times."""
        grows = lambda value: (
            "times" in value or "$points" in value if is_directive(value) else isinstance(value, list) and value
        )
        node = self.pick(found, lambda n: grows(n.value))
        if node is None:
            return
        if isinstance(node.value, list):
            item = self.random.choice(node.value)
            if not (is_directive(item) and "$repeat" in item):
                node.value.append(
                    {
                        "$repeat": copy.deepcopy(item),
                        "times": self.random.choice(COUNTS),
                        "vary": self.random.random() < 0.5,
                    }
                )
        elif "$points" in node.value:
            node.value["$points"]["count"] = self.random.choice(COUNTS)
        else:
            node.value["times"] = max(1, int(node.value["times"] * self.random.choice([0.5, 2, 4, 10])))

    def tiny(self, found, _):
        """A list of very many very small things."""
        may_be_list = lambda n: any(schema.get("type") in ("array", ["array", "null"]) for schema in n.schemas)
        node = self.pick(found, lambda n: isinstance(n.value, list) or may_be_list(n))
        self.put(node, [{"$repeat": self.random.choice(TINY), "times": self.random.choice(COUNTS[8:])}])

    def large(self, found, _):
        """A long string, or lists inside of each other."""
        node = self.pick(found, lambda n: True)
        text = {"$string": self.random.choice(TEXTS), "times": self.random.choice(COUNTS)}
        self.put(node, text if self.random.random() < 0.7 else {"$nest": self.random.choice(COUNTS[:14])})

    def points(self, count, dimension):
        """Points of any kind and place."""
        settings = {
            "kind": self.random.choice(KINDS),
            "count": count,
            "dimension": dimension,
            "seed": self.random.randrange(1000),
        }
        settings |= {"scale": self.random.choice(SCALES), "at": self.random.choice(PLACES)}
        if settings["kind"] == "spike":
            settings["by"] = self.random.choice([1, -1, 1000, -1000, 1e-9])
        return {"$points": settings}

    def shape(self, found, _):
        """One list of points becomes another one of its size."""
        is_list = lambda v: (
            isinstance(v, list) and v and isinstance(v[0], list) and v[0] and isinstance(v[0][0], int | float)
        )
        node = self.pick(found, lambda n: is_list(n.value) or is_directive(n.value) and "$points" in n.value)
        if node is None:
            return
        if is_list(node.value):
            self.put(node, self.points(len(node.value), len(node.value[0])))
        else:
            old = node.value["$points"]
            self.put(node, self.points(old.get("count", 8), old.get("dimension", 2)))

    def many(self, found, _):
        """The shapes of the request, many."""
        node = self.pick(found, lambda n: n.key == "shapes" and isinstance(n.value, list) and n.value)
        if node:
            item = (
                node.value[0]["$repeat"]
                if is_directive(node.value[0]) and "$repeat" in node.value[0]
                else node.value[0]
            )
            node.value[:] = [{"$repeat": item, "times": self.random.choice(COUNTS[:13]), "vary": True}]

    def kit(self, found, request):
        """A representation and shapes that fit it."""
        body = request["body"]
        if not isinstance(body, dict):
            return
        known = self.operation.stored(request)
        representation, shape = kit(self, known)
        if known is None and ("representation" in body or self.random.random() < 0.2):
            body["representation"] = representation
        for key in ("reference", "shape", "from", "to", "start"):
            if isinstance(body.get(key), dict):
                body[key] = shape()
        if "shapes" in body or known:
            body["shapes"] = [{"$repeat": shape(), "times": self.random.choice([1, 2, 3, 9, 33, 129]), "vary": True}]

    def wrap(self, request):
        """The same body otherwise packed."""
        if self.random.random() < 0.5:
            request["gzip"] = not request.get("gzip", False)
        else:
            request["pad"] = self.random.choice([0, 1024, 20000, 600000])

    def change_query(self, request):
        """Other parameters of the address."""
        query = request.setdefault("query", {})
        if not self.operation.query:
            return
        name, schema = self.random.choice(self.operation.query)
        if name in query and self.random.random() < 0.3:
            del query[name]
            return
        known = name in WORDS and self.random.random() < 0.8
        value = self.random.choice(WORDS[name]) if known else self.schemas.instance(schema, self.random)
        query[name] = str(value)[:2000]


GENERATORS = [
    {"name": "cubic"},
    {"name": "trigonometric"},
    *({"name": "bspline", "degree": k} for k in range(1, 6)),
    {"name": "exponential", "domain_poles": [[0, 0], [0, 6.283185307179586], [0, -6.283185307179586]]},
    {
        "name": "interpolator",
        "family": "integer_shifts",
        "domain_poles": [[0, 0], [0, 6.283185307179586], [0, -6.283185307179586]],
    },
    {"name": "interpolator", "family": "half_integer_shifts", "poles": [[0, 0], [0, 0], [0, 0], [0, 0]]},
]


def kit(mutator, known=None):
    """A representation, and a function that makes shapes of it."""
    random = mutator.random
    if known:
        return known, lambda: {
            "points": mutator.points(known.get("control_points") or known.get("points"), known["dimension"])
        }
    choice, dimension, count = random.randrange(8), random.choice([2, 2, 3]), random.choice(COUNTS[2:13])
    if choice < 3:
        made = {
            "kind": "closed_curve",
            "dimension": dimension,
            "control_points": count,
            "generator": random.choice(GENERATORS),
        }
        return made, lambda: {"points": mutator.points(count, dimension)}
    if choice == 3:
        made = {
            "kind": "open_curve",
            "dimension": dimension,
            "intervals": count,
            "generator": random.choice(GENERATORS),
        }
        return made, lambda: {"points": mutator.points(count + 1, dimension)}
    if choice == 4:
        return {"kind": "landmarks", "dimension": dimension, "points": count}, lambda: {
            "points": mutator.points(count, dimension)
        }
    if choice < 7:
        u, v = random.choice([4, 8, 16, 32, 45]), random.choice([4, 8, 16, 32, 45])
        topology = random.choice(["torus", "sphere"])
        rows = u * v if topology == "torus" else u * (v - 1) + 6
        return {"kind": "surface", "topology": topology, "control_points": [u, v]}, lambda: {
            "control_points": mutator.points(rows, 3)
        }
    splits = random.choice([0, 1, 2, 3, 4])
    scheme = {"scheme": random.choice(["loop", "blob", "butterfly", "normal_based"]), "lambda": 1.5}
    if scheme["scheme"] != "blob":
        del scheme["lambda"]
    made = {
        "kind": "subdivision",
        **scheme,
        "level": random.choice([0, 1, 2, 3, 5, 8]),
        "connectivity": f"octahedron/{splits}",
    }
    return made, lambda: {"control_points": mutator.points(4 ** (splits + 1) + 2, 3)}
