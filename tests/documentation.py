#!/usr/bin/env python3
"""Runs the snippets of tutorials and recipes in every language that is there, and builds the site strictly.

    tests/documentation.py [--program target/debug/shapelex] [PAGE...]

The snippets of one language of a page are one program, in their order, with a fresh service that holds the example
cohort; a page that starts a service itself gets a free port. A tutorial runs in a copy of examples/cells. Recipes run
in a copy of docs/recipes, one page after the other in the order of their list on one service, so that the last pages
find the dictionaries of the first ones; each step of them is there in all languages. An answer of 400 and above is a
failure unless the snippet expects it. TypeScript is compiled before it runs, so that a fault of its types is one too.
A language that is not there is skipped with a line. Snippets in Rust are doc tests of crates/shapelex; the test of
JUnit that docs/clients.md shows runs with the packages of Debian.
"""

import argparse
import contextlib
import dataclasses
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

import environment  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
WORK = TARGET / "documentation"
CLIENT = ROOT / "clients" / "python"
TUTORIALS = ROOT / "docs" / "tutorials"
RECIPES = ROOT / "docs" / "recipes"
CLIENTS = ROOT / "docs" / "clients.md"
CELLS = ROOT / "examples" / "cells"
DASHBOARD = ROOT / "dashboard"
# Where the snippets find the service.
WRITTEN = "127.0.0.1:8080"
# Seconds for the snippets of a page in one language, on a busy machine with a service that is built for tests.
PATIENCE = 600
# The line that a program prints when a snippet has run.
DONE = "documentation: ran"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# How a language says that a snippet has run, and what comes before the first one.
SAYING = {
    "sh": "printf '\\n%s\\n' '{}'",
    "python": "print('\\n{}', flush=True)",
    "typescript": "console.log('\\n{}');",
    "r": "cat('\\n{}\\n')",
}
BEGIN = {
    # `-f` as a default of this run, but where the status is asked for.
    "sh": 'set -euo pipefail\ncurl() { case "$*" in *http_code*) command curl -q -sS "$@";; '
    '*) command curl -q -sSf "$@";; esac; }\n',
    "python": "import matplotlib\nmatplotlib.use('agg')\n",
    "typescript": "",
    "r": "options(warn = 1)\npdf(NULL)\n",
}
NAMES = {"sh": "sh", "python": "py", "typescript": "mts", "r": "R"}
CLASS = re.compile(r"^class (\w+)", re.MULTILINE)
# Where Debian has the jars of Java, and those that run tests of JUnit 5.
JARS = pathlib.Path("/usr/share/java")
JUNIT = [
    *("junit-jupiter-api", "junit-jupiter-engine", "junit-platform-commons", "junit-platform-console"),
    *("junit-platform-engine", "junit-platform-launcher", "junit-platform-reporting"),
    *("opentest4j", "opentest4j-reporting-events", "apiguardian-api", "picocli"),
]
# Compiles a class of tests and runs it: `$0` are the jars, `$1` is the class, `$2` its file.
JAVA = """javac -Xlint:all,-path -Werror -cp "$0" -d classes "$2" && exec java -cp "classes:$0" \
    org.junit.platform.console.ConsoleLauncher --disable-banner --disable-ansi-colors --select-class "$1\""""
# Compiles programs beside themselves: `$0` is the compiler with its options, `$1` the folder of packages.
TYPESCRIPT = 'ln -s "$1" "${2%/*}/node_modules" && exec $0 "${@:2}"'


def snippets(page):
    """The snippets of a page by language, each with its line."""
    text, found = page.read_text(encoding="utf-8"), {}
    for fence in FENCE.finditer(text):
        found.setdefault(fence.group(1), []).append((text.count("\n", 0, fence.start()) + 1, fence.group(2)))
    return found


def recipes():
    """The recipes in the order of their list."""
    listed = (RECIPES / "README.md").read_text(encoding="utf-8")
    return [RECIPES / name for name in re.findall(r"^\d+\. \[[^\]]+\]\(([\w-]+\.md)\)", listed, re.MULTILINE)]


def series(named):
    """Pages that share a service and a folder, in their order: each tutorial alone, the recipes up to the last one."""
    listed = recipes()
    last = max((listed.index(page) for page in named if page in listed), default=-1)
    return [[page] for page in named if page not in listed] + ([listed[: last + 1]] if last >= 0 else [])


