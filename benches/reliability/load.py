"""Clients that write, and remember what was acknowledged to them.

A client owns its cohorts: nobody else changes them, so it knows exactly what must be stored. What got no answer is sent
again with the same `Idempotency-Key`, to any replica, until there is one; in the end nothing is uncertain.
"""

import http.client
import json
import threading
import time
import uuid
from collections import Counter
from random import Random

POINTS = 6
PATIENCE = 900
# Answers that say: not now.
LATER = {408, 425, 429, 503}
LOST, REFUSED = "lost", "refused"
JSON = "application/json"
NDJSON = "application/x-ndjson"


class Unexpected(Exception):
    """An answer that must not be."""


class Wire:
    """Connections to all replicas; every request may go to any of them."""

    def __init__(self, ports, random):
        self.ports, self.random = ports, random
        self.open = {}
        self.counts = Counter()

    def once(self, method, path, body=None, headers=None):
        """One try: status and content; `LOST` when no whole answer came, `REFUSED` when nobody was there to read it."""
        port = self.random.choice(self.ports)
        connection = self.open.setdefault(port, http.client.HTTPConnection("127.0.0.1", port, timeout=20))
        self.counts["requests"] += 1
        try:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            text = answer.read()
        except ConnectionRefusedError:
            connection.close()
            return REFUSED
        except (OSError, http.client.HTTPException):
            connection.close()
            self.counts["answers lost"] += 1
            return LOST
        return answer.status, json.loads(text) if text else None

    def insist(self, method, path, body=None, headers=None, good=(200,), good_again=()):
        """Tries until the answer is final: status and content. `good_again` is good only after a try of unknown
        outcome."""
        end, uncertain = time.monotonic() + PATIENCE, False
        while time.monotonic() < end:
            answer = self.once(method, path, body, headers)
            if answer not in (LOST, REFUSED):
                status, content = answer
                if status in good or (uncertain and status in good_again):
                    return answer
                if status not in LATER:
                    raise Unexpected(f"{method} {path}: {status} {json.dumps(content)[:300]}")
            uncertain |= answer != REFUSED
            self.counts["retries"] += 1
            time.sleep(self.random.uniform(0.02, 0.3))
        raise Unexpected(f"{method} {path}: no answer in {PATIENCE} s")

    def get(self, path):
        return self.insist("GET", path)[1]

    def post(self, path, body, good, media_type=JSON):
        """A write that is done once, however often it is sent."""
        headers = {"content-type": media_type, "idempotency-key": str(uuid.UUID(int=self.random.getrandbits(128)))}
        return self.insist("POST", path, body, headers, good)

    def items(self, path):
        """All entries of a list, page by page."""
        mark, found = "&" if "?" in path else "?", []
        cursor = ""
        while cursor is not None:
            page = self.get(f"{path}{mark}limit=1000{cursor and f'&cursor={cursor}'}")
            found += page["items"]
            cursor = page["next"]
        return found


class Cohort:
    """What is known to be stored under a name."""

    def __init__(self, name):
        self.name = name
        self.changes = 0
        # external id, or the subject of a shape without one: its points
        self.named, self.anonymous = {}, {}


