#!/usr/bin/env python3
"""Generates clients from the OpenAPI document, checks their types and calls the service with them.

    tests/clients/run.py [--program target/debug/shapelex]

Python by openapi-python-client, TypeScript by openapi-typescript, both by openapi-generator too, and Java by it, which
is compiled. The document must be valid, and no operation may be missing from a client. Where Python packages, npm, Java
or its libraries cannot be had, the part that needs them is skipped with a line that says so.
"""

import argparse
import importlib.util
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE.parent))

import environment  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
DOCUMENT = ROOT / "openapi" / "openapi.json"

# What the generator for Python cannot do: it offers the other media type of the body. Lines count as text in its
# settings.
LINES = "Unsupported content type text/plain"
OF_DICTIONARIES = ["assess", "classify", "correspond", "encode", "prior", "reconstruct", "score"]
KNOWN_WARNINGS = {
    "POST /v1/cohorts/{cohort}/attributes": "Unsupported content type text/csv",
    "POST /v1/cohorts/{cohort}/shapes": LINES,
    **{f"POST /v1/{name}": LINES for name in ["fit", "measure", "prior", "project"]},
    **{f"POST /v1/dictionaries/{{dictionary}}/{name}": LINES for name in OF_DICTIONARIES},
}


def contract():
    """The contract test as a module: it knows how to start a service and to make keys."""
    specification = importlib.util.spec_from_file_location("contract", HERE.parent / "contract" / "run.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def run(command, **options):
    """Runs a command whose output is shown only if it fails."""
    options = {"cwd": HERE, "timeout": 300, **options}
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options)
    if done.returncode != 0:
        sys.exit(f"{' '.join(str(part) for part in command)}\n{done.stdout}")
    return done.stdout


def installed(folder, wanted, install):
    """Whether `folder` has what the files `wanted` list, after it was installed if need be."""
    text = "".join((HERE / name).read_text() for name in wanted)
    mark = folder / "installed.txt"
    if mark.exists() and mark.read_text() == text:
        return True
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        install(folder)
    except (OSError, subprocess.SubprocessError, environment.Unavailable) as error:
        print(f"SKIPPED: a generated client, the packages of {wanted[0]} cannot be installed: {error}")
        return False
    mark.write_text(text)
    return True


def install_python(folder):
    """An environment with the packages for Python."""
    environment.created(folder, ["-r", HERE / "requirements.txt"])


def install_npm(folder):
    """A folder with the packages for TypeScript."""
    for name in ["package.json", "package-lock.json", "tsconfig.json"]:
        shutil.copy(HERE / name, folder)
    npm = ["npm", "ci", "--no-audit", "--no-fund", "--loglevel=error"]
    subprocess.run(npm, cwd=folder, check=True, timeout=300, stdout=subprocess.DEVNULL)


def operations():
    """Operation ids of the document."""
    paths = json.loads(DOCUMENT.read_text())["paths"]
    return {operation["operationId"] for item in paths.values() for operation in item.values()}


def generate_python(folder):
    """The Python client, beside its calls: all operations, each with the type of its answer."""
    programs, client = folder / "bin", folder / "client"
    shutil.rmtree(client, ignore_errors=True)
    command = [programs / "openapi-python-client", "generate", "--path", DOCUMENT, "--meta", "none"]
    told = run([*command, "--config", HERE / "python-client.yaml", "--output-path", client / "shapelex_client"])
    for part in told.split("WARNING parsing ")[1:]:
        known = [text for name, text in KNOWN_WARNINGS.items() if part.startswith(f"{name} ")]
        if not (known and known[0] in part):
            sys.exit(f"the generator for Python leaves something out: {part}")
    modules = [file for file in (client / "shapelex_client" / "api").rglob("*.py") if file.name != "__init__.py"]
    missing = operations() - {file.stem for file in modules}
    if missing:
        sys.exit(f"operations without a function in Python: {sorted(missing)}")
    shutil.copy(HERE / "calls.py", client)
    run([programs / "mypy", "--config-file", HERE / "mypy.ini", "calls.py", "shapelex_client"], cwd=client)
    return [programs / "python", client / "calls.py"]


def generate_typescript(folder):
    """The TypeScript client, beside its calls, compiled: all operations."""
    # TypeScript resolves what a file imports from where it lies.
    for name in ["calls.ts", "tsconfig.json"]:
        shutil.copy(HERE / name, folder)
    types = folder / "shapelex.d.ts"
    run([folder / "node_modules" / ".bin" / "openapi-typescript", DOCUMENT, "--output", types], cwd=folder)
    text = types.read_text()
    missing = {name for name in operations() if f'operations["{name}"]' not in text}
    if missing:
        sys.exit(f"operations that are missing in TypeScript: {sorted(missing)}")
    run([folder / "node_modules" / ".bin" / "tsc", "--project", "tsconfig.json"], cwd=folder)
    return ["node", folder / "built" / "calls.js"]


def has_java():
    """Whether there is Java, after it was installed where the rights are there."""
    if shutil.which("java"):
        return True
    if os.geteuid() == 0 and shutil.which("apt-get"):
        try:
            environment.debian("--no-install-recommends", "default-jre-headless")
        except environment.Unavailable as error:
            print(f"SKIPPED: the three clients of openapi-generator, Java cannot be installed: {error}")
            return False
    if shutil.which("java"):
        return True
    print("SKIPPED: the three clients of openapi-generator, there is no java (Debian: default-jre-headless)")
    return False


