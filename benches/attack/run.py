#!/usr/bin/env python3
"""Looks for requests that cost the service most time or memory for their bytes, and ends with a failure when one breaks
a promise.

    benches/attack/run.py --binary target/release/shapelex --minutes 60 --report attack.json
    benches/attack/run.py --binary … --minutes 5 --operations 'measure|evaluate' --seed 2 --keep-going
    benches/attack/run.py --table attack.json …
    tests/attack/run.py replay attack.json --binary …

For each operation of the interface document a search by mutation: it begins with the examples of the document and with
seeds.json, changes one of the worst requests so far (sizes, numbers at the edge, shapes that are collapsed, tiny or far
off, lists of tiny things, nesting, compression, fields that the schema allows), and keeps what costs more. Costs are
seconds of processor time, seconds of wall time, bytes of memory, and the first and the last of these by the bytes on
the wire: ten of each are kept. Between the rounds many clients of one tenant send the worst of all operations at once;
a process of its own asks for little as another tenant every 50 ms.

The run fails when a request is not answered within --compute-seconds and one second, the log has a panic, an answer is
a 5xx other than 503 (and 507, a full disk), memory passes the quota, /readyz fails, or work goes on after its answer.
With --keep-going that is noted and a new process started. The seed fixes what is tried as far as costs decide alike;
what was found is in the report, and can be sent again. Loopback only, memory and sizes bounded. Needs Python 3.11 and
nothing beyond its library.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "attack"))
sys.dont_write_bytecode = True

from mutate import Mutator, Schemas, estimate, toil  # noqa: E402
from operations import Things, beginnings, furnish, operations, warm  # noqa: E402
from recipe import Recipe  # noqa: E402

from service import Service, percentile  # noqa: E402

COSTS = ["cpu", "seconds", "mb", "cpu per kB", "mb per kB"]
KEPT = 10
# Share of the time for operations without a body.
LEAN = 0.2
# Of these the next request is made: the worst few, so that one lucky figure does not take all.
PARENTS = 4
# Bytes that every request costs on the wire beside its body.
HEAD_BYTES = 300
# Requests of a flood are at most so long: many of them are held at once, here too.
FLOOD_BYTES = 1_000_000
FLOOD_CLIENTS = 16
# A service that keeps so much is started again, so that memory of one request is not hidden by that of another.
AT_REST = 32 << 20
# Points of a request that Python makes one by one: some tenth of a second.
MOST_TOIL = 60_000
# What one request may take by the promise; a quota is for all of them together.
PROMISED_MB = 512
PROMISED_SECONDS = 10
# Half seconds in which work must end after its answer.
SETTLE = 6
# A body that is refused takes at most so many times its decompressed size, and what a busy process takes besides.
PROMISED_TIMES = 12
SLACK_MB = 40
# Smaller bodies can ask for work before they are refused, which is bounded by the promise for one request.
LARGE_BODY = 1_000_000


class Broken(Exception):
    """A promise that does not hold, with the request that shows it."""


class Target:
    """The service under attack, on a furnished store, with a key of the attacker and one of somebody else."""

    def __init__(self, arguments):
        self.arguments = arguments
        self.template = Path(tempfile.mkdtemp(prefix="shapelex-attack-"))
        seconds, quota = arguments.compute_seconds, int(arguments.quota_mb * 1e6)
        self.flags = [
            "--no-example",
            f"--compute-seconds={seconds}",
            f"--light-seconds={seconds}",
            f"--max-memory={quota}",
        ]
        service = Service(arguments.binary, self.flags, folder=self.template)
        self.key, self.other = service.key("attacker", "admin", "a"), service.key("other", "writer", "b")
        service.start()
        furnish(service, self.key)
        self.document = service.send("GET", "/openapi.json").json()
        service.stop()
        self.service = self.things = None

    def fresh(self):
        """A new process on a copy of the store."""
        self.drop()
        self.service = Service(self.arguments.binary, self.flags)
        shutil.copytree(self.template / "data", self.service.folder / "data")
        self.service.start()
        self.things = Things(self.service, self.key)
        warm(self.service, self.key)
        self.service.idle = self.service.resident()

    def rested(self):
        """One that holds nothing of the request before."""
        if self.service is None or self.service.ended() or self.service.resident() > self.service.idle + AT_REST:
            self.fresh()
        return self.service

    def drop(self):
        if self.service:
            self.service.remove()
            self.service = None

    def remove(self):
        self.drop()
        shutil.rmtree(self.template, ignore_errors=True)


class Search:
    """The worst requests of one operation."""

    def __init__(self, operation, target, seed):
        self.operation, self.target = operation, target
        self.random = Random(f"{seed}:{operation.name}")
        self.mutator = Mutator(Schemas(target.document), operation, self.random)
        self.waiting = beginnings(operation, target.document)
        self.worst = {cost: [] for cost in COSTS}
        self.statuses, self.evaluated = Counter(), 0

    def next(self):
        """A request to try: the beginnings first, then what grows out of the worst."""
        if self.waiting:
            return self.waiting.pop(0)
        kept = self.worst[self.random.choice(COSTS)][:PARENTS]
        return (
            self.mutator.mutated(self.random.choice(kept)["request"])
            if kept
            else self.mutator.mutated(beginnings(self.operation, self.target.document)[0])
        )

    def note(self, request, figures):
        """Keeps a request where it is among the worst."""
        self.evaluated += 1
        self.statuses[str(figures["status"])] += 1
        text = json.dumps(request, sort_keys=True)
        for cost in COSTS:
            kept = self.worst[cost]
            if all(entry["text"] != text for entry in kept):
                kept.append({"request": request, "text": text, **figures})
                kept.sort(key=lambda entry: -entry[cost])
                del kept[KEPT:]

    def requests(self):
        """All that are kept, each once."""
        return {entry["text"]: entry for kept in self.worst.values() for entry in kept}.values()


def wired(request, operation, target, made):
    """Path, headers and body of a request; `made` is what was made for it."""
    headers = {**target.key, **request.get("headers", {})}
    body, plain = Recipe().body(request)
    if body is not None:
        headers["content-type"] = "application/json"
        if request.get("gzip"):
            headers["content-encoding"] = "gzip"
    return operation.path(request, made), headers, body, plain


def attempt(search, request):
    """Sends one request and measures what it costs.

    Raises `Broken` where a promise does not hold.
    """
    operation, target = search.operation, search.target
    service, arguments = target.rested(), target.arguments
    made = target.things.made_for(operation.name)
    path, headers, body, plain = wired(request, operation, target, made)
    rest = service.resident()
    patience = arguments.compute_seconds + 1
    with service.watched(kill_beyond=1.5e6 * arguments.quota_mb) as watch:
        answer = service.send(operation.method, path, body, headers, timeout=patience + 30, first=patience)
    on_wire = len(body or b"") + len(path) + HEAD_BYTES
    figures = {
        "cpu": round(watch.cpu, 3),
        "seconds": round(answer.seconds, 3),
        "mb": round(max(0, watch.peak - rest) / 1e6, 2),
        "bytes": on_wire,
        "plain": plain,
        "answer": answer.size,
        "status": answer.status,
        "method": operation.method,
        "path": path,
    }
    figures["cpu per kB"], figures["mb per kB"] = (round(1e3 * figures[name] / on_wire, 4) for name in ("cpu", "mb"))
    cancel(target, answer, made)
    check(target, watch, answer, patience)
    check_promise(figures)
    # What breaks a promise is reported, and nothing grows out of it: it would be the same again.
    search.note(request, figures)
    return figures


def check_promise(figures):
    """What one request may take."""
    if figures["mb"] > PROMISED_MB:
        raise Broken(f"memory: {figures['mb']} MB for one request, promised are {PROMISED_MB}")
    most = PROMISED_TIMES * figures["plain"] / 1e6 + SLACK_MB
    if 400 <= figures["status"] < 500 and figures["plain"] > LARGE_BODY and figures["mb"] > most:
        raise Broken(
            f"memory: {figures['mb']} MB for a body of {figures['plain']} B that was refused, promised are {most:.0f}"
        )


def check(target, watch, answer, patience):
    """What must hold after every request."""
    service, quota = target.service, target.arguments.quota_mb
    if watch.killed or watch.peak > 1e6 * quota:
        raise Broken(f"memory: {watch.peak / 1e6:.0f} MB, the quota is {quota}")
    if service.ended():
        raise Broken(f"ended: the process ended with {service.process.returncode}")
    if lines := service.faults():
        raise Broken(f"panic: {lines[0][:200]}")
    if answer.status is None:
        raise Broken(f"hang: no answer within {patience} s ({answer.error})")
    if answer.status >= 500 and answer.status not in (503, 507):
        raise Broken(f"status: {answer.status} {answer.body[:200]!r}")
    if service.ready() != 204:
        raise Broken("readyz: not ready")
    if answer.seconds > 1 and not any(service.quiet(0.5, 0.3) for _ in range(SETTLE)):
        raise Broken(f"hang: its work goes on, 3 s after the answer {answer.status}")


def cancel(target, answer, made):
    """A job is not part of the request that began it, or that it was made for."""
    begun = answer.json() if answer.status == 202 else None
    jobs = {begun.get("id") if isinstance(begun, dict) else None, made.get("job")} - {None, "none", target.things.job}
    for job in jobs:
        target.service.send("POST", f"/v1/jobs/{job}/cancel", headers=target.key, timeout=20)


class Run:
    """A search over all operations, within a time."""

    def __init__(self, arguments):
        self.arguments, self.target = arguments, Target(arguments)
        chosen = [o for o in operations(self.target.document) if re.search(arguments.operations, o.name)]
        self.searches = [Search(operation, self.target, arguments.seed) for operation in chosen]
        self.random, self.broken, self.probes = Random(arguments.seed), [], []
        self.peak_mb, self.end = 0.0, time.monotonic() + 60 * arguments.minutes
        # Some rounds at least, however short the run; what has no body has less to try.
        bodies = sum(bool(operation.schema) for operation in chosen)
        self.spell = min(4.0, 60 * arguments.minutes / max(1, bodies + LEAN * (len(chosen) - bodies)) / 4)

    def over(self):
        return time.monotonic() > self.end or (self.broken and not self.arguments.keep_going)

    def all(self):
        """Rounds until the time is over, or a promise broken."""
        rounds = 0
        while not self.over():
            for search in self.searches:
                self.turn(search)
            if not self.over() and self.arguments.flood_seconds:
                try:
                    self.flood()
                except (RuntimeError, OSError, ValueError, subprocess.SubprocessError) as error:
                    self.breaks("flood", error)
            rounds += 1
            evaluated = sum(search.evaluated for search in self.searches)
            print(
                f"round {rounds}: {evaluated} requests, {len(self.broken)} broken promises, peak {self.peak_mb:.0f} MB",
                flush=True,
            )

    def turn(self, search):
        """One operation for a moment."""
        end = time.monotonic() + self.spell * (1 if search.operation.schema else LEAN)
        while time.monotonic() < end and not self.over():
            request = search.next()
            if estimate(request.get("body")) > self.arguments.most_bytes or toil(request.get("body")) > MOST_TOIL:
                continue
            try:
                figures = attempt(search, request)
                self.peak_mb = max(self.peak_mb, figures["mb"])
            except (Broken, RuntimeError, OSError) as error:
                self.breaks(search.operation.name, error, request)

    def breaks(self, name, error, request=None):
        """Notes a promise that does not hold; goes on with a new process."""
        kind = f"{error}".split(":")[0]
        same = [entry for entry in self.broken if (entry["operation"], entry["kind"]) == (name, kind)]
        if len(same) < KEPT:
            self.broken.append(
                {
                    "operation": name,
                    "kind": kind,
                    "what": f"{error}",
                    "request": request and saved(request, name, self.searches),
                }
            )
        print(f"BROKEN {name}: {error}\n       {json.dumps(request)[:600]}", flush=True)
        if kind != "memory":
            self.target.drop()

    def flood(self):
        """Many clients with the worst requests of all, and somebody who asks for little."""
        pool = [
            (search, entry["request"])
            for search in self.searches
            for entry in search.requests()
            if entry["bytes"] + entry["plain"] < FLOOD_BYTES
            and not search.operation.name.startswith(("delete", "revoke", "remove", "restore"))
        ]
        if not pool:
            return
        self.target.fresh()
        service, over, statuses = self.target.service, threading.Event(), Counter()
        chosen = self.random.sample(pool, min(60, len(pool)))
        made_for = self.target.things.made_for
        requests = [
            (search.operation.method, *wired(request, search.operation, self.target, made_for(search.operation.name)))
            for search, request in chosen
        ]

        def client(number):
            random = Random(f"{self.arguments.seed}:{number}")
            while not over.is_set():
                method, path, headers, body, _ = random.choice(requests)
                statuses[
                    str(service.send(method, path, body, headers, timeout=self.arguments.compute_seconds + 20).status)
                ] += 1

        with service.watched(kill_beyond=1.5e6 * self.arguments.quota_mb) as watch:
            clients = [threading.Thread(target=client, args=(k,), daemon=True) for k in range(FLOOD_CLIENTS)]
            for thread in clients:
                thread.start()
            self.probe(service)
            over.set()
            for thread in clients:
                thread.join(self.arguments.compute_seconds + 25)
        self.after_flood(service, watch, statuses)

    def probe(self, service):
        """A tiny request every 50 ms, by a process of its own."""
        command = [
            sys.executable,
            ROOT / "tests" / "attack" / "probe.py",
            *map(str, service.address),
            str(self.arguments.flood_seconds),
            "0.05",
            self.target.other["authorization"],
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=self.arguments.flood_seconds + 120)
        self.probes.append(json.loads(done.stdout))

    def cancel_jobs(self, service):
        """Ends the jobs of the attacking tenant."""
        for status in ("queued", "running"):
            page = (
                service.send("GET", f"/v1/jobs?status={status}&limit=1000", headers=self.target.key, timeout=20).json()
                or {}
            )
            for job in page.get("items", []):
                service.send("POST", f"/v1/jobs/{job['id']}/cancel", headers=self.target.key, timeout=20)

    def after_flood(self, service, watch, statuses):
        """What must hold then."""
        probe = self.probes[-1]
        probe["heavy"] = dict(statuses)
        self.peak_mb = max(self.peak_mb, watch.above_idle / 1e6)
        try:
            if watch.killed or watch.peak > 1e6 * self.arguments.quota_mb:
                raise Broken(f"memory: {watch.peak / 1e6:.0f} MB, the quota is {self.arguments.quota_mb}")
            if service.ended():
                raise Broken(f"ended: the process ended with {service.process.returncode}")
            if lines := service.faults():
                raise Broken(f"panic: {lines[0][:200]}")
            if bad := {status for status in statuses if status[0] == "5" and status not in ("503", "507")}:
                raise Broken(f"status: {bad}")
            if service.ready() != 204:
                raise Broken("readyz: not ready after a flood")
            # Jobs that were accepted go on when their clients have gone: that is what jobs are for.
            self.cancel_jobs(service)
            if not any(service.quiet(0.5, 0.3) for _ in range(SETTLE)):
                raise Broken("hang: work goes on after a flood whose clients have gone and whose jobs were cancelled")
            if max(probe["latencies"], default=0) > 1e3 * (self.arguments.compute_seconds + 1):
                raise Broken(f"hang: a tiny request of another tenant took {max(probe['latencies']):.0f} ms")
        except Broken as error:
            self.breaks("flood", error)
        # What it left behind is not of the requests that follow.
        self.target.drop()

    def report(self):
        """Everything, as JSON."""
        latencies = [latency for probe in self.probes for latency in probe["latencies"]]
        answers, heavy = Counter(), Counter()
        for probe in self.probes:
            answers.update(probe["statuses"])
            heavy.update(probe["heavy"])
        version = subprocess.run([self.arguments.binary, "--version"], capture_output=True, text=True).stdout.strip()
        keys = {
            "ms p50": percentile(latencies, 50),
            "ms p99": percentile(latencies, 99),
            "ms max": max(latencies, default=None),
        }
        operations = {search.operation.name: self.of_operation(search) for search in self.searches}
        requests = [entry for search in self.searches for entry in flat(search)]
        over = [
            f"{r['method']} {r['path'][:80]}: {r['figures']['seconds']} s, {r['figures']['mb']} MB"
            for r in requests
            if r["figures"]["mb"] > PROMISED_MB or r["figures"]["seconds"] > PROMISED_SECONDS
        ]
        return {
            "program": version,
            "seed": self.arguments.seed,
            "minutes": self.arguments.minutes,
            "compute seconds": self.arguments.compute_seconds,
            "quota MB": self.arguments.quota_mb,
            "evaluated": sum(search.evaluated for search in self.searches),
            "peak MB": round(self.peak_mb),
            "broken": self.broken,
            f"beyond {PROMISED_SECONDS} s or {PROMISED_MB} MB": over,
            "tiny requests of another tenant": {
                "requests": len(latencies),
                "statuses": dict(answers),
                **keys,
                "heavy": dict(heavy),
            },
            "operations": operations,
            "requests": requests,
        }

    def of_operation(self, search):
        """The figures of one operation: how often it was tried, and the worst of each cost."""
        worst = {
            cost: {name: kept[0][name] for name in ("status", "bytes", "cpu", "seconds", "mb")}
            for cost, kept in search.worst.items()
            if kept
        }
        return {"evaluated": search.evaluated, "statuses": dict(search.statuses), "worst": worst}


def flat(search):
    """The worst requests of an operation in the form that tests/attack/run.py replays."""
    return [
        {
            **replayable(entry),
            "figures": {name: entry[name] for name in ("status", "bytes", "plain", "cpu", "seconds", "mb", "answer")},
        }
        for entry in search.requests()
    ]


def replayable(entry):
    """A request with its address."""
    kept = {
        name: entry["request"][name] for name in ("body", "raw", "gzip", "pad", "headers") if name in entry["request"]
    }
    return {"method": entry["method"], "path": entry["path"], **kept}


def saved(request, name, searches):
    """A request that broke a promise, with the address it was sent to."""
    operation = next(search.operation for search in searches if search.operation.name == name)
    return {
        "method": operation.method,
        "path": operation.path(request, {}),
        **{k: v for k, v in request.items() if k not in ("method", "about", "query")},
    }


def summary(report):
    """A line an operation, worst first."""
    lines = []
    for name, found in report["operations"].items():
        worst = found["worst"]
        if worst:
            lines.append(
                (
                    worst["cpu"]["cpu"],
                    f"{name:22} {found['evaluated']:6} requests, worst {worst['cpu']['cpu']:7.2f} CPU s "
                    f"({worst['cpu']['bytes']} B), "
                    f"{worst['seconds']['seconds']:6.2f} s, {worst['mb']['mb']:7.1f} MB ({worst['mb']['bytes']} B)",
                )
            )
    return "\n".join(line for _, line in sorted(lines, reverse=True))


def row(cells):
    """A row of a Markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def table(paths):
    """The runs of docs/reliability.md, and below them the worst of each operation of the last one."""
    heads = [
        "program",
        "minutes",
        "seed",
        "requests",
        "broken promises",
        "peak memory, MB",
        "small requests meanwhile",
        "p50, p99, max, ms",
    ]
    rows = [row(heads), row(["---"] * len(heads))]
    reports = [json.loads(Path(path).read_text()) for path in paths]
    for found in reports:
        tiny = found["tiny requests of another tenant"]
        times = ", ".join("–" if tiny[name] is None else f"{tiny[name]:.1f}" for name in ("ms p50", "ms p99", "ms max"))
        meanwhile = f"{tiny['requests']}, of these not answered {tiny['requests'] - tiny['statuses'].get('200', 0)}"
        cells = [
            found["program"],
            found["minutes"],
            found["seed"],
            found["evaluated"],
            len(found["broken"]),
            found["peak MB"],
            meanwhile,
            times,
        ]
        rows.append(row(cells))
    rows += ["", row(["operation", "requests", "worst processor time", "worst time", "worst memory"]), row(["---"] * 5)]
    for name, found in sorted(reports[-1]["operations"].items()):
        if worst := found["worst"]:
            cpu, wall, memory = worst["cpu"], worst["seconds"], worst["mb"]
            rows.append(
                row(
                    [
                        name,
                        found["evaluated"],
                        f"{cpu['cpu']:.2f} s of {cpu['bytes']} B: {cpu['status']}",
                        f"{wall['seconds']:.2f} s of {wall['bytes']} B: {wall['status']}",
                        f"{memory['mb']:.0f} MB of {memory['bytes']} B: {memory['status']}",
                    ]
                )
            )
    return "\n".join(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, default=ROOT / "target" / "release" / "shapelex")
    parser.add_argument("--minutes", type=float, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--operations", default="", help="operation ids that match this")
    parser.add_argument("--compute-seconds", type=int, default=10, help="given to the service, for light requests too")
    parser.add_argument(
        "--quota-mb",
        type=float,
        default=1024,
        help="memory of the process, given to the service where it knows --max-memory",
    )
    parser.add_argument("--most-bytes", type=int, default=32_000_000, help="longest body, decompressed")
    parser.add_argument("--flood-seconds", type=float, default=10, help="of many clients after each round; 0 for none")
    parser.add_argument("--keep-going", action="store_true", help="note what is broken and go on")
    parser.add_argument("--report", type=Path)
    parser.add_argument("--table", nargs="+", type=Path, help="reports to write as Markdown instead")
    arguments = parser.parse_args()
    if arguments.table:
        print(table(arguments.table))
        return
    run = Run(arguments)
    try:
        run.all()
    finally:
        report = run.report()
        run.target.remove()
        if arguments.report:
            arguments.report.write_text(json.dumps(report, indent=1) + "\n")
    print(summary(report))
    print(
        json.dumps(
            {name: report[name] for name in report if name not in ("operations", "requests", "broken")}, indent=1
        )
    )
    print(f"{report['evaluated']} requests, {len(report['broken'])} broken promises")
    raise SystemExit(1 if report["broken"] else 0)


if __name__ == "__main__":
    main()