class Client(threading.Thread):
    """Writes without a pause until it is told to stop."""

    def __init__(self, number, ports, seed, lessons):
        super().__init__(daemon=True)
        self.random = Random(f"{seed}-{number}")
        self.wire = Wire(ports, self.random)
        self.number, self.lessons = number, lessons
        self.cohorts, self.deleted, self.jobs = [], [], {}
        self.counts, self.violations = Counter(), []
        self.stopped = threading.Event()

    def run(self):
        actions = {
            self.create: 4,
            self.add_named: 40,
            self.add_anonymous: 15,
            self.add_json: 15,
            self.delete_shape: 12,
            self.delete_cohort: 2,
            self.learn: 3,
            self.read_back: 25,
        }
        while not self.stopped.is_set():
            action = self.random.choices(list(actions), list(actions.values()))[0]
            try:
                action()
            except Unexpected as found:
                self.violations.append(str(found))
            time.sleep(self.random.uniform(0, 0.05))

    def points(self):
        return [[self.random.gauss(0, 10), self.random.gauss(0, 10)] for _ in range(POINTS)]

    def any_cohort(self):
        if not self.cohorts:
            self.create()
        return self.random.choice(self.cohorts)

    def create(self):
        name = f"load-{self.number}-{len(self.cohorts) + len(self.deleted)}"
        representation = {"kind": "landmarks", "dimension": 2, "points": POINTS}
        body = {"name": name, "correspondence": "landmarks", "representation": representation}
        self.wire.post("/v1/cohorts", json.dumps(body), (201,))
        self.cohorts.append(Cohort(name))
        self.counts["cohorts created"] += 1

    def batch(self, cohort, field):
        """New shapes; what they are called in `field` begins with the number of changes, so that it is new."""
        size = self.random.choices([1, 3, 20, 60, 3000], [10, 10, 10, 10, 1])[0]
        return {f"{cohort.changes}-{k}-{field}": self.points() for k in range(size)}

    def add(self, cohort, batch, field, media_type):
        shapes = [{field: name, "points": points} for name, points in batch.items()]
        body = "\n".join(map(json.dumps, shapes)) if media_type == NDJSON else json.dumps({"shapes": shapes})
        _, answer = self.wire.post(f"/v1/cohorts/{cohort.name}/shapes", body, (201,), media_type)
        cohort.changes += 1
        (cohort.named if field == "external_id" else cohort.anonymous).update(batch)
        self.counts["uploads"] += 1
        self.counts["shapes"] += len(batch)
        if answer["added"] != len(batch) or answer["revision"] != cohort.changes:
            told = {key: answer[key] for key in ("added", "revision")}
            self.violations.append(f"{cohort.name}: {told} after change {cohort.changes} with {len(batch)} shapes")
            # told once, not with every change to come
            cohort.changes = answer["revision"]

    def add_named(self):
        cohort = self.any_cohort()
        self.add(cohort, self.batch(cohort, "external_id"), "external_id", NDJSON)

    def add_anonymous(self):
        """Nothing but the idempotency key keeps these from being stored twice."""
        cohort = self.any_cohort()
        self.add(cohort, self.batch(cohort, "subject"), "subject", NDJSON)

    def add_json(self):
        cohort = self.any_cohort()
        self.add(cohort, self.batch(cohort, "external_id"), "external_id", JSON)

    def delete_shape(self):
        cohort = self.any_cohort()
        if cohort.named:
            name = self.random.choice(list(cohort.named))
            self.wire.insist("DELETE", f"/v1/cohorts/{cohort.name}/shapes/{name}", good=(204,), good_again=(404,))
            del cohort.named[name]
            cohort.changes += 1
            self.counts["shapes deleted"] += 1

    def delete_cohort(self):
        cohort = self.any_cohort()
        self.wire.insist("DELETE", f"/v1/cohorts/{cohort.name}", good=(204,), good_again=(404,))
        self.cohorts.remove(cohort)
        self.deleted.append(cohort.name)
        self.counts["cohorts deleted"] += 1

    def learn(self):
        lesson = self.random.choice(list(self.lessons))
        name = f"learnt-{self.number}-{len(self.jobs)}"
        _, job = self.wire.post("/v1/dictionaries", json.dumps({"name": name, **lesson_body(lesson)}), (202,))
        self.jobs[name] = (lesson, job["id"])
        self.counts["jobs"] += 1

    def read_back(self):
        """What was acknowledged is there at once, whichever replica is asked."""
        cohort = self.any_cohort()
        if cohort.named:
            name = self.random.choice(list(cohort.named))
            found = self.wire.get(f"/v1/cohorts/{cohort.name}/shapes/{name}")
            if found["control_points"] != cohort.named[name]:
                self.violations.append(f"{cohort.name}: {name} was stored with other points")
            self.counts["reads"] += 1


METHODS = {
    "components": {"kind": "functional_pca", "components": 5, "centre": True},
    "atoms": {"kind": "sparse", "atoms": 8, "lambda": 0.05, "seed": 5, "max_epochs": 60, "tolerance": 0.0},
}
LESSON_SHAPES = 80


def lessons():
    """What is learnt: by each method, from each of two cohorts that nobody changes."""
    return [(cohort, method) for cohort in ("lesson-0", "lesson-1") for method in METHODS]


def lesson_body(lesson):
    cohort, method = lesson
    return {"cohort": cohort, "transformation": "similarity", "method": METHODS[method]}


def prepare(wire):
    """The cohorts that are learnt from, and the digest that each lesson has when nobody disturbs it."""
    for cohort in sorted({cohort for cohort, _ in lessons()}):
        random = Random(cohort)
        shapes = [
            {"external_id": str(k), "points": [[random.gauss(3 * i, 1), random.gauss(i * i, 1)] for i in range(POINTS)]}
            for k in range(LESSON_SHAPES)
        ]
        representation = {"kind": "landmarks", "dimension": 2, "points": POINTS}
        wire.post("/v1/cohorts", json.dumps({"name": cohort, "representation": representation}), (201,))
        wire.post(f"/v1/cohorts/{cohort}/shapes", json.dumps({"shapes": shapes}), (201,))
    digests = {}
    for lesson in lessons():
        _, job = wire.post("/v1/dictionaries", json.dumps({"name": "undisturbed", **lesson_body(lesson)}), (202,))
        digests[lesson] = finished(wire, job["id"])["result"]["digest"]
    return digests


def finished(wire, job):
    """A job when it has come to its end."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = wire.get(f"/v1/jobs/{job}")
        if found["status"] not in ("queued", "running"):
            return found
        time.sleep(0.1)
    raise Unexpected(f"job {job} is still {found['status']} after {PATIENCE} s")
