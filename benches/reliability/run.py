"""Kills the service again and again while clients write, and looks for what was lost or doubled.

    python benches/reliability/run.py --binary target/release/shapelex --engine sqlite --report sqlite.json
    python benches/reliability/run.py --binary target/release/shapelex --engine postgres --report postgres.json
    python benches/reliability/run.py --table sqlite.json postgres.json

One replica on SQLite, or two on a PostgreSQL of their own, which is itself crashed now and then. At random moments,
also while it starts, a replica gets SIGKILL and is started again. The load: cohorts created and deleted, shapes
uploaded (as JSON and as NDJSON, with external ids and without) and deleted, dictionaries learnt. What got no answer is
sent again with the same `Idempotency-Key`. In the end everything that was acknowledged must be there once, with the
points that were sent; nothing else must be there; every job must have succeeded with the digest of the undisturbed run;
`shapelex check` must be content. The last of these commands writes the table of docs/reliability.md. `--sabotage`
changes the store behind the back of the last check: such a run must fail. Needs Python 3.11 and nothing beyond its
library; the seed fixes the requests and the kills, not their interleaving.
"""

import argparse
import json
import os
import platform
import sqlite3
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path
from random import Random

from load import Client, Unexpected, Wire, finished, lessons, prepare
from machines import Postgres, Replica

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "reliability.md"
CLIENTS = 4


class Chaos:
    """Kills, at moments and of victims that the seed chooses."""

    def __init__(self, replicas, database, random):
        self.replicas, self.database, self.random = replicas, database, random
        self.counts = Counter()

    def run(self, kills):
        while self.counts["kills"] < kills:
            time.sleep(self.random.uniform(0.05, 3.0))
            if self.database and self.random.random() < 0.1:
                self.database.crash()
                self.counts["database crashes"] += 1
            both = len(self.replicas) > 1 and self.random.random() < 0.2
            victims = list(self.replicas) if both else [self.random.choice(self.replicas)]
            self.counts["kills of all replicas at once"] += both
            for victim in victims:
                self.kill(victim)
            time.sleep(self.random.uniform(0, 0.3))
            for victim in victims:
                victim.start()
            self.interrupt_start(victims[0])
            for victim in victims:
                victim.wait()

    def kill(self, victim):
        victim.kill()
        self.counts["kills"] += 1

    def interrupt_start(self, victim):
        """Now and then the next kill comes before the replica is ready."""
        if self.random.random() < 0.15:
            time.sleep(self.random.uniform(0, 0.15))
            self.kill(victim)
            self.counts["kills while starting"] += 1
            victim.start()


def compare(wire, clients, digests):
    """What is wrong with what is stored, and counts of what was looked at."""
    found, counts = [], Counter()
    kept = {cohort.name: cohort for client in clients for cohort in client.cohorts}
    listed = Counter(cohort["name"] for cohort in wire.items("/v1/cohorts"))
    wanted = Counter([*kept, *{cohort for cohort, _ in lessons()}])
    found += [f"cohort {name}: {listed[name]} of them" for name in (listed | wanted) if listed[name] != wanted[name]]
    for name in kept.keys() & listed.keys():
        found += compare_cohort(wire, kept[name], counts)
    for client in clients:
        for name, (lesson, job) in client.jobs.items():
            found += compare_job(wire, name, job, digests[lesson], counts)
    return found, counts


def compare_cohort(wire, cohort, counts):
    """A cohort as it was acknowledged, as it says, and as it is."""
    head = wire.get(f"/v1/cohorts/{cohort.name}")
    shapes = wire.items(f"/v1/cohorts/{cohort.name}/shapes")
    stored = Counter((shape["external_id"] or shape["subject"]) for shape in shapes)
    points = {(shape["external_id"] or shape["subject"]): shape["control_points"] for shape in shapes}
    wanted = cohort.named | cohort.anonymous
    lost, doubled, foreign = (
        wanted.keys() - stored,
        [name for name, n in stored.items() if n > 1],
        stored.keys() - wanted.keys(),
    )
    other = [name for name in wanted.keys() & stored.keys() if points[name] != wanted[name]]
    parts = {"lost": lost, "doubled": doubled, "never acknowledged": foreign, "with other points": other}
    found = [
        f"{cohort.name}: {len(names)} shapes {what}, such as {min(names)}" for what, names in parts.items() if names
    ]
    if (head["shape_count"], head["revision"]) != (len(wanted), cohort.changes):
        found.append(
            f"{cohort.name}: says {head['shape_count']} shapes, {head['revision']} changes; {len(wanted)}, "
            f"{cohort.changes}"
        )
    counts["shapes compared"] += len(wanted)
    return found


def compare_job(wire, name, job, digest, counts):
    """A job that has succeeded once, with the result of the undisturbed run."""
    done = finished(wire, job)
    versions = wire.items(f"/v1/dictionaries?name={name}")
    counts["jobs compared"] += 1
    counts["jobs begun more than once"] += done["attempt"] > 1
    if done["status"] != "succeeded":
        return [f"job {name}: {done['status']} at attempt {done['attempt']}: {json.dumps(done['problem'])[:300]}"]
    found = [] if done["result"]["digest"] == digest else [f"job {name}: another digest"]
    return found if len(versions) == 1 else [*found, f"job {name}: {len(versions)} dictionaries"]


def sabotage(wire, client):
    """One acknowledged shape vanishes, another one is there twice."""
    cohort = next(cohort for cohort in client.cohorts if len(cohort.named) > 1)
    gone, twice = list(cohort.named)[:2]
    wire.insist("DELETE", f"/v1/cohorts/{cohort.name}/shapes/{gone}", good=(204,))
    shape = {"subject": twice, "points": cohort.named[twice]}
    wire.post(f"/v1/cohorts/{cohort.name}/shapes", json.dumps({"shapes": [shape]}), (201,))


