"""Calls of the Python client that openapi-generator writes: what a call sends and gives is found by the assertions.

openapi_calls.py ADDRESS KEY
"""

import math
import sys

import shapelex_openapi as shapelex

address, key = sys.argv[1:]
client = shapelex.ApiClient(shapelex.Configuration(host=address, access_token=key))
cohorts, dictionaries = shapelex.CohortsApi(client), shapelex.DictionariesApi(client)


def blob(k):
    """Forty points of a contour, another one for every `k`."""
    angles = [2 * math.pi * i / 40 for i in range(40)]
    radius = [1 + 0.1 * math.cos(3 * t + k) + 0.05 * k * math.sin(2 * t) for t in angles]
    return [[2 * r * math.cos(t), r * math.sin(t)] for r, t in zip(radius, angles)]


def shape(k):
    """A shape with a label and attributes."""
    labels = {"site": "zrh" if k < 4 else "gva", "age": k}
    return shapelex.ShapeInput(
        external_id=f"scan-{k}",
        points=shapelex.PointsOrGrid(blob(k)),
        label="even" if k % 2 == 0 else "odd",
        labels={name: shapelex.AttributesValue(value) for name, value in labels.items()},
    )


generator = shapelex.GeneratorKind(shapelex.GeneratorKindTrigonometric(name="trigonometric"))
curve = shapelex.RepresentationClosedCurve(kind="closed_curve", dimension=2, control_points=12, generator=generator)
made = cohorts.create_cohort(
    shapelex.CohortRequest(
        name="openapi-python", representation=shapelex.Representation(curve), correspondence="arc_length"
    )
)
assert made.representation.actual_instance.control_points == 12, made
added = cohorts.add_shapes("openapi-python", shapelex.AddRequest(shapes=[shape(k) for k in range(12)]))
assert added.added == 12, added

# The generator writes maps of a query as JSON; the same filter is a list of texts.
page = cohorts.list_shapes("openapi-python", condition=["labels.site=zrh"], label=["odd"], limit=100)
assert [item.external_id for item in page.items] == ["scan-1", "scan-3"], page
assert page.items[0].labels["age"].actual_instance == 1, page.items[0]

mean = cohorts.cohort_mean("openapi-python", transformation="similarity", condition=["labels.age.gte=4"])
assert mean.shape_count == 8 and len(mean.mean.control_points) == 12, mean

try:
    dictionaries.find_dictionary("nothing")
except shapelex.ApiException as error:
    assert error.status == 404 and '"not-found"' in error.body, error
else:
    sys.exit("expected an error for a dictionary that does not exist, got none")
print("clients: the calls in Python by openapi-generator are right")
