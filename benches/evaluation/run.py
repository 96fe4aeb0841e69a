"""Classification on real shapes, through the running service; writes the tables of docs/evaluation.md.

    python benches/evaluation/run.py --data FOLDER [--binary PROGRAM] [--table TABLE] [NAME ...]

FOLDER holds the data sets (`curves-molars/curves.ndjson` and so on); NAME chooses some of them, TABLE one of the
tables. The table of peers needs numpy and scikit-learn, the others nothing beyond the standard library. Every figure is
made by requests that a client can repeat: a cohort is posted, a dictionary with a classifier is learnt from it, and
what its validation says is written down. Seeds are fixed.
"""

import argparse
import csv
import http.client
import json
import math
import subprocess
import tempfile
import time
import urllib.error
import urllib.request
from collections import Counter
from pathlib import Path
from random import Random
from statistics import mean, stdev

ROOT = Path(__file__).resolve().parents[2]
REPEATS = 3
POINTS = 128


class Service:
    """The program on a free port with an empty folder."""

    def __init__(self, binary, folder):
        command = [binary, "serve", "--listen", "127.0.0.1:0", "--no-example", "--data-dir", folder]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.address = self.process.stdout.readline().split()[-1]

    def call(self, method, path, body=None, headers=(), raw=False):
        data = None if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data, method=method)
        request.add_header("content-type", "application/json")
        for name, value in headers:
            request.add_header(name, value)
        try:
            with urllib.request.urlopen(request, timeout=3600) as answer:
                content = answer.read()
                return content if raw else json.loads(content or b"null")
        except urllib.error.HTTPError as error:
            raise SystemExit(f"{method} {path}: {error.code} {error.read().decode()[:2000]}") from error

    def finished(self, job):
        while job["status"] in ("queued", "running"):
            time.sleep(0.2)
            job = self.call("GET", f"/v1/jobs/{job['id']}")
        if job["status"] != "succeeded":
            raise SystemExit(json.dumps(job)[:2000])
        return job

    def cohort(self, name, representation, correspondence, shapes):
        body = {"name": name, "representation": representation, "correspondence": correspondence}
        if correspondence != "landmarks":
            body["direction"] = "either"
        self.call("POST", "/v1/cohorts", body)
        self.call("POST", f"/v1/cohorts/{name}/shapes", {"shapes": shapes})

    def learn(self, name, cohort, classifier, method, transformation):
        body = {"name": name, "cohort": cohort, "transformation": transformation, "method": method}
        job = self.call("POST", "/v1/dictionaries", {**body, "classifier": {"repeats": REPEATS, **classifier}})
        self.finished(job)
        return self.call("GET", f"/v1/dictionaries/{name}")


def curves(folder, data_set, target=None, subject=None, keep=lambda shape: True):
    """Shapes of a set of contours; `target` names the attribute that is the class."""
    shapes = []
    for line in open(Path(folder) / data_set / "curves.ndjson"):
        given = json.loads(line)
        if not keep(given):
            continue
        shape = {"external_id": given["id"], "points": given["points"]}
        shape["label"] = given["labels"][target] if target else given["label"]
        if subject:
            shape["subject"] = str(given["labels"][subject])
        shapes.append(shape)
    return shapes


def landmarks(folder, data_set, target):
    shapes = []
    with open(Path(folder) / data_set / "landmarks.csv", newline="") as file:
        for row in csv.DictReader(file):
            count = sum(1 for key in row if key[0] == "x" and key[1:].isdigit())
            axes = "xyz" if "z1" in row else "xy"
            points = [[float(row[f"{axis}{i}"]) for axis in axes] for i in range(1, count + 1)]
            shapes.append({"external_id": row["id"], "label": row[target], "points": points})
    return shapes


def contour():
    return {"kind": "closed_curve", "dimension": 2, "generator": {"name": "cubic"}, "control_points": POINTS}


ALL_KINDS = ("mean_space", "nearest_atom", "sparse_residual", "nearest_neighbours", "discriminant", "best")
ATOMS_A_CLASS = 4

