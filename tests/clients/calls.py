"""Calls of the generated Python client: whatever is wrong with the types is found by mypy, the rest by the assertions.

calls.py ADDRESS KEY
"""

import math
import sys
import time

from shapelex_client import AuthenticatedClient
from shapelex_client.api.cohorts import add_shapes, cohort_mean, create_cohort, list_shapes
from shapelex_client.api.curves import measure
from shapelex_client.api.dictionaries import assess, dictionary_mode, find_dictionary, learn_dictionary
from shapelex_client.api.jobs import find_job
from shapelex_client.models import (
    AddAnswer,
    AddedShape,
    AddRequest,
    AssessAnswer,
    AssessedShape,
    AssessOnError,
    AssessRequest,
    Attributes,
    ClassName,
    CohortMeanOutput,
    CohortOutput,
    CohortRequest,
    Correspondence,
    DictionaryOutput,
    FailedShape,
    GeneratorKindCubic,
    GeneratorKindTrigonometric,
    JobOutput,
    JobStatus,
    LearnRequest,
    LearntDictionary,
    ListShapesLabels,
    MeasureAnswer,
    MeasuredSurface,
    MeasureRequest,
    MethodFunctionalPca,
    ModeAnswer,
    PageOfShapes,
    ProblemDocument,
    RepresentationClosedCurve,
    RepresentationSurface,
    ShapeInput,
    Topology,
)
from shapelex_client.types import UNSET, Unset

client = AuthenticatedClient(base_url=sys.argv[1], token=sys.argv[2], raise_on_unexpected_status=True)


def blob(k: int) -> list[list[float]]:
    """Forty points of a contour, another one for every `k`."""
    angles = [2 * math.pi * i / 40 for i in range(40)]
    radius = [1 + 0.1 * math.cos(3 * t + k) + 0.05 * k * math.sin(2 * t) for t in angles]
    return [[2 * r * math.cos(t), r * math.sin(t)] for r, t in zip(radius, angles)]


def torus() -> list[list[list[float]]]:
    """A grid of eight by six points."""
    u, v = ([2 * math.pi * i / n for i in range(n)] for n in (8, 6))
    ring = [[(2 + math.cos(b), math.sin(b)) for b in v] for _ in u]
    return [[[r * math.cos(a), r * math.sin(a), z] for r, z in row] for a, row in zip(u, ring)]


curve = RepresentationClosedCurve(
    kind="closed_curve", dimension=2, control_points=12, generator=GeneratorKindTrigonometric(name="trigonometric")
)
cohort = create_cohort.sync(
    client=client,
    body=CohortRequest(name="python", representation=curve, correspondence=Correspondence.ARC_LENGTH, length_unit="mm"),
)
assert isinstance(cohort, CohortOutput), cohort
assert isinstance(cohort.representation, RepresentationClosedCurve), cohort.representation
assert isinstance(cohort.representation.generator, GeneratorKindTrigonometric), cohort.representation

shapes = [
    ShapeInput(
        external_id=f"scan-{k}",
        points=blob(k),
        label="even" if k % 2 == 0 else "odd",
        labels=Attributes.from_dict({"site": "zrh" if k < 4 else "gva", "age": k, "healthy": k > 2}),
        metadata={"scanner": k},
    )
    for k in range(12)
]
added = add_shapes.sync("python", client=client, body=AddRequest(shapes=shapes))
assert isinstance(added, AddAnswer) and added.added == 12, added
last = added.results[11]
assert isinstance(last, AddedShape) and last.external_id == "scan-11", last

# The generator writes the entries of a `deepObject` as they are: their names hold the brackets.
page = list_shapes.sync(
    "python", client=client, labels=ListShapesLabels.from_dict({"labels[site]": "zrh"}), label=["odd"], limit=100
)
assert isinstance(page, PageOfShapes), page
assert [shape.external_id for shape in page.items] == ["scan-1", "scan-3"], page
labels = page.items[0].labels
assert isinstance(labels, Attributes), labels
assert labels.additional_properties == {"site": "zrh", "age": 1, "healthy": False}, labels
assert page.items[0].metadata == {"scanner": 1} and page.next_ is None, page

