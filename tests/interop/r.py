"""Tables of a running service, read by R without a package of ours: `read.csv` of an address.

R is no package of Python: without `Rscript` (Debian: r-base-core) one line says that nothing was compared. R reads
decimals in extended precision and rounds once more, so its doubles may differ in the last bit from those that were
written.
"""

import csv
import io
import json
import math
import shutil
import subprocess
import urllib.request

PACKAGES = []

# Each table as its names, then its columns, as lines of fields between tabs. Integers become exact doubles.
SCRIPT = """
for (address in commandArgs(trailingOnly = TRUE)) {
  table <- read.csv(address, check.names = FALSE, colClasses = NA, stringsAsFactors = FALSE)
  cat("table", nrow(table), ncol(table), sep = "\\t"); cat("\\n")
  cat(names(table), sep = "\\t"); cat("\\n")
  for (column in table) {
    values <- if (is.numeric(column)) sprintf("%.17g", as.numeric(column)) else as.character(column)
    cat(class(column), values, sep = "\\t"); cat("\\n")
  }
}
"""

ULP = 2.0**-52


def service(program, folder):
    """A service on a store of its own, with the example cohort; the process and its address."""
    command = [str(program), "serve", "--listen", "127.0.0.1:0", "--data-dir", str(folder / "store"), "--log", "error"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    line = process.stdout.readline()
    if "://" not in line:
        process.kill()
        raise RuntimeError(f"the service does not start: {line!r}")
    return process, "http://" + line.split("://")[1].strip()


def fetched(address):
    with urllib.request.urlopen(address, timeout=60) as answer:
        return answer.read().decode()


def learnt(base, cohort):
    """The name of a dictionary of the cohort."""
    body = {
        "name": "modes",
        "cohort": cohort,
        "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 3},
    }
    headers = {"content-type": "application/json", "prefer": "wait=50"}
    request = urllib.request.Request(f"{base}/v1/dictionaries", json.dumps(body).encode(), headers)
    with urllib.request.urlopen(request, timeout=120) as answer:
        if answer.status != 201:
            raise RuntimeError(f"the dictionary is not learnt in time: {answer.status}")
    return body["name"]


def in_r(addresses):
    """What R makes of some tables: names and typed columns of each."""
    done = subprocess.run(
        ["Rscript", "--vanilla", "-e", SCRIPT, *addresses], capture_output=True, text=True, timeout=300
    )
    if done.returncode != 0:
        raise RuntimeError(f"R ended with {done.returncode}: {done.stderr[-500:]}")
    lines = iter(done.stdout.splitlines())
    for line in lines:
        columns = int(line.split("\t")[2])
        names = next(lines).split("\t")
        yield names, [next(lines).split("\t") for _ in range(columns)]


def same_value(kind, ours, theirs):
    """A field as it was sent, and as R has it."""
    if ours in ("", "NA"):
        return theirs == "NA" or (kind == "character" and theirs == ours)
    if kind in ("numeric", "integer"):
        return math.isclose(float(ours), float(theirs), rel_tol=2 * ULP, abs_tol=0.0)
    return ours.lower() == theirs.lower()


def differences(sent, names, columns):
    """Fields that R has otherwise; more than none is wrong."""
    rows = list(csv.reader(io.StringIO(sent)))
    if rows[0] != names:
        return [f"names {names[:3]}, expected {rows[0][:3]}"]
    found = []
    for name, (kind, *values), column in zip(names, columns, zip(*rows[1:])):
        wrong = [(a, b) for a, b in zip(column, values, strict=True) if not same_value(kind, a, b)]
        found += [f"{name}: {a!r} is {b!r} ({kind})" for a, b in wrong]
    return found


def check(convert, data, folder):
    if not shutil.which("Rscript"):
        yield "tables", True, "SKIPPED: there is no Rscript (Debian: r-base-core)"
        return
    process, base = service(convert.program, folder)
    try:
        cohort = json.loads(fetched(f"{base}/v1/cohorts"))["items"][0]["name"]
        dictionary = learnt(base, cohort)
        paths = {
            "a table of attributes and measures": f"/v1/cohorts/{cohort}/table?format=csv",
            "a table with scores": f"/v1/cohorts/{cohort}/table?format=csv"
            f"&columns=external_id,labels.treatment,measures.area,{dictionary}.score.1",
            "shapes, a row each": f"/v1/cohorts/{cohort}/export?format=csv",
            "a mean": f"/v1/cohorts/{cohort}/mean?transformation=similarity&format=csv",
            "components": f"/v1/dictionaries/{dictionary}/atoms?format=csv",
        }
        sent = {name: fetched(base + path) for name, path in paths.items()}
        tables = in_r([base + path for path in paths.values()])
        for (name, text), (names, columns) in zip(sent.items(), tables, strict=True):
            wrong = differences(text, names, columns)
            rows = len(columns[0]) - 1
            yield f"{name}, read by R", not wrong and rows > 0, f"{rows} rows, {len(names)} columns, wrong {wrong[:3]}"
    finally:
        process.terminate()
        process.wait(60)
