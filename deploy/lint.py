"""Checks everything that installs the service or watches it: container, compose, Kubernetes, Helm, systemd, shell,
monitoring, and what the program is built from.

    python3 deploy/lint.py [CHECK ...]

Prints one line a check: ok, FAILED with the reasons, or skipped with the reason; ends with 1 when one failed. The tools
are those of deploy/requirements.txt, installed into target/lint; a tool that cannot be had skips its checks, visibly.
Beside the rules of the tools this looks for what a schema does not know: that the settings, routes and commands that
the files name exist in the program, and that no container has rights that it does not need.
"""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from environment import Unavailable, created, debian  # noqa: E402

TOOLS = ROOT / "target" / "lint"
PYTHON = TOOLS / "bin" / "python"
REQUIREMENTS = ROOT / "deploy" / "requirements.txt"
DOCKERFILE = ROOT / "docker" / "Dockerfile"
ENGINE_DOCKERFILE = ROOT / "docker" / "Dockerfile.engine"
COMPOSES = {"shapelex": ROOT / "docker" / "compose.yaml", "executor": ROOT / "docker" / "compose.engine.yaml"}
MANIFESTS = [ROOT / "deploy" / "kubernetes", ROOT / "deploy" / "kubernetes-engine"]
CHART = ROOT / "deploy" / "helm" / "shapelex"
UNIT = ROOT / "deploy" / "systemd" / "shapelex.service"
MONITORING = ROOT / "deploy" / "monitoring"
OBSERVABILITY = ROOT / "docs" / "observability.md"
# Words of PromQL that are not names of metrics.
PROMQL = {"by", "without", "on", "ignoring", "group_left", "group_right", "and", "or", "unless", "bool", "offset"}
# Points of exposure of 100 that systemd may count: what is left is the network and files that can be read.
EXPOSURE = 15
# The oldest Kubernetes that the manifests are meant for, and the newest that the tool knows.
KUBERNETES = ("1.30.0", "1.37.0")
SYSTEM_PATH = "/usr/sbin:/usr/bin:/sbin:/bin"
YAML_RULES = """{extends: default, rules: {line-length: {max: 130}, document-start: disable,
  braces: {max-spaces-inside: 1}, comments: {min-spaces-from-content: 1}}}"""


class Skipped(Exception):
    """Why a check cannot be made here."""


class Failed(Exception):
    """What a check found."""


