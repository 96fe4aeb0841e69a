"""A service with an engine finds the numbers of one without, bit by bit.

    python3 tests/service.py SHAPELEX SHAPELEX_ENGINE

Starts the service on a new store, uploads a cohort, and compares means and dictionaries with those whose passes the
engine has computed: on this machine, on a cluster, and where it fails.
"""

import contextlib
import json
import math
import os
import pathlib
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request

FETCH = pathlib.Path(__file__).parent.parent / "fetch.py"
SHAPES = 20_000  # three parts
ATOMS = {"kind": "sparse", "atoms": 6, "nonzeros": 2, "schedule": "batch", "max_epochs": 3}
# An engine that does not code after the first epoch.
FAILS = """#!/bin/sh
case " $* " in
*" pass "*) ;;
*) exec {engine} "$@" ;;
esac
request=$(cat)
case $request in
*'"epoch":1,'*) echo "no room" >&2; exit 3 ;;
esac
printf %s "$request" | {engine} "$@"
"""


def send(address, body, media_type):
    request = urllib.request.Request(address, body.encode(), {"content-type": media_type})
    with urllib.request.urlopen(request, timeout=300) as answer:
        return json.load(answer)


def points(k):
    """A leaf: turned, scaled and moved."""
    turn, size = k * 0.61, 1 + 0.3 * math.sin(k)
    leaf = [
        (math.cos(a) * 2 + 0.3 * math.sin(k * 0.3 + 2 * a), math.sin(a) + 0.2 * math.cos(k + 3 * a))
        for a in (i * math.tau / 8 for i in range(8))
    ]
    return [
        [size * (x * math.cos(turn) - y * math.sin(turn)) + k % 7, size * (x * math.sin(turn) + y * math.cos(turn))]
        for x, y in leaf
    ]


