#!/usr/bin/env python3
"""Sends the requests of an attack to the program and checks that every one is answered, or refused, within its bounds.

    tests/attack/run.py small [--binary target/debug/shapelex]     as `make test-all` does: small sizes, bounds on
    memory and status
    tests/attack/run.py full --binary target/release/shapelex      the sizes that were found, bounds on time too
    tests/attack/run.py full --binary … --table                    the same as a Markdown table, for docs/reliability.md
    tests/attack/run.py small --open --only '^C1'                  also those that open.json says are not mended yet
    tests/attack/run.py replay FILE --binary …                     requests that benches/attack has saved

Cases are data (cases/*.json): a request as a recipe (recipe.py), the statuses that are right, and the bounds; or a
scenario of several requests (scenarios.py). Memory is the peak of a process that had done nothing else of weight.
`before` is what commit 695ea30 did. The last line is `N passed, N failed`.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path

from recipe import BOUNDARY, Recipe

from service import KILL_BEYOND, MIB, Service, Skipped

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent

# Bounds of the issue: a request that takes longer, or more, is a failure, whatever it answers.
FULL = {"seconds": 10, "mb": 512}
# A program built for tests is slow, and machines of CI are shared: what is meant to end must end, no more is asked of
# time.
SMALL = {"seconds": 30, "mb": 512}
TIMELESS = {"seconds": SMALL["seconds"]}
# Without an answer in this time a request hangs, however busy the machine is.
HANG_SECONDS = 60
# What any request may take beside its body, in bytes, however long that is: 100 000 shapes of a list (--max-shapes)
# that are kept before it is refused, of 336 B each, and buffers of the connection, stacks of threads that wake up,
# pages of the allocator. What is sent is long enough to pass it if it is not bounded.
SLACK = 64 * MIB
# Memory that a service may keep between two cases: beyond it the next one gets a process of its own.
AT_REST = 8 * MIB

TRIANGLES = [
    [[0, 0], [4, 0], [4, 1]],
    [[0, 0], [3, 0], [4, 2]],
    [[0, 1], [3, 0], [5, 2]],
    [[0, 0], [2, 0], [2, 2]],
    [[1, 0], [3, 1], [2, 5]],
    [[0, 2], [2, 0], [1, 4]],
]


def filled(text, variables):
    """`{name}` and `{name[key]}` of a text; other braces stay."""

    def value(match):
        found = variables.get(match[1], match[0])
        return str(
            found[match[2]]
            if match[2]
            else found
            if isinstance(found, str)
            else json.dumps(found)
            if match[1] in variables
            else found
        )

    return re.sub(r"\{(\w+)(?:\[(\w+)\])?\}", value, text)


def variants(case):
    """The settings of variables that a case stands for."""
    rows = [{**row, **pair} for row in case.get("rows", [{}]) for pair in case.get("pairs", [{}])]
    names = list(case.get("each", {}))
    for row in rows:
        for values in product(*case.get("each", {}).values()):
            yield {**row, **dict(zip(names, values))}


def load(bounds):
    """All cases, with the sizes and bounds of a run."""
    cases = []
    for path in sorted((HERE / "cases").glob("*.json")):
        document = json.loads(path.read_text())
        for case in document["cases"]:
            case = {**document["defaults"], **case}
            small = dict(case.get("small", {})) if bounds == "small" else {}
            keep = small.pop("keep", None)
            found = list(variants(case))
            if keep and keep < len(found):
                # Spread over all, and not in step with the last of the lists.
                stride = len(found) // keep
                found = [found[k * len(found) // keep + k % stride] for k in range(keep)]
            for variant in found:
                variables = {**case.get("vars", {}), **small, **variant}
                # Time is bounded as the case says only where the program is built for speed.
                limits = (
                    {**FULL, **case.get("bounds", {})}
                    if bounds == "full"
                    else {**SMALL, **case.get("bounds", {}), **TIMELESS}
                )
                cases.append(
                    {**case, "variables": variables, "bounds": limits, "name": filled(case["name"], variables)}
                )
    return cases


def still_open(case):
    """Why a case is known to fail still, or nothing: then it is not sent unless asked for."""
    if case["finding"] == "saved":
        return None
    known = json.loads((HERE / "open.json").read_text())["cases"]
    return next(
        (entry["why"] for entry in known if re.search(entry["match"], f"{case['finding']} {case['name']}")), None
    )


class Attack:
    """The services that cases are sent to."""

    def __init__(self, binary, bounds):
        self.binary, self.bounds = Path(binary).resolve(), bounds
        self.folder = Path(tempfile.mkdtemp(prefix="shapelex-attack-"))
        self.current = None
        self.open_store = self.furnish()

    def furnish(self):
        """A store with a cohort and a dictionary, to be copied."""
        service = Service(self.binary, ["--no-example"], folder=self.folder).start()
        service.post(
            "/v1/cohorts", {"name": "attacked", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}}
        )
        names = ["one", "two", "three", "four", "five", "six"]
        shapes = [
            {"external_id": name, "label": "ab"[k % 2], "subject": f"s{k // 2}", "points": points}
            for k, (name, points) in enumerate(zip(names, TRIANGLES))
        ]
        service.post("/v1/cohorts/attacked/shapes", {"shapes": shapes})
        learn = {
            "name": "modes",
            "cohort": "attacked",
            "transformation": "similarity",
            "method": {"kind": "functional_pca", "components": 2, "centre": True},
        }
        service.post("/v1/dictionaries", learn, {"prefer": "wait=50"})
        if service.stop() != 0:
            raise SystemExit("the service does not stop in order")
        return self.folder / "data"

    def fresh(self, flags=(), **settings):
        """A service on a copy of that store, not yet started."""
        service = Service(self.binary, ["--no-example", *flags], **settings)
        shutil.copytree(self.open_store, service.folder / "data", dirs_exist_ok=True)
        return service

    def shared(self):
        """A started service that has nothing of an earlier case in memory."""
        found = self.current
        if found is None or found.ended() or found.resident() > found.idle + AT_REST or not found.quiet(0.05, 0.5):
            self.drop()
            self.current = self.fresh().start()
        return self.current

    def drop(self):
        """Ends the shared service."""
        if self.current:
            self.current.remove()
            self.current = None

    def remove(self):
        """Ends everything."""
        self.drop()
        shutil.rmtree(self.folder, ignore_errors=True)


def request_of(case, service):
    """Method, path, headers and body of a case."""
    variables = {**case["variables"], "own": "http://{}:{}".format(*service.address)}
    fill = lambda text: filled(text, variables)
    body, plain = Recipe(variables).body(case)
    headers = {fill(name): fill(value) for name, value in case.get("headers", {}).items()}
    if body is not None:
        headers.setdefault(
            "content-type", f"multipart/form-data; boundary={BOUNDARY}" if "form" in case else "application/json"
        )
        if Recipe(variables).number(case.get("gzip")):
            headers["content-encoding"] = "gzip"
    path = fill(case.get("path", ""))
    if long := case.get("path_long"):
        path = fill(long["before"]) + long["text"] * long["times"]
    return fill(case["method"]), path, headers, body, plain


def at(document, pointer):
    """What a JSON pointer names, or nothing."""
    for part in pointer.strip("/").split("/"):
        try:
            document = document[int(part)] if isinstance(document, list) else document[part]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return document


def send(attack, case):
    """A single request: its figures, and what is wrong."""
    service = attack.shared()
    method, path, headers, body, plain = request_of(case, service)
    limits = case["bounds"]
    with service.watched(KILL_BEYOND[attack.bounds]) as watch:
        answer = service.send(method, path, body, headers, timeout=HANG_SECONDS)
    figures = {
        "bytes": len(body or b"") or len(path),
        "status": answer.status,
        "seconds": answer.seconds,
        "cpu": watch.cpu,
        "mb": watch.above_idle / 1e6,
        "answer": answer.size,
    }
    most = limits["mb"] * 1e6
    if "times" in limits:
        most = min(most, limits["times"] * plain + SLACK)
    return figures, list(faults(case, service, answer, watch, most))


def faults(case, service, answer, watch, most):
    """What is wrong with an answer and with what it took."""
    limits = case["bounds"]
    if watch.killed:
        yield f"took more than {watch.peak / 1e6:.0f} MB and was ended"
    elif service.ended():
        yield f"ended the process with {service.process.returncode}"
    elif answer.status is None:
        yield f"no answer in {answer.seconds:.0f} s: {answer.error}"
    elif answer.status not in case["expect"]:
        yield (
            f"answered {answer.status}, expected one of {case['expect']}: {answer.body[:160].decode(errors='replace')}"
        )
    if watch.above_idle > most:
        yield f"took {watch.above_idle / 1e6:.0f} MB, expected at most {most / 1e6:.0f}"
    # Where others have the processors, a request waits for them: then the work that it took is what is bounded.
    busy = os.getloadavg()[0] > os.cpu_count() + 1
    if (watch.cpu if busy and answer.status else answer.seconds) > limits["seconds"]:
        yield f"took {answer.seconds:.1f} s, expected at most {limits['seconds']}"
    if answer.size > limits.get("answer", answer.size):
        yield f"answered {answer.size} bytes, expected at most {limits['answer']}"
    yield from (f"in the log: {line[:200]}" for line in service.faults())
    if answer.status is not None and not service.ended():
        yield from content_faults(case, answer)
        if service.ready() != 204:
            yield "is not ready afterwards"


def content_faults(case, answer):
    """What is wrong with headers and body."""
    for name, value in case.get("answers", {}).items():
        if value not in answer.headers.get(name, ""):
            yield f"header {name} is {answer.headers.get(name)!r}, expected to hold {value!r}"
    text = answer.body.decode(errors="replace")
    if "absent" in case and case["absent"] in text:
        yield f"{case['absent']!r} is in the answer"
    if re.search(r"[:\[,]\s*-?(NaN|inf)", text):
        yield "the answer has a number that is none"
    if answer.status == 200 and "warns" in case and not at(answer.json(), case["warns"]):
        yield f"{case['warns']} is {at(answer.json(), case['warns'])!r}, expected a warning"
    if answer.status == 200 and "most" in case:
        pointer, bound = case["most"]
        value = at(answer.json(), pointer)
        if value is not None and value > bound:
            yield f"{pointer} is {value}, expected at most {bound}"


def play(attack, case):
    """A scenario: its figures, and what is wrong."""
    import scenarios

    return getattr(scenarios, case["scenario"])(attack, **case["variables"])


def size_text(number):
    """Bytes as people say them."""
    return f"{number:.0f} B" if number < 1e4 else f"{number / 1e3:.0f} kB" if number < 1e6 else f"{number / 1e6:.1f} MB"


def before_text(case):
    """What the program did before."""
    old = case.get("before", {})
    parts = [f"{old['cpu']} CPU s"] if "cpu" in old else []
    parts += [f"{old['mb']} MB"] if "mb" in old else []
    parts += [old["says"]] if "says" in old else []
    return ", ".join(parts) or "–"


def now_text(figures):
    """What it does now."""
    if "says" in figures:
        return figures["says"]
    cpu = f"{figures['cpu']:.2f} CPU s"
    large = f", answers {size_text(figures['answer'])}" if figures["answer"] > 1e6 else ""
    return f"{figures['status']}, {cpu}, {figures['mb']:.0f} MB{large}"


def examine(attack, case):
    """One case: `ok`, `FAIL` or `skip`, its figures and what is wrong."""
    try:
        figures, wrong = play(attack, case) if "scenario" in case else send(attack, case)
        if case.get("alone"):
            # What it did would be in the way of others.
            attack.drop()
    except Skipped as reason:
        return "skip", {"says": str(reason)}, []
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        attack.drop()
        figures, wrong = {"says": f"{type(error).__name__}"}, [str(error)[:300]]
    return ("FAIL" if wrong else "ok"), figures, wrong


def bytes_text(case, figures):
    """What was sent."""
    size = figures.get("bytes") or case.get("before", {}).get("bytes")
    return size_text(size) if size else "–"


def line_text(verdict, case, figures, wrong):
    """One line a case."""
    parts = [
        f"{verdict:4} {case['finding']:5} {case['name']}",
        bytes_text(case, figures),
        f"before: {before_text(case)}",
        f"now: {now_text(figures)}",
    ]
    return " | ".join(parts) + "".join(f"\n       {what}" for what in wrong)


def table_row(verdict, case, figures, wrong):
    """One row a case."""
    now = now_text(figures) + (f" **{wrong[0]}**" if wrong else "")
    cells = [case["finding"], case["name"], bytes_text(case, figures), before_text(case), now]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def replayed(path):
    """Requests that were saved by a search."""
    saved = json.loads(Path(path).read_text())
    requests = saved if isinstance(saved, list) else saved["requests"]
    case = {"finding": "saved", "variables": {}, "bounds": FULL, "expect": range(200, 504)}
    return [{**case, "name": f"{found['method']} {found['path']}", **found} for found in requests]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bounds", choices=["small", "full", "replay"], nargs="?", default="small")
    parser.add_argument("file", nargs="?", help="with replay: what to send")
    parser.add_argument("--binary", type=Path, default=ROOT / "target" / "debug" / "shapelex")
    parser.add_argument("--only", default="", help="cases whose finding and name match this")
    parser.add_argument("--open", action="store_true", help="also the cases of open.json")
    parser.add_argument("--table", action="store_true", help="as a Markdown table")
    parser.add_argument("--report", type=Path, help="figures as JSON")
    arguments = parser.parse_args()
    cases = replayed(arguments.file) if arguments.bounds == "replay" else load(arguments.bounds)
    cases = [case for case in cases if re.search(arguments.only, f"{case['finding']} {case['name']}")]
    opened = [] if arguments.open else [case for case in cases if still_open(case)]
    cases = [case for case in cases if case not in opened]
    if not arguments.binary.exists():
        print(f"SKIPPED: the attacks, there is no {arguments.binary}")
        return
    begin, counts, report = time.monotonic(), {"ok": 0, "FAIL": 0, "skip": 0}, []
    attack = Attack(arguments.binary, "full" if arguments.bounds == "replay" else arguments.bounds)
    if arguments.table:
        print("| finding | request | bytes | before | now |\n| --- | --- | --- | --- | --- |")
    try:
        for case in cases:
            verdict, figures, wrong = examine(attack, case)
            counts[verdict] += 1
            report.append(
                {"verdict": verdict, "finding": case["finding"], "name": case["name"], **figures, "wrong": wrong}
            )
            print((table_row if arguments.table else line_text)(verdict, case, figures, wrong), flush=True)
    finally:
        attack.remove()
    if arguments.report:
        arguments.report.write_text(json.dumps(report, indent=1) + "\n")
    for why in dict.fromkeys(still_open(case) for case in opened):
        print(f"OPEN: {sum(still_open(case) == why for case in opened)} cases: {why}")
    if not arguments.table:
        # Again at the end: of a long log often only the end is kept.
        for case in (case for case in report if case["verdict"] == "FAIL"):
            print(f"FAIL {case['finding']} {case['name']}: {'; '.join(case['wrong'])}")
        for case in (case for case in report if case["verdict"] == "skip"):
            print(f"SKIPPED: {case['finding']} {case['name']}: {case['says']}")
        print(f"attack: {time.monotonic() - begin:.0f} s")
        print(f"{counts['ok']} passed, {counts['FAIL']} failed")
    sys.exit(1 if counts["FAIL"] else 0)


if __name__ == "__main__":
    main()