def install_openapi(folder):
    """An environment with openapi-generator and what its Python client needs."""
    environment.created(folder, ["-r", HERE / "openapi-requirements.txt"])


def generated(folder, language, output, *settings):
    """The client of a language by openapi-generator."""
    shutil.rmtree(output, ignore_errors=True)
    command = [
        folder / "bin" / "openapi-generator-cli",
        "generate",
        "-g",
        language,
        "-i",
        DOCUMENT,
        "-o",
        output,
        *settings,
    ]
    told = run(command, timeout=600)
    faults = [line for line in told.splitlines() if " ERROR " in line]
    if faults:
        sys.exit(f"openapi-generator for {language}: {faults}")


def missing_from(text, name):
    """Ends where operations are missing in the source of a client, in which `name` makes the names of functions."""
    missing = {operation for operation in operations() if not re.search(rf"\b{name(operation)}\(", text)}
    if missing:
        sys.exit(f"operations that openapi-generator leaves out: {sorted(missing)}")


def camel(name):
    """`find_cohort` as `findCohort`."""
    first, *rest = name.split("_")
    return first + "".join(word.capitalize() for word in rest)


def openapi_python(folder):
    """The Python client of openapi-generator, beside its calls."""
    client = folder / "client"
    generated(folder, "python", client, "--additional-properties", "packageName=shapelex_openapi")
    missing_from("".join(file.read_text() for file in (client / "shapelex_openapi" / "api").glob("*.py")), str)
    shutil.copy(HERE / "openapi_calls.py", client)
    return [folder / "bin" / "python", client / "openapi_calls.py"]


def openapi_typescript(folder, npm):
    """The TypeScript client of openapi-generator, beside its calls in the folder of the packages, compiled."""
    client = npm / "openapi"
    generated(
        folder,
        "typescript-axios",
        client,
        "--additional-properties",
        "useSingleRequestParameter=true,importFileExtension=.js",
    )
    missing_from((client / "api.ts").read_text(), camel)
    shutil.copy(HERE / "openapi_calls.ts", npm)
    shutil.copy(HERE / "openapi-tsconfig.json", npm)
    run([npm / "node_modules" / ".bin" / "tsc", "--project", "openapi-tsconfig.json"], cwd=npm, timeout=600)
    return ["node", npm / "built" / "openapi_calls.js"]


def compile_java(folder):
    """Compiles the Java client of openapi-generator; returns how many clients that are."""
    if not (shutil.which("mvn") and shutil.which("javac")):
        print(
            "SKIPPED: the Java client of openapi-generator, there is no mvn or no javac (Debian: maven, "
            "default-jdk-headless)"
        )
        return 0
    client = folder / "java"
    generated(folder, "java", client, "--library", "native", "--additional-properties", "hideGenerationTimestamp=true")
    sources = "".join(file.read_text() for file in client.rglob("api/*.java"))
    missing_from(sources, camel)
    mvn = ["mvn", "--batch-mode", "--quiet", "-Dstyle.color=never", "-Dmaven.test.skip=true"]
    try:
        libraries = subprocess.run(
            [*mvn, "dependency:resolve", "dependency:resolve-plugins"],
            cwd=client,
            capture_output=True,
            text=True,
            timeout=600,
        )
        told = re.findall(r"\[ERROR\] (.{1,150})", libraries.stdout + libraries.stderr)
        reason = (told or ["it says nothing"])[0] if libraries.returncode else None
    except subprocess.SubprocessError as error:
        reason = str(error)
    if reason:
        print(f"SKIPPED: the Java client of openapi-generator, its libraries cannot be had: {reason}")
        return 0
    run([*mvn, "compile"], cwd=client, timeout=600)
    return 1


def of_openapi_generator(npm):
    """Commands of the clients of openapi-generator, and how many others were compiled."""
    if not has_java():
        return [], 0
    folder = TARGET / "clients" / "openapi"
    if not installed(folder, ["openapi-requirements.txt"], install_openapi):
        return [], 0
    commands = [openapi_python(folder)]
    if npm:
        commands.append(openapi_typescript(folder, npm))
    else:
        print("SKIPPED: the TypeScript client of openapi-generator, there are no packages of npm")
    return commands, compile_java(folder)


def clients():
    """Commands that make the calls, of all clients that can be generated here, and how many others were compiled."""
    commands, npm, folder = [], None, TARGET / "clients" / "python"
    if installed(folder, ["requirements.txt"], install_python):
        run([folder / "bin" / "openapi-spec-validator", DOCUMENT])
        commands.append(generate_python(folder))
    if not (shutil.which("node") and shutil.which("npm")):
        print("SKIPPED: the generated TypeScript client, there is no node or no npm")
    else:
        folder = TARGET / "clients" / "typescript"
        if installed(folder, ["package.json", "package-lock.json"], install_npm):
            npm = folder
            commands.append(generate_typescript(folder))
    others, compiled = of_openapi_generator(npm)
    return commands + others, compiled


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    shapelex, begin = parser.parse_args().program.resolve(), time.monotonic()
    commands, compiled = clients()
    if not commands:
        return
    common = contract()
    with tempfile.TemporaryDirectory() as folder:
        key = common.authorization(shapelex, folder, "writer")["authorization"].split()[1]
        with common.service(shapelex, folder) as address:
            for command in commands:
                print(run([*command, address, key]).strip())
    print(f"clients: {time.monotonic() - begin:.0f} s")
    print(f"clients: {len(commands) + compiled} passed, 0 failed")


if __name__ == "__main__":
    main()