# name: data set, keyword arguments, correspondence, class that is removed
SIMILARITY = "similarity"
UPRIGHT = "uniform_scaling_translation"
SETS = {
    "molars": ("curves-molars", {"subject": "ind"}, "cyclic", SIMILARITY),
    "North Sea fish, classes of 5": ("curves-north-sea-fish", {"fewest": 5}, "cyclic", SIMILARITY),
    "North Sea fish, all classes, 3 parts": ("curves-north-sea-fish", {"folds": 3}, "cyclic", SIMILARITY),
    "mouse vertebrae": ("curves-mouse-vertebrae", {}, "cyclic", SIMILARITY),
    "hearts": ("curves-hearts", {}, "cyclic", SIMILARITY),
    "hearts, start as given": ("curves-hearts", {}, "arc_length", SIMILARITY),
    "hearts, tilt as drawn": ("curves-hearts", {}, "cyclic", UPRIGHT),
    "otoliths": ("curves-otoliths", {}, "cyclic", SIMILARITY),
    "charred grains, dorsal": ("curves-charred-grains", {"subject": "grain", "view": "d"}, "cyclic", SIMILARITY),
    "charred grains, lateral": ("curves-charred-grains", {"subject": "grain", "view": "l"}, "cyclic", SIMILARITY),
    "charred grains, polar": ("curves-charred-grains", {"subject": "grain", "view": "p"}, "cyclic", SIMILARITY),
    "osteosarcoma, treatment": ("curves-osteosarcoma-cells", {"target": "treatment"}, "cyclic", SIMILARITY),
}
LANDMARKS = {
    "ape skulls": ("landmarks-ape-skulls", "group"),
    "plethodon": ("landmarks-plethodon", "species"),
    "Passiflora": ("landmarks-passiflora-leaves", "species"),
}


def shapes_of(folder, data_set, arguments):
    arguments = {key: value for key, value in arguments.items() if key != "folds"}
    view, fewest = arguments.pop("view", None), arguments.pop("fewest", 1)
    if view:
        arguments["keep"] = lambda shape: shape["labels"]["view"] == view
    shapes = curves(folder, data_set, **arguments)
    sizes = Counter(shape["label"] for shape in shapes)
    return [shape for shape in shapes if sizes[shape["label"]] >= fewest]


def row(name, correspondence, kind, dictionary, seconds):
    validation = dictionary["classifier"]["validation"]
    accuracy, balanced = validation["accuracy"], validation["balanced_accuracy"]["value"]
    interval = f"{accuracy['low']:.3f}–{accuracy['high']:.3f}"
    classes = len(validation["classes"])
    cells = [name, str(validation["shapes"]), str(classes), correspondence, kind, f"{validation['majority']:.3f}"]
    cells += [f"{accuracy['value']:.3f}", interval, f"{balanced:.3f}", f"{validation['brier']:.3f}", f"{seconds:.1f}"]
    return "| " + " | ".join(cells) + " |"