def incomplete(page):
    """Faults of a recipe whose steps are not there in all languages."""
    found = [found for fence in FENCE.finditer(page.read_text(encoding="utf-8")) if (found := fence.group(1)) in SAYING]
    whole = found == [*SAYING] * (len(found) // len(SAYING))
    return [] if whole else [f"{page.relative_to(ROOT)}: expected {', '.join(SAYING)} for each step, got {found}"]


def program_of(language, blocks):
    """The snippets as one program on the lines that they have in the page, which says how far it came."""
    text = BEGIN[language]
    for line, block in blocks:
        text += "\n" * (line - text.count("\n")) + f"{block}{SAYING[language].format(f'{DONE} {line}')}\n"
    return text


def python_with_client():
    """Python of the environment of the client, as its tests make it."""
    sys.path.insert(0, str(HERE / "clients"))
    import python as client_tests

    return client_tests.installed(TARGET / "clients" / "package")


def r_with_package():
    """The variables with which R finds its package, which is installed anew; R itself comes from Debian."""
    if not shutil.which("Rscript"):
        environment.debian("--no-install-recommends", "r-base-core", "r-cran-curl", "r-cran-jsonlite")
    library = WORK / "r"
    shutil.rmtree(library, ignore_errors=True)
    library.mkdir(parents=True)
    try:
        environment.run(["R", "CMD", "INSTALL", "--no-docs", f"--library={library}", str(ROOT / "clients" / "r")])
    except environment.Unavailable as reason:
        raise environment.Unavailable(f"the package cannot be installed: {reason}") from reason
    return {"R_LIBS": str(library)}


def node_with_package():
    """The command that compiles files for Node, beside the client as npm installs it."""
    if not shutil.which("node"):
        raise environment.Unavailable("there is no node")
    said = subprocess.run([DASHBOARD / "run.sh", "install"], stdout=subprocess.PIPE, text=True).stdout
    if said.startswith("SKIPPED"):
        raise environment.Unavailable(said.strip().partition(", ")[2])
    tsc, client, packages = DASHBOARD / "node_modules" / ".bin" / "tsc", ROOT / "clients" / "typescript", WORK / "node"
    shutil.rmtree(packages, ignore_errors=True)
    subprocess.run([tsc, "--project", client, "--outDir", packages / "shapelex" / "dist"], check=True)
    for name in ["package.json", "schema.d.ts"]:
        shutil.copy(client / name, packages / "shapelex")
    (packages / "@types").symlink_to(DASHBOARD / "node_modules" / "@types")
    options = "--strict --noUncheckedIndexedAccess --target es2022 --module nodenext --types node"
    return ["bash", "-c", TYPESCRIPT, f"{tsc} {options}", str(packages)]


@dataclasses.dataclass
class Runner:
    """How programs of a language run: by a command with variables, where they are compiled to files that end so."""

    command: list[str]
    variables: dict[str, str] = dataclasses.field(default_factory=dict)
    compiler: list[str] | None = None
    compiled: str | None = None


def languages():
    """Runners of the languages; those that are not there say so."""
    found = {"sh": Runner(["bash"])}
    if not shutil.which("curl"):
        print("SKIPPED: snippets for the shell, there is no curl")
        found = {}
    try:
        found["python"] = Runner([str(python_with_client())], {"PYTHONDONTWRITEBYTECODE": "1"})
    except environment.Unavailable as reason:
        print(f"SKIPPED: snippets in Python, the client cannot be installed: {reason}")
    try:
        found["typescript"] = Runner(["node"], compiler=node_with_package(), compiled=".mjs")
    except environment.Unavailable as reason:
        print(f"SKIPPED: snippets in TypeScript, {reason}")
    try:
        found["r"] = Runner(["Rscript"], r_with_package())
    except environment.Unavailable as reason:
        print(f"SKIPPED: snippets in R, there is no R with curl and jsonlite: {reason}")
    return found


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@contextlib.contextmanager
def service(program, folder):
    """Address of a new service with the example cohort, ended afterwards."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SHAPELEX")}
    command = [program, "serve", "--listen=127.0.0.1:0", f"--data-dir={folder / 'data'}", "--log=warn"]
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, env=kept, text=True)
    try:
        found = re.search(r" on http://(\S+)", process.stdout.readline())
        if not found:
            raise SystemExit(f"{program} does not start: {(folder / 'log').read_text()[-2000:]}")
        yield found.group(1)
    finally:
        process.terminate()
        process.wait(60)
        process.stdout.close()


def ran(command, variables, files, folder):
    """Status and output of a program, whose whole group of processes is ended."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("SHAPELEX")}
    process = subprocess.Popen(
        [*command, *map(str, files)],
        cwd=folder,
        env={**kept, **variables},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        output, _ = process.communicate()
        return 1, f"{output}\nit took more than {PATIENCE} s"
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, output


@contextlib.contextmanager
def prepared(program, pages, language):
    """The folder of a new service, the one in which the snippets of pages run, and the address of the service."""
    own = any("shapelex serve" in block for page in pages for _, block in snippets(page)[language])
    with tempfile.TemporaryDirectory(prefix="shapelex-documentation-") as name, contextlib.ExitStack() as stack:
        folder = pathlib.Path(name)
        place = folder / "work"
        if own:
            place.mkdir()
        else:
            shutil.copytree(RECIPES if pages[0].parent == RECIPES else CELLS, place)
        # The program has the name that a reader types.
        (folder / "bin").mkdir()
        (folder / "bin" / "shapelex").symlink_to(program)
        yield folder, place, f"127.0.0.1:{free_port()}" if own else stack.enter_context(service(program, folder))


def tried(program, pages, language, runner):
    """Number of snippets of a series that ran, and what failed."""
    passed, faults = 0, []
    pages = [page for page in pages if language in snippets(page)]
    if not pages:
        return passed, faults
    with prepared(program, pages, language) as (folder, place, address):
        variables = {"PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}", **runner.variables}
        scripts = [folder / f"{page.stem}.{NAMES[language]}" for page in pages]
        for page, script in zip(pages, scripts):
            text = program_of(language, snippets(page)[language]).replace(WRITTEN, address)
            script.write_text(text, encoding="utf-8")
        if runner.compiler:
            status, output = ran(runner.compiler, variables, scripts, place)
            faults += [f"{language}: faults of types, by the lines of the pages\n{output[-4000:]}"] if status else []
        for page, script in zip(pages, scripts):
            blocks = snippets(page)[language]
            file = script.with_suffix(runner.compiled or script.suffix)
            status, output = ran(runner.command, variables, [file], place)
            done = len(re.findall(rf"^{DONE} \d+$", output, re.MULTILINE))
            passed += done
            if status != 0 or done != len(blocks):
                line = blocks[min(done, len(blocks) - 1)][0]
                faults.append(f"{page.relative_to(ROOT)}:{line}: {language} ended with {status}\n{output[-4000:]}")
    return passed, faults


def java_with_junit():
    """Jars of JUnit and what it needs, of Debian, which are installed where the rights are there."""
    jars = [JARS / f"{name}.jar" for name in JUNIT]
    if not (shutil.which("javac") and all(jar.exists() for jar in jars)):
        environment.debian("--no-install-recommends", "default-jdk-headless", "junit5")
    missing = [str(jar) for jar in jars if not jar.exists()]
    if missing or not shutil.which("javac"):
        raise environment.Unavailable(f"there is no {(missing or ['javac'])[0]}")
    return os.pathsep.join(map(str, jars))


def junit(program):
    """Number of tests of JUnit on the page of clients that ran, and what failed: each block is a file of one class."""
    try:
        jars = java_with_junit()
    except environment.Unavailable as reason:
        print(f"SKIPPED: the test of JUnit in docs/clients.md (Debian: default-jdk-headless, junit5): {reason}")
        return 0, []
    passed, faults = 0, []
    for line, block in snippets(CLIENTS)["java"]:
        with tempfile.TemporaryDirectory(prefix="shapelex-documentation-") as name:
            file = pathlib.Path(name) / f"{CLASS.search(block).group(1)}.java"
            file.write_text(block, encoding="utf-8")
            command = ["bash", "-c", JAVA, jars, file.stem]
            status, output = ran(command, {"SHAPELEX_BINARY": str(program)}, [file], name)
        done = re.search(r"(\d+) tests successful", output)
        if status == 0 and done and int(done.group(1)):
            passed += int(done.group(1))
        else:
            faults.append(f"docs/clients.md:{line}: JUnit ended with {status}\n{output[-4000:]}")
    return passed, faults


def site_is_whole():
    """What is wrong with the site; None where it cannot be built here."""
    done = subprocess.run([sys.executable, ROOT / "docs" / "site.py"], capture_output=True, text=True)
    said = f"{done.stdout}{done.stderr}".strip()
    print(said)
    return None if said.startswith("SKIPPED") else (said if done.returncode else "")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    parser.add_argument("pages", nargs="*", type=pathlib.Path)
    arguments = parser.parse_args()
    program, begin, passed, faults = arguments.program.resolve(), time.monotonic(), 0, []
    whole = site_is_whole()
    passed += whole == ""
    faults += [whole] if whole else []
    pages = [page.resolve() for page in arguments.pages] or [*sorted(TUTORIALS.glob("*.md")), *recipes()]
    faults += [fault for page in pages if page.parent == RECIPES for fault in incomplete(page)]
    if program.exists():
        for language, runner in languages().items():
            begun, counted = time.monotonic(), 0
            for together in series(pages):
                done, found = tried(program, together, language, runner)
                counted += done
                faults += found
            passed += counted
            print(f"{counted} snippets in {language}, {time.monotonic() - begun:.0f} s")
        if not arguments.pages or CLIENTS in pages:
            done, found = junit(program)
            passed += done
            faults += found
    else:
        print("SKIPPED: the snippets of tutorials and recipes, the program is not built")
    for fault in faults:
        print(f"FAIL: {fault}")
    print(f"documentation: {time.monotonic() - begin:.0f} s")
    print(f"documentation: {passed} passed, {len(faults)} failed")
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
