"""The operations of the interface document, what they are asked about, and requests to begin with."""

import json
import re
import urllib.parse
from math import cos, pi, sin
from pathlib import Path

SEEDS = Path(__file__).resolve().parent / "seeds.json"
LANDMARKS = {"kind": "landmarks", "dimension": 2, "points": 3}
CURVES = {"kind": "closed_curve", "dimension": 2, "control_points": 16, "generator": {"name": "cubic"}}
COHORTS = {"attacked": LANDMARKS, "curves": CURVES}
DICTIONARIES = {"modes": "attacked", "curve-modes": "curves", "atoms": "curves"}
WAIT = {"prefer": "wait=50"}


class Operation:
    """One method of one path."""

    def __init__(self, method, template, node):
        self.method, self.template, self.name = method.upper(), template, node["operationId"]
        parameters = node.get("parameters", [])
        self.query = [(p["name"], p.get("schema", {})) for p in parameters if p["in"] == "query"]
        content = node.get("requestBody", {}).get("content", {})
        self.schema = content.get("application/json", {}).get("schema")
        self.lines = "application/x-ndjson" in content
        self.example = content.get("application/json", {}).get("example")
        self.names = re.findall(r"{(\w+)}", template)

    def stored(self, request):
        """The representation of the cohort that a request is about, when it is about one."""
        about = request.get("about", {})
        cohort = DICTIONARIES.get(about.get("dictionary"), about.get("cohort"))
        return COHORTS.get(cohort) if self.template.count("{") and "/v1/generators" not in self.template else None

    def path(self, request, made):
        """The address of a request; `made` are things that were made for it."""
        path = self.template
        for name in self.names:
            value = made.get(name) or request.get("about", {}).get(name, "none")
            path = path.replace("{" + name + "}", urllib.parse.quote(str(value), safe="@"))
        query = urllib.parse.urlencode(request.get("query", {}))
        return path + ("?" + query if query else "")


def operations(document):
    """All of a document."""
    return [Operation(method, path, node) for path, item in document["paths"].items() for method, node in item.items()]


def outline(count, k):
    """A contour with bumps of its own."""
    turn = [2 * pi * j / count for j in range(count)]
    radius = [2 + 0.3 * cos(3 * t + k) + 0.1 * sin(5 * t + 2 * k) for t in turn]
    return [[round(1.4 * r * cos(t), 5), round(r * sin(t), 5)] for r, t in zip(radius, turn)]


def furnish(service, key):
    """Cohorts and dictionaries that requests are about; a job that has ended."""
    for name, representation in COHORTS.items():
        service.post("/v1/cohorts", {"name": name, "representation": representation}, key)
        count = representation.get("control_points") or representation["points"]
        shapes = [
            {
                "external_id": f"s{k}",
                "label": "ab"[k % 2],
                "subject": f"p{k // 2}",
                "labels": {"age": k},
                "points": outline(count, k),
            }
            for k in range(60)
        ]
        service.post(f"/v1/cohorts/{name}/shapes", {"shapes": shapes}, key)
    classifier = {"kind": "discriminant", "attribute": "label", "repeats": 1}
    pca = {"kind": "functional_pca", "components": 3, "centre": True}
    sparse = {"kind": "sparse", "atoms": 6, "lambda": 0.05, "max_epochs": 20}
    for name, cohort in DICTIONARIES.items():
        body = {
            "name": name,
            "cohort": cohort,
            "transformation": "similarity",
            "method": sparse if name == "atoms" else pca,
        }
        service.post(
            "/v1/dictionaries",
            body if name == "atoms" else {**body, "classifier": classifier},
            {**key, **WAIT},
            timeout=90,
        )


