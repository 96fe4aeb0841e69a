#!/usr/bin/env python3
"""Sends requests made from the OpenAPI document to a running service, once per role, and checks every answer.

    tests/contract/run.py short     some two minutes, for CI
    tests/contract/run.py long      some six minutes

No answer may be a failure on the service's side, and each must have a status, media type, headers and a body that the
document describes. Each role counts as one test. Where Python packages cannot be had, this is skipped with a line that
says so.
"""

import argparse
import contextlib
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import urllib.request

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent))

import environment  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))

# As whom the document is gone through: without keys, when everybody is served, and with a key of each role.
ROLES = ["open", "reader", "writer", "admin"]

# Seconds for all roles, and examples per operation.
PROFILES = {"short": (100, 8), "long": (360, 200)}

SEED = 6

CHECKS = [
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
    "unsupported_method",
    "allow_header_conformance",
]

# A service built for tests is slow: what it may be asked for is small.
FLAGS = [
    "--log=warn",
    "--threads=1",
    "--max-body-bytes=1000000",
    "--max-line-bytes=100000",
    "--max-points=2000",
    "--max-shapes=200",
    "--max-control-points=100",
    "--max-atoms=16",
    "--max-matrix-bytes=1000000",
    "--max-matrix-operations=10000000",
    "--max-search-operations=100000000",
]

TRIANGLES = [
    [[0, 0], [4, 0], [4, 1]],
    [[0, 0], [3, 0], [4, 2]],
    [[0, 1], [3, 0], [5, 2]],
    [[0, 0], [2, 0], [2, 2]],
    [[1, 0], [3, 1], [2, 5]],
    [[0, 2], [2, 0], [1, 4]],
]


def tester():
    """The program, installed in an environment of its own; nothing when it cannot be had."""
    folder = TARGET / "contract"
    program = folder / "bin" / "schemathesis"
    requirements = (HERE / "requirements.txt").read_text()
    installed = folder / "installed.txt"
    if installed.exists() and installed.read_text() == requirements:
        return program
    try:
        environment.created(folder, ["-r", HERE / "requirements.txt"])
    except environment.Unavailable as reason:
        print(f"SKIPPED: the contract test, schemathesis cannot be installed: {reason}")
        return None
    installed.write_text(requirements)
    return program