def compare(address, shapelex_engine, folder):
    """What a service without an engine finds: means by their queries, and digests of dictionaries by their methods. The
    engine alone codes the shapes in a dictionary that the service has exported."""
    closed = {"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "cubic"}}
    send(f"{address}/v1/cohorts", json.dumps({"name": "leaves", "representation": closed}), "application/json")
    lines = "\n".join(
        json.dumps(
            {"external_id": str(k), "label": "ab"[k % 2], "labels": {"k": k}, "weight": 1 + k % 3, "points": points(k)}
        )
        for k in range(SHAPES)
    )
    send(f"{address}/v1/cohorts/leaves/shapes?return=none", lines, "application/x-ndjson")
    components = json.dumps({"kind": "functional_pca", "components": 5, "centre": True})
    found = (
        means(address),
        {
            method: learn(address, f"by-{number}", json.loads(method))
            for number, method in enumerate([components, json.dumps(ATOMS)])
        },
    )
    with urllib.request.urlopen(f"{address}/v1/dictionaries/by-0/export", timeout=60) as answer:
        exported = json.load(answer)
    subprocess.run([sys.executable, FETCH, address, "leaves", folder], check=True)
    coded(shapelex_engine, folder, exported)
    return found


def means(address):
    """Stored means, with their eigenvalues."""
    found = {}
    for transformation, alignment in [("similarity", "projection"), ("affine", "projection"), ("rigid", "procrustes")]:
        query = f"transformation={transformation}&alignment={alignment}"
        with urllib.request.urlopen(f"{address}/v1/cohorts/leaves/mean?{query}", timeout=300) as answer:
            mean = json.load(answer)
        found[query] = mean["mean"]["control_points"], mean["eigenvalues"]
    return found


def coded(shapelex_engine, folder, exported):
    """Passes over a cohort that was fetched: the digest of the dictionary is that of the service, and threads do not
    matter."""

    def engine(*arguments, request=None):
        command = [shapelex_engine, f"--store={folder}/store", *arguments]
        return subprocess.run(
            command, check=True, stdout=subprocess.PIPE, input=request and json.dumps(request).encode()
        ).stdout

    engine("ingest", f"--cohort={folder}/cohort.json", f"--shapes={folder}/shapes.ndjson")
    cohort = json.loads((folder / "cohort.json").read_text())
    about = {
        "cohort": cohort["id"],
        "revision": cohort["revision"],
        "transformation": "similarity",
        "alignment": "projection",
    }
    scatter = {"sum": {"aligned": None, "sum": {"kind": "scatter", "origin": [0.0] * 16}}}
    for work in [scatter, {"code": exported["content"]}]:
        one, two = (engine("pass", f"--threads={threads}", request={**about, "work": work}) for threads in (1, 2))
        if one != two:
            sys.exit(f"the engine answers {one} on one thread, {two} on two")
    answer = json.loads(two)
    if answer["dictionary"] != exported["digest"] or sum(file["shapes"] for file in answer["files"]) != SHAPES:
        sys.exit(f"the engine codes in {exported['digest']}: {answer}")
    print(f"{SHAPES} shapes: the engine codes them in a dictionary of the service")


def learn(address, name, method):
    """Learns a dictionary by a job; returns its digest."""
    order = {"name": name, "cohort": "leaves", "method": method, "transformation": "similarity"}
    finished(address, send(f"{address}/v1/dictionaries", json.dumps(order), "application/json"))
    with urllib.request.urlopen(f"{address}/v1/dictionaries/{name}/export", timeout=60) as answer:
        return json.load(answer)["digest"]


def compute_through(address, found, folder):
    """A service with an engine finds the same means and dictionaries, and leaves no files of shapes behind."""
    expected, digests = found
    again = means(address)
    # Two passes of each projection, and the iterations of a Procrustes mean.
    passes = (folder / "log").read_text().count("the engine computed a pass")
    if again != expected or passes < 6:
        sys.exit(f"the service with an engine has the means {again}, without {expected}, by {passes} passes")
    for number, (method, digest) in enumerate(digests.items()):
        again = learn(address, f"again-{number}", json.loads(method))
        log = (folder / "log").read_text()
        # The mean, its frame, the certificate; components are a pass as well.
        if again != digest or log.count("the engine computed a pass") - passes < (4, 7)[number]:
            sys.exit(f"the service with an engine learns {again} for {digest}: {log}")
    # A group for each epoch.
    if log.count("the engine coded a group") != ATOMS["max_epochs"] or "the engine failed" in log:
        sys.exit(f"the engine codes other groups: {log}")
    nothing_is_kept(folder)
    print(f"{SHAPES} shapes: means and jobs of the service on the engine have the same bits")


def learn_in_spite_of(address, found, folder):
    """An engine that fails to code in the second epoch: learning begins again in the service."""
    digests = found[1]
    again, log = learn(address, "in-spite", ATOMS), (folder / "log").read_text()
    if (
        again != digests[json.dumps(ATOMS)]
        or log.count("the engine coded a group") != 1
        or log.count("the engine failed") != 1
    ):
        sys.exit(f"the service learns {again} for {digests} with an engine that fails to code: {log}")
    nothing_is_kept(folder)
    print(f"{SHAPES} shapes: a job whose engine fails to code has the same bits")


def learn_on_a_cluster(address, found, folder):
    """A job whose passes run on executors; the log names its jobs at the scheduler."""
    digests = found[1]
    again, log = learn(address, "on-a-cluster", ATOMS), (folder / "log").read_text()
    if again != digests[json.dumps(ATOMS)] or log.count("the engine coded a group") != ATOMS["max_epochs"]:
        sys.exit(f"the service learns {again} for {digests} on a cluster: {log}")
    submitted = set(re.findall(r'job of the cluster was submitted job="job_[0-9a-f]+" at_cluster="(\w+)"', log))
    known = set(re.findall(r"Job queued: \[(\w+)\]", (folder / "scheduler").read_text()))
    if submitted != known or len(known) != 3 + ATOMS["max_epochs"]:
        sys.exit(f"the service names the jobs {submitted}, the scheduler {known}: {log}")
    nothing_is_kept(folder)
    print(f"{SHAPES} shapes: jobs of the service on a cluster have the same bits, and the log names them")


@contextlib.contextmanager
def cluster(shapelex_engine, folder):
    """A scheduler with an executor; its address."""
    scheduler, executor = (f"127.0.0.1:{free_port()}" for _ in range(2))
    commands = {
        "scheduler": ["scheduler", f"--listen={scheduler}"],
        "executor": ["executor", f"--scheduler={scheduler}", f"--listen={executor}"],
    }
    processes, environment = [], {**os.environ, "SHAPELEX_ENGINE_LOG": "info"}
    try:
        for name, command in commands.items():
            with open(folder / name, "w") as log:
                command = [shapelex_engine, f"--store={folder}/jobs", *command]
                processes.append(subprocess.Popen(command, stdout=log, stderr=log, env=environment))
        yield scheduler
    finally:
        for process in processes:
            process.terminate()
            process.wait(60)


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def nothing_is_kept(folder):
    kept = [path for path in folder.glob("jobs/**/*") if path.is_file()]
    if kept:
        sys.exit(f"the engine keeps {kept}")


def finished(address, job):
    """Waits for the end of a job, and returns it."""
    while True:
        with urllib.request.urlopen(f"{address}/v1/jobs/{job['id']}", timeout=60) as answer:
            job = json.load(answer)
        if job["status"] not in ("queued", "running"):
            break
        time.sleep(0.2)
    if job["status"] != "succeeded":
        sys.exit(f"the job of the service ended as {job}")
    return job


def serve(shapelex, folder, use, *flags):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SHAPELEX_")}
    command = [shapelex, "serve", "--listen=127.0.0.1:0", f"--data-dir={folder}/data", *flags]
    with open(folder / "log", "w") as log:
        service = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, env=environment, text=True)
        try:
            line = service.stdout.readline()
            if " on http" not in line:
                sys.exit(f"the service does not start: {(folder / 'log').read_text()}")
            return use(line.split(" on ")[1].strip())
        finally:
            service.terminate()
            service.wait(60)


def main(shapelex, shapelex_engine):
    for program in (shapelex, shapelex_engine):
        if not pathlib.Path(program).exists():
            print(f"SKIPPED: the service and the engine are not compared, there is no {program}")
            return
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        found = serve(shapelex, folder, lambda address: compare(address, shapelex_engine, folder))
        (folder / "fails").write_text(FAILS.format(engine=pathlib.Path(shapelex_engine).absolute()))
        (folder / "fails").chmod(0o755)
        flags = [f"--engine-store={folder}/jobs", "--engine-min-shapes=1000", "--log=info,shapelex=debug"]
        for use, program in [(compute_through, shapelex_engine), (learn_in_spite_of, folder / "fails")]:
            serve(shapelex, folder, lambda address: use(address, found, folder), f"--engine={program}", *flags)
        with cluster(shapelex_engine, folder) as scheduler:
            serve(
                shapelex,
                folder,
                lambda address: learn_on_a_cluster(address, found, folder),
                f"--engine={shapelex_engine}",
                f"--engine-scheduler={scheduler}",
                *flags,
            )


if __name__ == "__main__":
    main(*sys.argv[1:])