def warm(service, key):
    """Computes once in every way: stacks and arenas of threads are no part of what the first request takes."""
    for name, cohort in DICTIONARIES.items():
        count = COHORTS[cohort].get("control_points") or COHORTS[cohort]["points"]
        shapes = {"shapes": [{"points": outline(count, k)} for k in range(400)]}
        service.post(f"/v1/dictionaries/{name}/encode", shapes, key)
        service.post("/v1/mean", {**shapes, "representation": COHORTS[cohort], "transformation": "similarity"}, key)


class Things:
    """What exists, and what is made to be deleted, restored or cancelled."""

    def __init__(self, service, key):
        self.service, self.key, self.count = service, key, 0
        self.exported = service.send("GET", "/v1/dictionaries/modes/export", headers=key, timeout=30).body
        jobs = service.send("GET", "/v1/jobs?limit=1", headers=key).json()["items"]
        self.job = jobs[0]["id"] if jobs else "none"

    def made_for(self, name):
        """What an operation needs that it uses up."""
        makers = {
            "delete_cohort": self.cohort,
            "update_cohort": self.cohort,
            "delete_shape": self.shape,
            "delete_dictionary": self.dictionary,
            "revoke_key": self.a_key,
            "find_key": self.a_key,
            "remove_trashed": self.trashed,
            "restore_trashed": self.trashed,
            "cancel_job": self.running,
        }
        self.count += 1
        try:
            return makers[name]() if name in makers else {"job": self.job} if "job" in name else {}
        except (RuntimeError, KeyError, TypeError):
            # Never what other requests are about.
            return dict.fromkeys(("cohort", "shape", "dictionary", "key", "id", "job"), "none")

    def cohort(self):
        name = f"doomed-{self.count}"
        return {"cohort": self.service.post("/v1/cohorts", {"name": name, "representation": LANDMARKS}, self.key)["id"]}

    def shape(self):
        added = self.service.post(
            "/v1/cohorts/attacked/shapes", {"shapes": [{"points": outline(3, self.count)}]}, self.key
        )
        return {"cohort": "attacked", "shape": added["results"][0]["id"]}

    def dictionary(self):
        headers = {"content-type": "application/json", **self.key}
        found = self.service.send(
            "POST", f"/v1/dictionaries/import?name=doomed-{self.count}", self.exported, headers
        ).json()
        return {"dictionary": found["id"]}

    def a_key(self):
        return {"key": self.service.post("/v1/keys", {"name": f"k{self.count}", "role": "reader"}, self.key)["id"]}

    def trashed(self):
        cohort = self.cohort()["cohort"]
        self.service.send("DELETE", f"/v1/cohorts/{cohort}", headers=self.key)
        return {"id": cohort}

    def running(self):
        body = {
            "name": "long",
            "cohort": "curves",
            "transformation": "similarity",
            "method": {
                "kind": "sparse",
                "atoms": 16,
                "lambda": 0.001,
                "max_epochs": 10000,
                "tolerance": 0,
                "seed": self.count,
            },
        }
        return {"job": self.service.post("/v1/dictionaries", body, self.key)["id"]}


def beginnings(operation, document):
    """Requests to begin with: those of the document, and those of seeds.json."""
    about = {"cohort": "attacked", "shape": "s1", "dictionary": "modes", "name": "cubic"}
    base = {"method": operation.method, "about": about}
    found = []
    if operation.schema:
        example = operation.example or resolved(document, operation.schema).get("example") or {}
        found.append({**base, "body": example})
    else:
        found.append(base)
    for other in ({"dictionary": "curve-modes", "cohort": "curves"}, {"dictionary": "atoms", "cohort": "curves"}):
        if set(other) & set(operation.names):
            found += [{**copy, "about": {**about, **other}} for copy in found[:1]]
    seeds = json.loads(SEEDS.read_text()).get(operation.name, [])
    return found + [{**base, **seed} for seed in seeds]


def resolved(document, schema):
    """What a reference leads to."""
    return document["components"]["schemas"].get(schema["$ref"].split("/")[-1], {}) if "$ref" in schema else schema