def roles(shapelex):
    """Those that the program knows."""
    found = subprocess.run([shapelex, "key", "--help"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return ROLES if found.returncode == 0 else ROLES[:1]


def authorization(shapelex, folder, role):
    """The header of a new key, or none where everybody is served."""
    if role == "open":
        return {}
    command = [shapelex, "key", "create", f"--name={role}", f"--role={role}", f"--data-dir={folder}/data"]
    key = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    return {"authorization": f"Bearer {key}"}


@contextlib.contextmanager
def service(shapelex, folder):
    """The service on a new store with the example cohort; its address."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("SHAPELEX_")}
    command = [shapelex, "serve", "--listen=127.0.0.1:0", f"--data-dir={folder}/data", *FLAGS]
    with open(f"{folder}/log", "w+") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, env=environment, text=True)
        try:
            line = process.stdout.readline()
            if " on http" not in line:
                sys.exit(f"the service does not start: {(pathlib.Path(folder) / 'log').read_text()}")
            yield line.split(" on ")[1].strip()
            if process.poll() is not None:
                sys.exit(f"the service ended with {process.returncode}")
        finally:
            process.terminate()
            process.wait(60)
            log.seek(0)
            lines = [line for line in log.read().splitlines() if " ERROR " in line or "panicked" in line]
            print("\n".join(lines[-20:]))


def post(address, path, body, headers):
    """Sends JSON and waits for the answer."""
    headers = {"content-type": "application/json", "prefer": "wait=60", **headers}
    request = urllib.request.Request(address + path, json.dumps(body).encode(), headers)
    with urllib.request.urlopen(request, timeout=90) as answer:
        return answer.status


def furnish(address, headers):
    """What the names in schemathesis.toml stand for."""
    landmarks = {"kind": "landmarks", "dimension": 2, "points": 3}
    for name in ["contract", "doomed"]:
        post(address, "/v1/cohorts", {"name": name, "representation": landmarks}, headers)
    names = ["one", "two", "three", "four", "five", "six"]
    shapes = [
        {"external_id": name, "label": "ab"[k % 2], "subject": f"s{k // 2}", "labels": {"age": k}, "points": points}
        for k, (name, points) in enumerate(zip(names, TRIANGLES))
    ]
    for name in ["contract", "doomed"]:
        post(address, f"/v1/cohorts/{name}/shapes", {"shapes": shapes}, headers)
    for name, cohort, components, classifier in [
        ("components", "contract", 2, None),
        ("modes", "example-cells", 3, {"kind": "discriminant", "attribute": "labels.treatment", "repeats": 1}),
    ]:
        method = {"kind": "functional_pca", "components": components, "centre": True}
        body = {"name": name, "cohort": cohort, "transformation": "similarity", "method": method}
        post(address, "/v1/dictionaries", {**body, "classifier": classifier} if classifier else body, headers)
    example = openapi()["components"]["schemas"]["DictionaryFile"]["example"]
    for name in ["triangles", "doomed"]:
        post(address, f"/v1/dictionaries/import?name={name}", example, headers)
    post(address, "/v1/distances", {"cohort": "example-cells", "transformation": "similarity"}, headers)


def openapi():
    """The committed document, which a test of the suite compares with the served one."""
    return json.loads((ROOT / "openapi" / "openapi.json").read_text())


def examine(program, address, headers, seconds, examples, answers):
    """Runs the tester; whether all answers were right. Their counts go to the file `answers`."""
    command = [
        program,
        "--config-file",
        HERE / "schemathesis.toml",
        "run",
        f"{address}/openapi.json",
        f"--checks={','.join(CHECKS)}",
        f"--max-examples={examples}",
        f"--max-time={seconds}",
        f"--seed={SEED}",
        "--phases=examples,coverage,fuzzing,stateful",
        "--warnings=off",
        "--no-color",
        "--generation-database=none",
        "--suppress-health-check=all",
    ]
    command += [f"--header={name}: {value}" for name, value in headers.items()]
    if not headers:
        # The first key closes the service to those without one: after that there would be nothing to see.
        command.append("--exclude-operation-id=create_key")
    environment = {**os.environ, "SCHEMATHESIS_HOOKS": "hooks", "PYTHONPATH": str(HERE), "CONTRACT_ANSWERS": answers}
    environment["CONTRACT_OPEN"] = "" if headers else "1"
    # The secret form of the key `key_{id}` is `shk_{id}_{secret}`.
    environment["CONTRACT_KEY"] = "key_" + headers["authorization"].split("_")[1] if headers else ""
    return subprocess.run(command, cwd=TARGET, env=environment).returncode == 0


def summary(role, seconds, answers):
    """What was answered, and by which operations never with success."""
    counts = json.loads(pathlib.Path(answers).read_text())
    total = {}
    for statuses in counts.values():
        for status, count in statuses.items():
            total[status] = total.get(status, 0) + count
    operations = [f"{method.upper()} {path}" for path, item in openapi()["paths"].items() for method in item]
    never = [name for name in operations if not any(status < "4" for status in counts.get(name, {}))]
    print(f"contract: role {role}, {seconds:.0f} s, answers by status {dict(sorted(total.items()))}")
    print(f"contract: of {len(operations)} operations never with success: {', '.join(sorted(never)) or 'none'}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("profile", choices=PROFILES, nargs="?", default="short")
    parser.add_argument("--seconds", type=int, help="instead of those of the profile")
    parser.add_argument("--role", choices=ROLES, help="only this one")
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    arguments = parser.parse_args()
    seconds, examples = PROFILES[arguments.profile]
    seconds = arguments.seconds or seconds
    program = tester()
    if program is None:
        return
    shapelex, failed = arguments.program.resolve(), []
    as_whom = [arguments.role] if arguments.role else roles(shapelex)
    for role in as_whom:
        begin = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            # A store with keys gets no example cohort: it is loaded before.
            with service(shapelex, folder):
                pass
            headers = authorization(shapelex, folder, role)
            by_writer = headers and authorization(shapelex, folder, "writer")
            with service(shapelex, folder) as address:
                furnish(address, by_writer)
                answers = f"{folder}/answers.json"
                if not examine(program, address, headers, seconds // len(as_whom), examples, answers):
                    failed.append(role)
                summary(role, time.monotonic() - begin, answers)
    print(f"contract: {len(as_whom) - len(failed)} passed, {len(failed)} failed", flush=True)
    if failed:
        sys.exit(f"the contract is broken for {', '.join(failed)}")


if __name__ == "__main__":
    main()