mean = cohort_mean.sync("python", client=client, transformation=ClassName.SIMILARITY)
assert isinstance(mean, CohortMeanOutput), mean
assert len(mean.mean.control_points) == 12 and mean.converged, mean


def learn(prefer: str | Unset = UNSET) -> DictionaryOutput | JobOutput:
    """Learns the same dictionary, as the client prefers."""
    method = MethodFunctionalPca(kind="functional_pca", components=2, centre=True)
    body = LearnRequest(name="python-modes", cohort="python", transformation=ClassName.SIMILARITY, method=method)
    learnt = learn_dictionary.sync(client=client, body=body, prefer=prefer)
    assert isinstance(learnt, (DictionaryOutput, JobOutput)), learnt
    return learnt


waited = learn("wait=60")
assert isinstance(waited, DictionaryOutput), waited
assert isinstance(waited.method, MethodFunctionalPca) and waited.method.components == 2, waited.method

started = learn()
assert isinstance(started, JobOutput), started
deadline = time.monotonic() + 60
while True:
    job = find_job.sync(started.id, client=client)
    assert isinstance(job, JobOutput) and time.monotonic() < deadline, job
    if job.status not in (JobStatus.QUEUED, JobStatus.RUNNING):
        break
    time.sleep(0.05)
assert isinstance(job.result, LearntDictionary) and job.result.name == "python-modes", job
assert job.problem is None, job

assessed = assess.sync(
    "python-modes", client=client, body=AssessRequest(shapes=[ShapeInput(points=blob(3)), ShapeInput(points=blob(5))])
)
assert isinstance(assessed, AssessAnswer), assessed
first = assessed.results[0]
assert isinstance(first, AssessedShape) and first.index == 0 and not first.novelty.is_outlier, first
assert assessed.dictionary.name == "python-modes", assessed.dictionary

partly = assess.sync(
    "python-modes",
    client=client,
    body=AssessRequest(shapes=[ShapeInput(points=[[0.0, 0.0]], external_id="dot"), ShapeInput(points=blob(5))]),
    on_error=AssessOnError.SKIP,
)
assert isinstance(partly, AssessAnswer) and isinstance(partly.results[1], AssessedShape), partly
bad = partly.results[0]
assert isinstance(bad, FailedShape) and bad.external_id == "dot" and bad.error.code == "invalid-input", bad

mode = dictionary_mode.sync("python-modes", client=client, component=2, sigma=1.5)
assert isinstance(mode, ModeAnswer) and mode.component == 2 and mode.sigma == 1.5, mode

# The generators of a surface are optional, and its points are a grid.
surface = RepresentationSurface(kind="surface", topology=Topology.TORUS, control_points=[8, 6])
measured = measure.sync(client=client, body=MeasureRequest(representation=surface, shapes=[ShapeInput(points=torus())]))
assert isinstance(measured, MeasureAnswer), measured
body = measured.results[0]
assert isinstance(body, MeasuredSurface) and isinstance(body.volume, float), body
assert math.isclose(body.volume, 4 * math.pi**2, rel_tol=0.05), body.volume

missing = find_dictionary.sync_detailed("nothing", client=client)
assert missing.status_code == 404 and isinstance(missing.parsed, ProblemDocument), missing
assert missing.parsed.code == "not-found", missing.parsed

refused = assess.sync_detailed(
    "python-modes",
    client=client,
    body=AssessRequest(shapes=[ShapeInput(points=blob(1)), ShapeInput(points=[[0.0, 0.0]])]),
)
assert refused.status_code == 422 and isinstance(refused.parsed, ProblemDocument), refused
assert str(refused.parsed.errors[0].pointer).startswith("/shapes/1"), refused.parsed

wrong = RepresentationClosedCurve(
    kind="closed_curve", dimension=2, control_points=1, generator=GeneratorKindCubic(name="cubic")
)
refused_cohort = create_cohort.sync_detailed(client=client, body=CohortRequest(name="wrong", representation=wrong))
assert refused_cohort.status_code == 422 and isinstance(refused_cohort.parsed, ProblemDocument), refused_cohort
assert refused_cohort.parsed.errors[0].pointer == "/representation/control_points", refused_cohort.parsed
print("clients: the calls in Python are right")
