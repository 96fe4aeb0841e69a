"""Measures what docs/scale.md says of clusters: executors as processes on this machine.

    python3 crates/shapelex-engine/benches/cluster.py PROGRAM STORE COHORT REVISION [--executors 1,2,4] [--kills N]
    [--codes DICTIONARY]

STORE holds the revision of COHORT, as `ingest` writes it; DICTIONARY is a file that the service has exported. A run is
a pass: the scatter of all shapes, or with --codes their codes. One line of JSON for each run: time, digest of its
answer, processor time and peak memory of the client and of the executors. With --kills, N runs on two executors, in
each of which both executors and the scheduler are killed at moments drawn at random (seed: number of the run), and
started again: `lost_s` is the processor time spent twice, by executor, and `waited_s` what the run took longer than
that.
"""

import argparse
import hashlib
import json
import pathlib
import random
import resource
import signal
import socket
import subprocess
import tempfile
import threading
import time


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def used(process):
    """Processor seconds and peak memory in MiB of a running process."""
    root = pathlib.Path("/proc", str(process.pid))
    fields = (root / "stat").read_text().rsplit(")", 1)[1].split()
    peak = next(line for line in (root / "status").read_text().splitlines() if line.startswith("VmHWM"))
    return (int(fields[11]) + int(fields[12])) / 100, int(peak.split()[1]) // 1024


class Cluster:
    def __init__(self, program, store, executors):
        self.program, self.store, self.folder = program, store, tempfile.TemporaryDirectory()
        self.port, self.executors = free_port(), []
        self.scheduler = self.start_scheduler()
        for _ in range(executors):
            self.executors.append(self.start_executor())
        time.sleep(3)

    def start(self, *arguments):
        return subprocess.Popen([self.program, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def start_scheduler(self):
        return self.start("scheduler", "--listen", f"127.0.0.1:{self.port}")

    def start_executor(self):
        port = free_port()
        return self.start(
            "--store",
            self.store,
            "executor",
            "--scheduler",
            f"127.0.0.1:{self.port}",
            "--listen",
            f"127.0.0.1:{port}",
            "--folder",
            f"{self.folder.name}/{port}",
        )

    def kill(self, process):
        process.send_signal(signal.SIGKILL)
        process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in [*self.executors, self.scheduler]:
            self.kill(process)
        self.folder.cleanup()


def request(store, cohort, revision, codes):
    """The pass: codes in a dictionary if there is one, else the scatter of the shapes."""
    about = {"cohort": cohort, "revision": revision, "transformation": "similarity", "alignment": "projection"}
    if codes:
        return {**about, "work": {"code": json.loads(pathlib.Path(codes).read_text())["content"]}}
    manifest = json.loads((pathlib.Path(store, cohort, "revisions") / f"{revision:020}.json").read_text())
    representation = manifest["manifest"]["cohort"]["representation"]
    width = representation["dimension"] * (representation.get("points") or representation["control_points"])
    return {**about, "work": {"sum": {"aligned": None, "sum": {"kind": "scatter", "origin": [0.0] * width}}}}


def run(program, store, asked, *arguments):
    """Digest of the answer to a pass, with its time, processor time and reports."""
    began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [program, "--store", store, "pass", *arguments]
    done = subprocess.run(command, input=json.dumps(asked).encode(), capture_output=True)
    after, said = resource.getrusage(resource.RUSAGE_CHILDREN), done.stderr.decode()
    if done.returncode != 0:
        raise SystemExit(said)
    client = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return hashlib.sha256(done.stdout).hexdigest(), time.monotonic() - began, client, said


def report(name, digest, seconds, client, said, executors, **more):
    line = {
        "run": name,
        "seconds": round(seconds, 2),
        "digest": digest[:12],
        "client_cpu_s": round(client, 2),
        "executors_cpu_s": [round(cpu, 2) for cpu, _ in executors],
        "executors_peak_mib": [peak for _, peak in executors],
        "jobs": said.count('{"job":'),
        "resubmitted": said.count("is submitted again"),
        **more,
    }
    print(json.dumps(line), flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("store")
    parser.add_argument("cohort")
    parser.add_argument("revision", type=int)
    parser.add_argument("--executors", default="1,2,4")
    parser.add_argument("--kills", type=int, default=0)
    parser.add_argument("--codes")
    options = parser.parse_args()
    program, store = options.program, options.store
    asked = request(store, options.cohort, options.revision, options.codes)

    alone, seconds, client, said = run(program, store, asked, "--threads", "2")
    report("one process, two threads", alone, seconds, client, said, [])
    for count in map(int, filter(None, options.executors.split(","))):
        with Cluster(program, store, count) as cluster:
            digest, seconds, client, said = run(program, store, asked, "--scheduler", f"127.0.0.1:{cluster.port}")
            report(
                f"{count} executors", digest, seconds, client, said, [used(process) for process in cluster.executors]
            )
            assert digest == alone, "the digest of a cluster is another one"
            undisturbed, work = seconds, sum(used(process)[0] for process in cluster.executors)
    for number in range(options.kills):
        draw = random.Random(number)
        with Cluster(program, store, 2) as cluster:
            killed = []
            moments = sorted(
                (draw.uniform(0, undisturbed), victim) for victim in ("executor 0", "executor 1", "scheduler")
            )

            def disturb(began):
                for moment, victim in moments:
                    time.sleep(max(0, began + moment - time.monotonic()))
                    if victim == "scheduler":
                        cluster.kill(cluster.scheduler)
                        cluster.scheduler = cluster.start_scheduler()
                    else:
                        index = int(victim[-1])
                        killed.append(used(cluster.executors[index])[0])
                        cluster.kill(cluster.executors[index])
                        cluster.executors[index] = cluster.start_executor()

            disturbing = threading.Thread(target=disturb, args=[time.monotonic()])
            disturbing.start()
            digest, seconds, client, said = run(program, store, asked, "--scheduler", f"127.0.0.1:{cluster.port}")
            disturbing.join()
            # Work that was done twice, on two executors; what is longer still is waiting.
            lost = (sum(killed) + sum(used(process)[0] for process in cluster.executors) - work) / 2
            report(
                f"killed, run {number}",
                digest,
                seconds,
                client,
                said,
                [used(process) for process in cluster.executors],
                lost_s=round(lost, 1),
                waited_s=round(seconds - undisturbed - lost, 1),
                moments=[(round(moment, 1), victim) for moment, victim in moments],
                notices=said.splitlines()[:6],
            )
            assert digest == alone, "the digest of a disturbed cluster is another one"


if __name__ == "__main__":
    main()