def run(*command, **options):
    """Output of a command that must succeed."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    try:
        done = subprocess.run(command, cwd=ROOT, text=True, **options)
    except FileNotFoundError:
        raise Skipped(f"no {command[0]} here") from None
    if done.returncode != 0:
        raise Failed((done.stdout + (done.stderr or "")).strip() or f"{command[0]} ended with {done.returncode}")
    return done.stdout


def install():
    """The tools, once for every state of the list of requirements."""
    wanted, mark = REQUIREMENTS.read_text(), TOOLS / "installed.txt"
    if mark.exists() and mark.read_text() == wanted:
        return
    created(TOOLS, ["-r", REQUIREMENTS], ["--no-deps", "--only-binary=:all:"])
    mark.write_text(wanted)


def tool(name):
    """Path of a tool: that of the requirements, else one of the machine."""
    path = shutil.which(name, path=TOOLS / "bin") or shutil.which(name)
    if not path:
        raise Skipped(f"no {name} here")
    return path


def documents(text):
    """The YAML documents of a text."""
    try:
        import yaml
    except ImportError:
        raise Skipped("no YAML reader here") from None
    return [document for document in yaml.safe_load_all(text) if document]


def manifests(folder):
    """What is applied to a cluster, as text."""
    return run(tool("kubectl"), "kustomize", folder)


def refuse(found):
    """Fails with everything that was found."""
    if found:
        raise Failed("\n".join(found))


def check_yaml():
    run(
        tool("yamllint"),
        "--strict",
        "-d",
        YAML_RULES,
        *COMPOSES.values(),
        *MANIFESTS,
        MONITORING,
        *CHART.glob("*.yaml"),
        CHART / "ci",
    )


def check_dockerfile():
    found = []
    for path in (DOCKERFILE, ENGINE_DOCKERFILE):
        run(tool("hadolint"), "--failure-threshold", "style", path)
        last = path.read_text().rsplit("\nFROM ", 1)[1]
        wanted = ("USER 65532:65532", "HEALTHCHECK", "COPY --from=sbom ")
        found += [f"{path.name}: the last stage has no {line}" for line in wanted if f"\n{line}" not in last]
    refuse(found)


def check_shell():
    run(tool("shellcheck"), "--severity=warning", ".ci/run", *sorted(ROOT.glob("*/*.sh")))


def check_image():
    """The root folder of the image, read-only and without rights: the program starts, is healthy, and stops in order.

    Without an engine for containers this is as near to running the image as it gets: the same files, user and
    variables.
    """
    programs = [ROOT / "target" / profile / "shapelex" for profile in ("release", "debug")]
    programs = sorted((path for path in programs if path.exists()), key=lambda path: path.stat().st_mtime)
    if not programs:
        raise Skipped("the program is not built yet")
    if os.geteuid() != 0 or not shutil.which("unshare") or not shutil.which("dpkg"):
        raise Skipped("needs root, unshare and dpkg")
    text = DOCKERFILE.read_text()
    settings = dict(re.findall(r"(SHAPELEX_\w+)=(\S+)", text.rsplit("\nENV ", 1)[1]))
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    # On a loopback address no key is needed.
    settings |= {"SHAPELEX_LISTEN": f"127.0.0.1:{port}", "PATH": SYSTEM_PATH}
    health = [
        word.replace(":8080", f":{port}")
        for word in json.loads(re.search(r"HEALTHCHECK.*?CMD (\[.*?\])", text, re.S).group(1))
    ]
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "root"
        run("sh", "docker/image_root.sh", programs[-1], root)
        inside = f"chroot --userspec=65532:65532 {root}"
        start = f"""mount --bind {root} {root}; mount -o remount,bind,ro {root}
            mount -t tmpfs -o mode=0700,uid=65532,gid=65532 data {root}/data
            mount -t tmpfs -o mode=1777 scratch {root}/tmp
            exec {inside} /usr/local/bin/shapelex serve"""
        log = Path(folder) / "log"
        with log.open("w") as file:
            service = subprocess.Popen(
                ["unshare", "--mount", "sh", "-ec", start], env=settings, stdout=file, stderr=file
            )
        end, outcome = time.monotonic() + 30, None
        try:
            while service.poll() is None and time.monotonic() < end and (outcome is None or outcome.returncode != 0):
                time.sleep(0.2)
                outcome = subprocess.run(
                    [*inside.split(), *health], env={"PATH": SYSTEM_PATH}, capture_output=True, text=True
                )
        finally:
            service.terminate()
        if service.wait(30) != 0 or outcome is None or outcome.returncode != 0:
            raise Failed(
                f"it ended with {service.returncode}; its health: {outcome}; its log: {log.read_text()[-1000:]}"
            )


def check_compose():
    found = []
    for replicated, path in COMPOSES.items():
        run(tool("check-jsonschema"), "--builtin-schema", "vendor.compose-spec", path)
        services = documents(path.read_text())[0]["services"]
        if sum(name.startswith(replicated) for name in services) < 2:
            found.append(f"{path.name}: fewer than two of {replicated}")
        for name, service in services.items():
            found += [f"{path.name}: {name}: {what}" for what in service_faults(name, service)]
    refuse(found)


def service_faults(name, service):
    """What a service of a compose file lacks."""
    found = [f"{port} is open to the world" for port in service.get("ports", []) if "127.0.0.1" not in port]
    if not re.search(r":.*\d", service["image"]):
        found.append("an image without a version")
    if not service["image"].startswith("shapelex"):
        return found
    wanted = {"read_only": True, "cap_drop": ["ALL"], "user": "65532:65532", "security_opt": ["no-new-privileges:true"]}
    found += [f"{key} is not {value}" for key, value in wanted.items() if service.get(key) != value]
    # 4096 connections, and 500 files for the rest: docs/limits.md.
    if name.startswith("shapelex") and service.get("ulimits", {}).get("nofile", 0) < 4096 + 500:
        found.append("too few files for its connections")
    return found


def check_kubernetes():
    refuse([f"{folder.name}: {what}" for folder in MANIFESTS for what in manifest_faults(folder)])


def manifest_faults(folder):
    """What the manifests of a folder lack."""
    text = manifests(folder)
    for version in KUBERNETES:
        run(tool("kubernetes-validate"), "--strict", "-k", version, "/dev/stdin", input=text)
    found, labels, selectors = [], [], []
    for document in documents(text):
        spec = document["spec"]
        if document["kind"] in ("Deployment", "StatefulSet"):
            labels.append(spec["template"]["metadata"]["labels"])
            found += pod_rights(spec["template"]["spec"])
        selector = spec.get("podSelector") or spec["selector"]
        selectors.append((document["kind"], selector.get("matchLabels", selector)))
    for kind, selector in selectors:
        if not any(selector.items() <= of_pods.items() for of_pods in labels):
            found.append(f"{kind}: selects no pod of the deployment")
    for path in sorted(folder.glob("*.yaml")):
        if path.name == "kustomization.yaml":
            continue
        run(tool("kubernetes-validate"), "--strict", path)
        for document in documents(path.read_text()):
            if document["kind"] == "Job":
                found += pod_rights(document["spec"]["template"]["spec"])
    return found


def pod_rights(pod):
    """What a pod may do without need, and what it lacks to be looked after."""
    found = [] if pod.get("automountServiceAccountToken") is False else ["the pods have a token of the cluster"]
    for key, value in {"runAsNonRoot": True, "seccompProfile": {"type": "RuntimeDefault"}}.items():
        if pod["securityContext"].get(key) != value:
            found.append(f"pods: {key} is not {value}")
    for container in pod["containers"]:
        context = container["securityContext"]
        wanted = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
        found += [
            f"{container['name']}: {key} is not {value}" for key, value in wanted.items() if context.get(key) != value
        ]
        lacks = [r for r in ("requests", "limits") if not {"cpu", "memory"} <= container["resources"][r].keys()]
        if pod.get("restartPolicy") != "Never":
            lacks += [p for p in ("startupProbe", "livenessProbe", "readinessProbe") if p not in container]
        found += [f"{container['name']}: no {what}" for what in lacks]
    return found


def chart_texts():
    """The templates of the chart by their names."""
    return {path.name: path.read_text() for path in sorted((CHART / "templates").iterdir())}


def check_chart():
    """What can be said of the chart without Helm: its version, and values that file, schema and templates agree on."""
    chart, values = (documents((CHART / name).read_text())[0] for name in ("Chart.yaml", "values.yaml"))
    schema = CHART / "values.schema.json"
    for name in ("values.yaml", "ci/everything-values.yaml"):
        run(tool("check-jsonschema"), "--schemafile", schema, CHART / name)
    version = re.search(r'(?m)^version = "(.*)"', (ROOT / "Cargo.toml").read_text()).group(1)
    found = [f"{key} is not {version}" for key in ("version", "appVersion") if chart[key] != version]
    used, texts = set(), "".join(chart_texts().values())
    for path in set(re.findall(r"\.Values((?:\.\w+)+)", texts)):
        used.add(path.split(".")[1])
        place, of_schema = values, json.loads(schema.read_text())
        for key in path.split(".")[1:]:
            if not isinstance(place, dict) or key not in place or key not in of_schema.get("properties", {}):
                found.append(f"a template uses {path}, and values.yaml or its schema has no {key}")
                break
            place, of_schema = place[key], of_schema["properties"][key]
    listed = set(re.findall(r'"(\w+)"', re.search(r"range \$key := list ([^}]*)", texts).group(1)))
    found += [f"no template uses {key}" for key in sorted(values.keys() - used - listed)]
    files = re.findall(r'"shapelex\.manifest" \(list \. "([^"]+)"\)|Files\.Get "([^"]+)"', texts)
    files = [CHART / (f"kubernetes/{manifest}" if manifest else other) for manifest, other in files]
    refuse(found + [f"a template reads {path.name}, which is missing" for path in files if not path.is_file()])


# Values that the schema must refuse, each with what the refusal names.
WRONG_VALUES = {
    "replica": {"replica": 3},
    "replicas": {"replicas": 0},
    "SHAPELEX_LISTEN": {"settings": {"SHAPELEX_LISTEN": "0.0.0.0:80"}},
    "SHAPELEX_TRASH_DAYS": {"settings": {"SHAPELEX_TRASH_DAYS": 7}},
    "cpu": {"resources": {"limits": {"cpu": "two"}}},
    "host": {"ingress": {"enabled": True}},
    "digest": {"image": {"digest": "latest"}},
}


def check_helm():
    """The chart by Helm: its lint, what it refuses, and what it renders beside the manifests that it is made from."""
    try:
        import helm_python
    except (ImportError, OSError):
        raise Skipped("no helm-python-sdk here, which has Helm for Linux on x86-64") from None
    report = helm_python.lint(str(CHART), strict=True)
    refuse([f"{one['path']}: {one['error']}" for one in report["messages"] if one["severity"] > 1])
    found = []
    with helm_python.Chart.load(str(CHART)) as chart:
        for name, values in WRONG_VALUES.items():
            try:
                chart.render(values, name="shapelex", namespace="shapelex")
            except helm_python.HelmError as refusal:
                found += [] if name in str(refusal) else [f"{values} is refused for another reason: {refusal}"]
            else:
                found.append(f"{values} is not refused")
        everything = documents((CHART / "ci" / "everything-values.yaml").read_text())[0]
        try:
            rendered = [chart.render(values, name="shapelex", namespace="shapelex") for values in (None, everything)]
        except helm_python.HelmError as error:
            raise Failed(str(error)) from None
    for texts in rendered:
        found += rendered_faults([one for name in texts if name.endswith(".yaml") for one in documents(texts[name])])
    for manifest in ("deployment.yaml", "service.yaml", "disruption-budget.yaml", "network-policy.yaml"):
        text = rendered[0][f"shapelex/templates/{manifest}"]
        wanted = (ROOT / "deploy" / "kubernetes" / manifest).read_text()
        if plain(documents(text)[0]["spec"]) != plain(documents(wanted)[0]["spec"]):
            found.append(f"{manifest}: by default it is not that of deploy/kubernetes")
    refuse(found)


def rendered_faults(rendered):
    """What rendered manifests lack; objects of operators have no schema here."""
    known = [one for one in rendered if "monitoring.coreos.com" not in one["apiVersion"]]
    text = "\n---\n".join(json.dumps(one) for one in known)
    for version in KUBERNETES:
        run(tool("kubernetes-validate"), "--strict", "-k", version, "/dev/stdin", input=text)
    pods = [(one["kind"], one["spec"]["template"]["spec"]) for one in known if one["kind"] in ("Deployment", "Job")]
    return [f"{kind}: {what}" for kind, pod in pods for what in pod_rights(pod)]


def plain(value):
    """A part of a manifest without what a release adds: its label, the tag of the image, defaults of Kubernetes."""
    if isinstance(value, list):
        return [plain(one) for one in value]
    if not isinstance(value, dict):
        return value
    added = {"app.kubernetes.io/instance": None, "imagePullPolicy": "IfNotPresent", "type": "ClusterIP"}
    kept = {key: plain(one) for key, one in value.items() if key not in added or added[key] not in (None, one)}
    if "image" in kept:
        kept["image"] = kept["image"].split(":")[0]
    return kept


def check_systemd():
    analyze = tool("systemd-analyze")
    with tempfile.TemporaryDirectory() as folder:
        # The check wants a program that exists.
        unit = Path(folder) / UNIT.name
        unit.write_text(re.sub(r"(?m)^ExecStart=\S+", "ExecStart=/bin/true", UNIT.read_text()))
        # What it does not understand it ignores, with a word about it.
        refuse(run(analyze, "verify", "--man=no", unit, stderr=subprocess.STDOUT).splitlines())
        try:
            run(analyze, "security", "--no-pager", "--offline=true", f"--threshold={EXPOSURE}", unit)
        except Failed as table:
            refuse([line for line in str(table).splitlines() if not line.startswith("✓")])


def promtool():
    """Path of promtool; of the package of Debian nothing else is unpacked, as its installation starts a server."""
    found = shutil.which("promtool", path=TOOLS / "debian" / "usr" / "bin") or shutil.which("promtool")
    if found:
        return found
    folder = TOOLS / "debian"
    (folder / "partial").mkdir(parents=True, exist_ok=True)
    try:
        options = ("--no-install-recommends", "--download-only", "-o", f"Dir::Cache::archives={folder}")
        debian(*options, "prometheus")
    except Unavailable as reason:
        raise Skipped(f"no promtool here, and {reason} (Debian: prometheus)") from None
    for package in folder.glob("prometheus_*.deb"):
        run("dpkg-deb", "-x", package, folder)
    return tool(str(folder / "usr" / "bin" / "promtool"))


def metrics_of(expression):
    """Names of metrics in an expression of PromQL, each with the labels that its matchers name."""
    bare = re.sub(r"\b(by|without|on|ignoring|group_left|group_right)\s*\([^)]*\)", " ", expression)
    bare = re.sub(r"\[[^\]]*\]", " ", bare)
    found = {}
    for name, matchers in re.findall(r"(?<![\w.])([a-zA-Z_:][\w:]*)\b(?!\s*\()\s*(\{(?:\"[^\"]*\"|[^}])*\})?", bare):
        if name not in PROMQL:
            found.setdefault(name, set()).update(re.findall(r"(\w+)\s*(?:=|!=|=~|!~)\s*\"", matchers))
    return found


def exported_metrics():
    """Labels of each metric that the documentation lists, those of a scrape included."""
    rows = re.findall(r"(?m)^\| `(shapelex_\w+)` \| (\w+) \| ([^|]*)\|", OBSERVABILITY.read_text())
    found = {}
    for name, kind, cell in rows:
        labels = {"job", "instance", *re.findall(r"`(\w+)`", cell)}
        for suffix in ("_bucket", "_sum", "_count") if kind == "histogram" else ("",):
            found[name + suffix] = labels | ({"le"} if suffix == "_bucket" else set())
    return found


def metric_faults(expression):
    """What an expression names that nobody exports."""
    exported, found = exported_metrics(), []
    text = OBSERVABILITY.read_text()
    for name, labels in metrics_of(expression).items():
        if name in exported:
            found += [f"{name} has no label {label}" for label in sorted(labels - exported[name])]
        elif name.startswith("shapelex_") or f"`{name}`" not in text:
            found.append(f"{OBSERVABILITY.name} has no metric {name}")
    return found


def check_metrics():
    """What the rules and the dashboard name is exported and documented, and every metric of the program is."""
    if not (rules := documents((MONITORING / "alerts.yaml").read_text())):
        raise Failed("alerts.yaml has no rules")
    rules = [rule for group in rules[0]["groups"] for rule in group["rules"]]
    tests, text = (MONITORING / "alerts_test.yaml").read_text(), OBSERVABILITY.read_text()
    said = dict(re.findall(r"(?m)^\| `(Shapelex\w+)` \| (\w+) \|", text))
    found = [f"{OBSERVABILITY.name}: no rule {name}" for name in said.keys() - {rule["alert"] for rule in rules}]
    for rule in rules:
        name = rule["alert"]
        if said.get(name) != rule["labels"]["severity"]:
            found.append(f"{OBSERVABILITY.name}: not the severity of {name}")
        found += [f"{name}: {what}" for what in metric_faults(rule["expr"])]
        found += [f"{name}: no {key}" for key in ("summary", "runbook") if not rule["annotations"].get(key)]
        if f'alertname="{name}"' not in tests:
            found.append(f"{name}: no test")
    for title, expression in dashboard_expressions():
        found += [f"dashboard: {title}: {what}" for what in metric_faults(expression)]
    files = [*(ROOT / "src").rglob("*.rs"), *(ROOT / "crates").glob("*/src/**/*.rs")]
    sources = "".join(path.read_text() for path in files if "shapelex-engine" not in path.parts)
    program = set(re.findall(r'"(shapelex_(?:http|jobs?|hooks?|store|compute|cache|audit|clock|build)_\w+)"', sources))
    listed = {re.sub("_(bucket|sum|count)$", "", name) for name in exported_metrics()}
    found += [f"{OBSERVABILITY.name}: {name} is missing" for name in sorted(program - listed)]
    found += [f"{OBSERVABILITY.name}: no metric {name} in the program" for name in sorted(listed - program)]
    refuse(found)


def dashboard_expressions():
    """Title of the panel and expression of each query of the dashboard."""
    panels = json.loads((MONITORING / "dashboard.json").read_text())["panels"]
    return [(panel["title"], target["expr"]) for panel in panels for target in panel.get("targets", [])]


def check_monitoring():
    """Rules, their tests and the queries of the dashboard, by promtool."""
    program = promtool()
    run(program, "check", "rules", MONITORING / "alerts.yaml")
    run(program, "test", "rules", MONITORING / "alerts_test.yaml")
    # The variables of Grafana stand for a range and for texts.
    queries = [expression.replace("$__rate_interval", "5m") for _, expression in dashboard_expressions()]
    rules = [{"record": f"query_{index}", "expr": query} for index, query in enumerate(queries)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "queries.yaml"
        file.write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
        run(program, "check", "rules", file)


def check_calls():
    """The unit lets the program lower the priority of its threads: the last word about the call counts."""
    allowed = False
    for line in re.findall(r"(?m)^SystemCallFilter=(.*)$", UNIT.read_text()):
        names = line.removeprefix("~").split()
        if {"setpriority", "@resources"} & set(names):
            allowed = not line.startswith("~")
    if not allowed:
        raise Failed(f"{UNIT.name}: setpriority is refused, so that jobs do not give way to requests")


def check_context():
    """What the program is made of, by its build script, is in the context of the image, the settings of the allocator
    included."""
    build = (ROOT / "build.rs").read_text()
    listed = re.search(r"const SOURCES: \[&str; \d+\] =\s*\[(.*?)\];", build, re.S).group(1)
    sources = re.findall(r'"([^"]+)"', listed)
    ignore = DOCKERFILE.with_name("Dockerfile.dockerignore").read_text().splitlines()
    refuse([f"Dockerfile.dockerignore: {source} is left out" for source in sources if f"!{source}" not in ignore])


def check_names():
    """Settings, routes, commands and tests that the files name exist."""
    try:
        import tomllib
    except ImportError:
        raise Skipped("needs Python 3.11") from None
    sources = [
        *sorted((ROOT / "src").rglob("*.rs")),
        *sorted((ROOT / "crates" / "shapelex-engine" / "src").rglob("*.rs")),
    ]
    program = "".join(path.read_text() for path in [*sources, *ROOT.glob("build.rs")])
    settings = set(re.findall(r'"(SHAPELEX_[A-Z_]+|DATABASE_URL)"', program))
    fields = set(re.findall(r'(?m)^    (\w+): .* = "(?:SHAPELEX_\w+|DATABASE_URL)"', program)) | {"no_example"}
    files = [path for folder in ("docker", "deploy") for path in sorted((ROOT / folder).rglob("*")) if path.is_file()]
    files = [path for path in files if path.suffix not in (".py", ".pyc")] + [ROOT / "docs" / "operations.md"]
    routes = json.loads((ROOT / "openapi" / "openapi.json").read_text())["paths"].keys()
    listed = re.findall(r"enum (?:Command|Maintenance) \{(.*?)\n\}", program, re.S)
    commands = {name.lower() for text in listed for name in re.findall(r"(?m)^    ([A-Z]\w+)[(,{ ]", text)}
    found = []
    for path in files:
        text, name = path.read_text(), path.relative_to(ROOT)
        used = set(re.findall(r"\b(SHAPELEX_[A-Z_]+|DATABASE_URL)\b", text))
        found += [f"{name}: no setting {setting}" for setting in sorted(used - settings)]
        paths = set(re.findall(r"path: (/\w+)|:8080(/\w+)", text))
        found += [f"{name}: no route {route}" for route in sorted({a or b for a, b in paths} - routes)]
        said = set(re.findall(r'(?m)(?:bin/shapelex"?,?|^shapelex|run --rm shapelex-1) "?([a-z]+)', text))
        found += [f"{name}: no command {word}" for word in sorted(said - commands)]
        if path.suffix == ".toml":
            found += [f"{name}: no setting {key}" for key in sorted(tomllib.loads(text).keys() - fields)]
    tests = set(re.findall(r"`((?:http|kill)\w*)`", (ROOT / "SECURITY.md").read_text()))
    found += [
        f"SECURITY.md: no test {test}"
        for test in sorted(tests)
        if not (ROOT / "tests" / "suite" / f"{test}.rs").exists()
    ]
    refuse(found)


def check_supply_chain():
    """Licences, sources and versions of all crates; known vulnerabilities when their database is here."""
    deny = tool("cargo-deny")
    try:
        run("cargo", "fetch", "--locked", "--quiet")
    except Failed:
        raise Skipped("not all crates are here, and they cannot be fetched") from None
    run(deny, "--offline", "--locked", "check", "licenses", "bans", "sources")


def check_sbom():
    """The list of what the program is made of: complete, in the form that others read, the same each time."""
    host = re.search(r"(?m)^host: (.*)$", run("rustc", "-vV")).group(1)
    try:
        metadata = run("cargo", "metadata", "--locked", "--offline", "--format-version", "1", "--filter-platform", host)
    except Failed:
        raise Skipped("not all crates are here") from None
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / name for name in ("metadata.json", "first.json", "second.json")]
        files[0].write_text(metadata)
        for out in files[1:]:
            run(
                sys.executable,
                "deploy/sbom.py",
                files[0],
                "--lock",
                "Cargo.lock",
                "--page-lock",
                "dashboard/package-lock.json",
                "--out",
                out,
            )
        first, second = (out.read_text() for out in files[1:])
    found = json.loads(first)
    names = {part["name"] for part in found["components"] if part["scope"] == "required"}
    refs = {part["bom-ref"] for part in [*found["components"], found["metadata"]["component"]]}
    refuse(
        [
            *([] if first == second else ["it is another one each time"]),
            *(
                f"{name} is missing"
                for name in ("sqlx", "axum", "rustls", "libsqlite3-sys", "preact", "three", "uplot")
                if name not in names
            ),
            *(f"{name} is of the tests" for name in ("proptest", "criterion", "vite", "axe-core") if name in names),
            *(
                f"{one['ref']} or what it needs is not listed"
                for one in found["dependencies"]
                if not refs.issuperset({one["ref"], *one["dependsOn"]})
            ),
        ]
    )


def check_advisories():
    databases = Path(os.environ.get("CARGO_HOME") or Path.home() / ".cargo") / "advisory-dbs"
    if not any(path.is_dir() for path in databases.glob("*")):
        raise Skipped("no database of advisories here; `cargo deny fetch db` brings it")
    run(tool("cargo-deny"), "--offline", "--locked", "check", "advisories")


CHECKS = {
    "yaml": check_yaml,
    "dockerfile": check_dockerfile,
    "shell": check_shell,
    "image": check_image,
    "compose": check_compose,
    "kubernetes": check_kubernetes,
    "chart": check_chart,
    "helm": check_helm,
    "systemd": check_systemd,
    "metrics": check_metrics,
    "monitoring": check_monitoring,
    "calls": check_calls,
    "context": check_context,
    "names": check_names,
    "supply-chain": check_supply_chain,
    "sbom": check_sbom,
    "advisories": check_advisories,
}


def main():
    if Path(sys.prefix) != TOOLS:
        try:
            install()
        except Unavailable as reason:
            print(f"SKIPPED: deploy: checks by the tools of {REQUIREMENTS.name}, which cannot be installed: {reason}")
        else:
            os.execv(PYTHON, [str(PYTHON), __file__, *sys.argv[1:]])
    passed = failed = 0
    for name in sys.argv[1:] or CHECKS:
        try:
            CHECKS[name]()
            passed += 1
            print(f"deploy: {name}: ok")
        except Skipped as reason:
            print(f"SKIPPED: deploy: {name}: {reason}")
        except Failed as reason:
            failed += 1
            print(f"deploy: {name}: FAILED\n{reason}")
    print(f"deploy: {passed} passed, {failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