def check_store(binary, replica, data):
    """What the program itself says of its store, and SQLite of its file."""
    done = subprocess.run([binary, "check"], env=replica.environment, capture_output=True, text=True)
    found = (
        [] if done.returncode == 0 else [f"check ended with {done.returncode}: {(done.stdout + done.stderr)[-1000:]}"]
    )
    for file in sorted(data.glob("*.db")):
        with sqlite3.connect(file) as database:
            said = [row[0] for row in database.execute("PRAGMA integrity_check")]
            broken = database.execute("PRAGMA foreign_key_check").fetchall()
        if said != ["ok"] or broken:
            found.append(f"{file.name}: {said[:3]} {broken[:3]}")
    return found, (done.stdout + done.stderr).strip()[-400:]


def attack(arguments, folder):
    """The whole run; its report."""
    binary, random = str(Path(arguments.binary).resolve()), Random(arguments.seed)
    database = Postgres(folder) if arguments.engine == "postgres" else None
    settings = {"DATABASE_URL": database.url} if database else {}
    replicas = [Replica(binary, folder, number, settings) for number in range(2 if database else 1)]
    for replica in replicas:
        replica.start()
    for replica in replicas:
        replica.wait()
    ports = [replica.port for replica in replicas]
    wire = Wire(ports, Random(arguments.seed))
    digests = prepare(wire)
    clients = [Client(number, ports, arguments.seed, digests) for number in range(CLIENTS)]
    begin = time.monotonic()
    for client in clients:
        client.start()
    chaos = Chaos(replicas, database, random)
    chaos.run(arguments.kills)
    for client in clients:
        client.stopped.set()
    for client in clients:
        client.join()
    seconds = time.monotonic() - begin
    if arguments.sabotage:
        sabotage(wire, clients[0])
    violations = [violation for client in clients for violation in client.violations]
    try:
        found, compared = compare(wire, clients, digests)
    except Unexpected as unexpected:
        found, compared = [str(unexpected)], Counter()
    violations += found
    violations += [f"replica {number} did not stop in order" for number, r in enumerate(replicas) if not r.stop()]
    found, said = check_store(binary, replicas[0], Path(folder) / "data")
    violations += found
    for replica in replicas:
        violations += [line[:300] for line in replica.log.read_text().splitlines() if "panicked" in line]
    if database:
        database.stop()
    counts = sum((client.counts + client.wire.counts for client in clients), Counter())
    version = subprocess.run([binary, "--version"], capture_output=True, text=True).stdout.strip()
    return {
        "program": version,
        "engine": arguments.engine,
        "replicas": len(replicas),
        "seed": arguments.seed,
        "machine": f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}",
        "seconds": round(seconds),
        "chaos": chaos.counts,
        "load": counts,
        "compared": compared,
        "check": said,
        "digests": {" of ".join(reversed(lesson)): digest for lesson, digest in digests.items()},
        "violations": violations,
    }


COLUMNS = {
    "store": lambda r: f"{r['engine']}, {r['replicas']} replica{'s' * (r['replicas'] > 1)}",
    "`kill -9`": lambda r: r["chaos"]["kills"],
    "while starting": lambda r: r["chaos"].get("kills while starting", 0),
    "database crashes": lambda r: r["chaos"].get("database crashes", 0),
    "minutes": lambda r: f"{r['seconds'] / 60:.0f}",
    "acknowledged writes": lambda r: sum(r["load"].get(key, 0) for key in WRITES),
    "answers lost": lambda r: r["load"].get("answers lost", 0),
    "shapes compared": lambda r: r["compared"].get("shapes compared", 0),
    "jobs (begun more than once)": lambda r: (
        f"{r['compared'].get('jobs compared', 0)} ({r['compared'].get('jobs begun more than once', 0)})"
    ),
    "seed": lambda r: r["seed"],
    "violations": lambda r: len(r["violations"]),
}
WRITES = ("cohorts created", "cohorts deleted", "uploads", "shapes deleted", "jobs")


def table(reports):
    """Writes the runs into the document."""
    rows = [" | ".join(COLUMNS), " | ".join("---" for _ in COLUMNS)]
    rows += [" | ".join(str(cell(report)) for cell in COLUMNS.values()) for report in reports]
    lines = "\n".join(f"| {row} |" for row in rows)
    before, rest = DOCUMENT.read_text().split("<!-- runs -->\n", 1)
    after = rest.split("<!-- end of runs -->", 1)[1]
    DOCUMENT.write_text(f"{before}<!-- runs -->\n{lines}\n<!-- end of runs -->{after}")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--binary", default=ROOT / "target" / "release" / "shapelex")
    parser.add_argument("--engine", choices=["sqlite", "postgres"], default="sqlite")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--report", type=Path)
    parser.add_argument("--sabotage", action="store_true")
    parser.add_argument("--table", nargs="+", type=Path, metavar="REPORT")
    arguments = parser.parse_args()
    if arguments.table:
        return table([json.loads(path.read_text()) for path in arguments.table])
    with tempfile.TemporaryDirectory(prefix="shapelex-reliability-") as folder:
        os.chmod(folder, 0o755)
        report = attack(arguments, folder)
    text = json.dumps(report, indent=1)
    if arguments.report:
        arguments.report.write_text(text + "\n")
    print(text)
    raise SystemExit(1 if report["violations"] else 0)


if __name__ == "__main__":
    main()
