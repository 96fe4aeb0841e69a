"""Pictures are drawn, and show something."""

import io

import matplotlib.pyplot as plt
import numpy as np
import pytest

from shapelex import Outlines, ShapelexError, plot
from shapelex.testing import example_shapes


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def learnt(shapelex_server):
    cohort = shapelex_server.client().create_cohort("drawn", example_shapes(), control_points=24)
    return cohort, cohort.learn("drawn", components=4)


def colours(figure):
    """Number of different colours of a picture."""
    file = io.BytesIO()
    figure.savefig(file, format="rgba", dpi=40)
    return len(np.unique(np.frombuffer(file.getvalue(), dtype=np.uint32)))


def torus():
    u, v = np.meshgrid(2 * np.pi * np.arange(16) / 16, 2 * np.pi * np.arange(12) / 12, indexing="ij")
    grid = np.stack([(3 + np.cos(v)) * np.cos(u), (3 + np.cos(v)) * np.sin(u), np.sin(v)], axis=-1)
    return Outlines(np.stack([grid, 1.2 * grid]), "surface", closed=(True, True))


def test_means_and_modes(learnt):
    cohort, dictionary = learnt
    assert colours(cohort.mean().plot()) > 3
    figure = dictionary.plot(2)
    assert len(figure.axes) == 10 and colours(figure) > 10
    assert figure.axes[0].get_title().startswith("mode 1: ")
    limits = {ax.get_xlim() for ax in figure.axes}
    assert len(limits) == 1, "sizes of the shapes cannot be compared"


def test_groups(learnt):
    cohort, _ = learnt
    found = cohort.compare("labels.group", permutations=199, samples=40)
    figure = found.plot()
    assert figure.axes[1].get_title() == "a → b, p = 0.005" and colours(figure) > 30
    assert len(plot.effect(found).axes) == 2


def test_models(learnt):
    cohort, _ = learnt
    figure = cohort.lm("~ group", permutations=19).plot()
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["group=a", "group=b"]


def test_morphospaces(learnt):
    _, dictionary = learnt
    found = dictionary.morphospace((1, 2), steps=4)
    figure = found.plot(by="label")
    ax = figure.axes[0]
    assert len(ax.lines) == 16 and len(ax.collections) == 2
    assert ax.get_xlabel().startswith("component 1 (")
    # Every shape lies about its scores, and is as wide as it is in the unit of the other ones.
    centres = np.array([line.get_xydata()[:-1].mean(axis=0) for line in ax.lines])
    assert np.allclose(centres, found.at, atol=1e-9)


def test_surfaces_and_landmarks(learnt):
    surfaces = torus()
    assert colours(plot.surface(surfaces)) > 30
    values = surfaces.points[0, ..., 2]
    assert colours(plot.surface(surfaces, values=values)) > 30
    with pytest.raises(ShapelexError, match="expected 192 values, got 3"):
        plot.surface(surfaces, values=np.zeros(3))
    assert colours(plot.outlines(Outlines(np.random.default_rng(0).random((2, 5, 3)), "landmarks"))) > 3


def test_given_axes_are_used(learnt):
    cohort, _ = learnt
    figure, axes = plt.subplots()
    assert cohort.mean().plot(axes, color="red") is figure and axes.lines[0].get_color() == "red"