HEAD = (
    "| data | shapes | classes | correspondence | classifier | majority | accuracy | 95 % | balanced | Brier | "
    "seconds |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)


def evaluate(service, name, cohort, correspondence, transformation, components, kinds, shapes, folds=5):
    atoms = ATOMS_A_CLASS * len({shape["label"] for shape in shapes})
    for kind in kinds:
        method = {"kind": "functional_pca", "components": components, "centre": True}
        if kind == "nearest_atom":
            method = {"kind": "sparse", "atoms": atoms, "nonzeros": 1}
        if kind == "sparse_residual":
            method = {"kind": "sparse", "atoms": atoms, "lambda": 0.02}
        start = time.perf_counter()
        dictionary = service.learn(f"{cohort}-{kind}", cohort, {"kind": kind, "folds": folds}, method, transformation)
        print(row(name, correspondence, kind, dictionary, time.perf_counter() - start), flush=True)


def silhouettes(service, folder):
    """Leave-one-out nearest neighbour and bull's-eye score of the MPEG-7 silhouettes, from the matrix of distances."""
    shapes = curves(folder, "curves-mpeg7")
    labels = [shape["label"] for shape in shapes]
    sizes = Counter(labels)
    print("\n| MPEG-7, 910 curves of 65 classes | nearest neighbour | bull's-eye | seconds |\n|---|---|---|---|")
    for points in (64, 100):
        representation = {**contour(), "generator": {"name": "trigonometric"}, "control_points": points}
        service.cohort(f"mpeg7-{points}", representation, "cyclic", shapes)
        for mirror in ("forbid", "allow"):
            body = {"cohort": f"mpeg7-{points}", "transformation": "similarity", "mirror": mirror}
            start = time.perf_counter()
            distances = service.call("POST", "/v1/distances", body, [("prefer", "wait=60")])["distances"]
            seconds = time.perf_counter() - start
            right = found = 0
            for i, row_of in enumerate(distances):
                order = sorted(range(len(row_of)), key=lambda j: (row_of[j], j != i))
                right += labels[order[1]] == labels[i]
                nearest = order[: 2 * sizes[labels[i]]]
                found += sum(labels[j] == labels[i] for j in nearest) / sizes[labels[i]]
            mirrored = ", mirror images" if mirror == "allow" else ""
            cells = [
                f"{points} points{mirrored}",
                f"{right / len(labels):.3f}",
                f"{found / len(labels):.3f}",
                f"{seconds:.2f}",
            ]
            print("| " + " | ".join(cells) + " |", flush=True)


SHUFFLES = 500
MOST_ATTRIBUTES = 100


def shuffled(service, folder):
    """How often groups without meaning differ: 100 cells, halved at random 500 times."""
    random = Random(0)
    cells = random.sample(curves(folder, "curves-osteosarcoma-cells", target="treatment"), 100)
    for first in range(0, SHUFFLES, MOST_ATTRIBUTES):
        halves = [random.sample([0, 1] * 50, 100) for _ in range(MOST_ATTRIBUTES)]
        attributes = lambda k: {f"half{first + i}": str(half[k]) for i, half in enumerate(halves)}
        shapes = [{**cell, "labels": attributes(k)} for k, cell in enumerate(cells)]
        service.cohort(f"halves{first}", contour(), "cyclic", shapes)
    rejected = Counter()
    for i in range(SHUFFLES):
        cohort = f"halves{i - i % MOST_ATTRIBUTES}"
        body = {"cohort": cohort, "by": f"labels.half{i}", "permutations": 999, "seed": i, "samples": 2}
        answer = service.call("POST", "/v1/comparisons", body, [("prefer", "wait=60")])
        pair = answer["pairs"][0]
        tests = {name: pair[name]["test"] for name in ("distance", "pseudo_f", "hotelling")}
        tests |= {size["measure"]: size["test"] for size in pair["sizes"]}
        rejected.update(name for name, test in tests.items() if test["p"] <= 0.05)
    print(f"\n| {SHUFFLES} random halves of 100 cells | p ≤ 0.05 |\n|---|---|")
    for name in tests:
        print(f"| {name} | {100 * rejected[name] / SHUFFLES:.1f} % |", flush=True)


def differing(service):
    """Two groups of noisy ellipses, of which one has a small bump."""
    random = Random(1)

    def outline(bump):
        size, turn, start = random.uniform(1, 3), random.uniform(0, 6.3), random.random()
        waves = [(k, random.gauss(0, 0.02), random.uniform(0, 6.3)) for k in range(2, 9)]
        points = []
        for i in range(120):
            t = 2 * math.pi * (i / 120 + start)
            r = 1 + sum(a * math.cos(k * t + phase) for k, a, phase in waves)
            r += bump * math.exp(-((math.remainder(t - 1.0, 2 * math.pi) / 0.3) ** 2))
            x, y = 1.6 * r * math.cos(t), r * math.sin(t)
            c, s = size * math.cos(turn), size * math.sin(turn)
            points.append([c * x - s * y, s * x + c * y])
        return points

    shapes = [{"label": "patients" if k % 2 else "controls", "points": outline(0.1 * (k % 2))} for k in range(80)]
    service.cohort("bumps", contour(), "cyclic", shapes)
    body = {"cohort": "bumps", "by": "label", "permutations": 9999}
    pair = service.call("POST", "/v1/comparisons", body, [("prefer", "wait=60")])["pairs"][0]
    print("\n| 40 ellipses against 40 with a bump of a tenth | p |\n|---|---|")
    for name in ("distance", "hotelling"):
        print(f"| {name} | {pair[name]['test']['p']:.4f} |")
    print(f"| smallest p along the contour | {min(point['p'] for point in pair['effect']):.4f} |", flush=True)


def latencies(service, folder):
    """Time of single requests over loopback, one connection."""
    shapes = curves(folder, "curves-mpeg7")
    service.cohort("many", {**contour(), "control_points": 100}, "cyclic", shapes)
    method = {"kind": "functional_pca", "components": 20, "centre": True}
    body = {"name": "many", "cohort": "many", "transformation": "similarity", "method": method}
    body["classifier"] = {"kind": "discriminant", "repeats": 1}
    service.finished(service.call("POST", "/v1/dictionaries", body))
    host, port = service.address.removeprefix("http://").split(":")
    connection = http.client.HTTPConnection(host, int(port))
    print("\n| one contour, one connection | p50 | p95 |\n|---|---|---|")
    for name, path, further in (
        ("assess", "/v1/dictionaries/many/assess", {}),
        ("classify", "/v1/dictionaries/many/classify", {}),
        ("search among 910", "/v1/cohorts/many/search", {"neighbours": 10}),
        ("search among 910, mirror images", "/v1/cohorts/many/search", {"neighbours": 10, "mirror": "allow"}),
    ):
        times = []
        for k in range(300):
            posted = json.dumps({"shapes": [{"points": shapes[k]["points"]}], **further})
            start = time.perf_counter()
            connection.request("POST", path, posted, {"content-type": "application/json"})
            answer = connection.getresponse()
            answer.read()
            times.append(1e3 * (time.perf_counter() - start))
            if answer.status != 200:
                raise SystemExit(f"{path}: {answer.status}")
        times = sorted(times[20:])
        print(f"| {name} | {times[len(times) // 2]:.2f} ms | {times[int(0.95 * len(times))]:.2f} ms |", flush=True)


OUTLINES = (
    "apodemus-mandibles",
    "charred-grains",
    "hands",
    "hearts",
    "molars",
    "mosquito-wings",
    "mouse-molars",
    "mouse-vertebrae",
    "mpeg7",
    "north-sea-fish",
    "olive-stones",
    "osteosarcoma-cells",
    "otoliths",
    "trilobite-heads",
)
LEARNT = {20: 40, 40: 20, 80: 10, 160: 5}
MOST_ASKED = 300
NOVELTY_POINTS = 48


def outlines(folder, data_set):
    """Shapes without classes, their representation and correspondence."""
    given = [json.loads(line) for line in open(Path(folder) / f"curves-{data_set}" / "curves.ndjson")]
    kind = {**contour(), "generator": {"name": "trigonometric"}, "control_points": NOVELTY_POINTS}
    if not given[0]["closed"]:
        generator = {"name": "bspline", "degree": 3}
        kind = {"kind": "open_curve", "dimension": 2, "generator": generator, "intervals": NOVELTY_POINTS}
    correspondence = "cyclic" if given[0]["closed"] else "arc_length"
    return [{"points": shape["points"]} for shape in given], kind, correspondence


def quantile_of(values, quantile):
    place = quantile * (len(values) - 1)
    below = int(place)
    return values[below] + (place - below) * (values[min(below + 1, len(values) - 1)] - values[below])


def alarms(service, name, shapes, dictionary):
    """Parts of new shapes that are outliers at 0.95 and 0.99: by shapes held out, and by those learnt from."""
    found = []
    statistics = dictionary["statistics"]
    for quantile in (0.95, 0.99):
        answer = service.call("POST", f"/v1/dictionaries/{name}/score", {"shapes": shapes, "quantile": quantile})
        scores = answer["results"]
        found.append(sum(score["novelty"]["is_outlier"] for score in scores) / len(scores))
        q = quantile_of(statistics["residuals"], quantile)
        beyond = [score["squared_prediction_error"] > q for score in scores]
        if statistics.get("scores"):
            t = quantile_of(statistics["scores"]["t_squared"], quantile)
            beyond = [a or score["t_squared"] > t for a, score in zip(beyond, scores)]
        found.append(sum(beyond) / len(beyond))
    return found


def novelty(service, folder, names, atoms=False):
    """False alarms among shapes that were not learnt from, over random draws, with standard errors."""
    method = {"kind": "functional_pca", "components": 8, "centre": True}
    if atoms:
        method = {"kind": "sparse", "atoms": 8, "lambda": 0.02, "max_epochs": 30}
    print("\n| data | learnt | draws | false alarms at 0.95 | at 0.99 | by shapes learnt from, at 0.95 | at 0.99 |")
    print("|---|---|---|---|---|---|---|")
    for data_set in OUTLINES:
        if names and not any(name in data_set for name in names):
            continue
        shapes, kind, correspondence = outlines(folder, data_set)
        for learnt, draws in LEARNT.items():
            if len(shapes) < learnt + 10:
                continue
            draws = max(draws // 4, 2) if atoms else draws
            rows = []
            for seed in range(draws):
                order = shapes[:]
                Random(seed).shuffle(order)
                name = f"{data_set}-{learnt}-{seed}{'-atoms' if atoms else ''}"
                service.cohort(name, kind, correspondence, order[:learnt])
                body = {"name": name, "cohort": name, "transformation": "similarity", "method": method}
                service.finished(service.call("POST", "/v1/dictionaries", body))
                dictionary = service.call("GET", f"/v1/dictionaries/{name}")
                asked = order[learnt : learnt + MOST_ASKED]
                rows.append(alarms(service, name, asked, dictionary))
            figures = [(mean(values), stdev(values) / draws**0.5) for values in zip(*rows)]
            held, old, held99, old99 = (f"{100 * value:.1f} ± {100 * error:.1f} %" for value, error in figures)
            cells = [data_set, str(learnt), str(draws), held, held99, old, old99]
            print("| " + " | ".join(cells) + " |", flush=True)


HALVINGS = 10


def drifts(service, folder, names):
    """The angle between the means of two halves of a set beside what is expected."""
    print("\n| data | shapes | observed | expected | ratio |\n|---|---|---|---|---|")
    for data_set in OUTLINES:
        if names and not any(name in data_set for name in names):
            continue
        shapes, kind, correspondence = outlines(folder, data_set)
        observed = expected = 0.0
        for seed in range(HALVINGS):
            order = shapes[:]
            Random(seed).shuffle(order)
            name = f"drift-{data_set}-{seed}"
            service.cohort(name, kind, correspondence, order[: len(order) // 2])
            method = {"kind": "functional_pca", "components": 4, "centre": True}
            body = {"name": name, "cohort": name, "transformation": "similarity", "method": method}
            service.finished(service.call("POST", "/v1/dictionaries", body))
            service.call("POST", f"/v1/cohorts/{name}/shapes", {"shapes": order[len(order) // 2 :]})
            mean = service.call("GET", f"/v1/dictionaries/{name}/drift")["mean"]
            observed += mean["angle_deg"] ** 2 / HALVINGS
            expected += mean["expected_deg"] ** 2 / HALVINGS
        cells = [data_set, str(len(shapes)), f"{observed**0.5:.3f}°", f"{expected**0.5:.3f}°"]
        print("| " + " | ".join([*cells, f"{(expected / observed) ** 0.5:.2f}"]) + " |", flush=True)


PEERS = ("molars", "mouse vertebrae", "hearts", "hearts, start as given", "otoliths", "charred grains, dorsal",
         "charred grains, lateral", "charred grains, polar", "North Sea fish, classes of 5")  # fmt: skip
SPLITS = 30
HELD = 0.3
# Splits of the training shapes by which a peer is chosen.
WITHIN = 4


def split(shapes, seed):
    """Training and test shapes; of every class about the same part, a subject on one side."""
    random = Random(seed)
    groups = {}
    for k, shape in enumerate(shapes):
        groups.setdefault(shape.get("subject", k), []).append(shape)
    order = list(groups.values())
    random.shuffle(order)
    sizes, taken, test = Counter(shape["label"] for shape in shapes), Counter(), []
    training = []
    for group in order:
        label = group[0]["label"]
        held = taken[label] + len(group) / 2 <= HELD * sizes[label]
        taken.update(shape["label"] for shape in group if held)
        (test if held else training).extend(group)
    return training, test


def beside_peers(service, folder, names):
    """`best` beside plain peers, on shapes neither learnt nor chosen from; random splits by subject.

    A peer is chosen as `best` is, within the training shapes; the best by the test shapes, which flatters it, stands
    beside.
    """
    import peers

    def chosen(training, seed):
        sums = Counter()
        for within in range(WITHIN):
            known, asked = split(training, 1000 * (seed + 1) + within)
            for peer, value in peers.accuracies(known, asked).items():
                sums[peer] += value * len(asked)
        return max(sums, key=sums.get)

    print(f"\n{SPLITS} splits, {HELD:.0%} held out, seeds 0 to {SPLITS - 1}\n")
    print(
        "| data | shapes | `best` | Brier | peer chosen within | Procrustes, best of 8 | Fourier, best of 8 | "
        "kinds |\n|---|---|---|---|---|---|---|---|"
    )
    for number, name in enumerate(PEERS):
        if names and not any(part in name for part in names):
            continue
        data_set, arguments, correspondence, transformation = SETS[name]
        shapes = shapes_of(folder, data_set, arguments)
        right = brier = asked = peer_right = 0
        others, kinds = Counter(), Counter()
        for seed in range(SPLITS):
            training, test = split(shapes, seed)
            cohort = f"peers{number}-{seed}"
            service.cohort(cohort, contour(), correspondence, training)
            method = {"kind": "functional_pca", "components": 40, "centre": True}
            classifier = {"kind": "best", "folds": 3, "repeats": 1}
            dictionary = service.learn(cohort, cohort, classifier, method, transformation)
            kinds[dictionary["classifier"]["kind"]] += 1
            plain = [{"points": shape["points"]} for shape in test]
            answer = service.call("POST", f"/v1/dictionaries/{cohort}/classify", {"shapes": plain})
            for shape, found in zip(test, answer["results"]):
                right += found["label"] == shape["label"]
                brier += sum((r["confidence"] - (r["label"] == shape["label"])) ** 2 for r in found["ranking"])
            asked += len(test)
            found = peers.accuracies(training, test)
            peer_right += found[chosen(training, seed)] * len(test)
            for peer, value in found.items():
                others[peer] += value * len(test)
        best = {family: max((value, peer) for peer, value in others.items() if peer.startswith(family))
                for family in ("Procrustes", "Fourier")}  # fmt: skip
        cells = [name, str(len(shapes)), f"{right / asked:.3f}", f"{brier / asked:.3f}", f"{peer_right / asked:.3f}"]
        cells += [f"{value / asked:.3f} ({peer.split(' ', 1)[1]})" for value, peer in best.values()]
        cells.append(", ".join(f"{kind} {count}" for kind, count in kinds.most_common()))
        print("| " + " | ".join(cells) + " |", flush=True)


def classes(service, options):
    """The tables of classes, and of all else that has no option of its own."""
    kinds = options.kinds.split(",")
    chosen = lambda name: not options.names or any(part in name for part in options.names)
    print(HEAD)
    for number, (name, (data_set, arguments, correspondence, transformation)) in enumerate(SETS.items()):
        if chosen(name):
            cohort = f"set{number}"
            shapes = shapes_of(options.data, data_set, arguments)
            service.cohort(cohort, contour(), correspondence, shapes)
            rule, folds = (correspondence, transformation), arguments.get("folds", 5)
            evaluate(service, name, cohort, *rule, options.components, kinds, shapes, folds)
    for number, (name, (data_set, target)) in enumerate(LANDMARKS.items()):
        if chosen(name):
            shapes = landmarks(options.data, data_set, target)
            dimension = len(shapes[0]["points"][0])
            representation = {"kind": "landmarks", "dimension": dimension, "points": len(shapes[0]["points"])}
            cohort = f"marks{number}"
            service.cohort(cohort, representation, "landmarks", shapes)
            evaluate(service, name, cohort, "landmarks", SIMILARITY, options.components, kinds, shapes)
    if chosen("MPEG-7"):
        silhouettes(service, options.data)
    if chosen("halves"):
        shuffled(service, options.data)
    if chosen("bumps"):
        differing(service)
    if chosen("latencies"):
        latencies(service, options.data)


TABLES = {
    "classes": classes,
    "peers": lambda service, options: beside_peers(service, options.data, options.names),
    "novelty": lambda service, options: novelty(service, options.data, options.names),
    "atoms": lambda service, options: novelty(service, options.data, options.names, atoms=True),
    "drift": lambda service, options: drifts(service, options.data, options.names),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--binary")
    parser.add_argument("--components", type=int, default=40)
    parser.add_argument("--kinds", default=",".join(ALL_KINDS))
    parser.add_argument("--table", choices=TABLES, help="one of the tables; all unless given")
    parser.add_argument("names", nargs="*")
    options = parser.parse_args()
    binary = options.binary
    if not binary:
        subprocess.run(["cargo", "build", "--release", "--locked"], cwd=ROOT, check=True)
        binary = ROOT / "target/release/shapelex"
    for name, table in TABLES.items():
        if options.table in (None, name):
            with tempfile.TemporaryDirectory() as folder:
                service = Service(binary, folder)
                try:
                    table(service, options)
                finally:
                    service.process.kill()


if __name__ == "__main__":
    main()
