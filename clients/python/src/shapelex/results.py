"""Results of statistics as arrays and frames; each knows how to draw itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from ._reply import expect, imported

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ._generated import types as t

Floats = NDArray[np.float64]


@dataclass
class Outlines:
    """Shapes as they are drawn.

    Attributes
    ----------
    points : ndarray of shape (n, m, d), or (n, u, v, 3) of spline surfaces
        Points on each shape, in its unit.
    kind : str
        `closed_curve`, `open_curve`, `landmarks`, `surface` or `subdivision`.
    faces : ndarray of shape (f, 3), optional
        Triangles of a subdivision surface.
    closed : tuple of bool
        Of a surface, whether its directions `u` and `v` are closed.
    """

    points: Floats
    kind: str = "closed_curve"
    faces: NDArray[np.int64] | None = None
    closed: tuple[bool, bool] = (False, False)

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, chosen: int | slice) -> Outlines:
        places = slice(chosen, chosen + 1 or None) if isinstance(chosen, int) else chosen
        return Outlines(self.points[places], self.kind, self.faces, self.closed)

    @property
    def flat(self) -> bool:
        """Whether the shapes lie in the plane."""
        return bool(self.points.shape[-1] == 2)

    def triangles(self) -> NDArray[np.int64]:
        """Triangles of a surface, as places among its points."""
        if self.faces is not None:
            return self.faces
        expect(self.kind == "surface", f"expected a surface, got {self.kind}")
        n_u, n_v = self.points.shape[1:3]
        place = np.arange(n_u * n_v).reshape(n_u, n_v)
        place = np.concatenate([place, place[:1]]) if self.closed[0] else place
        place = np.concatenate([place, place[:, :1]], axis=1) if self.closed[1] else place
        a, b, c, d = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
        return cast("NDArray[np.int64]", np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3))


def control_points(document: Mapping[str, Any] | Sequence[Any]) -> Floats:
    """Control points of a shape of an answer, as an array of shape (N, d)."""
    rows = document["control_points"] if isinstance(document, Mapping) else document
    return np.asarray(rows, dtype=np.float64)


@dataclass
class Mean:
    """The mean shape of a cohort.

    Attributes
    ----------
    control_points : ndarray of shape (N, d)
        Coefficients in the representation of the cohort; of unit `L₂` norm except under `rigid` and `translation`.
    outline : Outlines
        One shape: points on the mean.
    document : CohortMeanOutput
        The whole answer.
    """

    control_points: Floats
    outline: Outlines
    document: t.CohortMeanOutput

    @property
    def points(self) -> Floats:
        """Points on the mean, of shape (m, d)."""
        return cast(Floats, self.outline.points[0])

    @property
    def n_shapes(self) -> int:
        """Number of shapes."""
        return self.document["shape_count"]

    @property
    def warnings(self) -> list[str]:
        """What should be known of the mean."""
        return self.document["warnings"]

    def __repr__(self) -> str:
        return f"<Mean of {self.n_shapes} shapes>"

    def plot(self, ax: Axes | None = None, **style: Any) -> Figure:
        """Draws the mean; `style` as matplotlib takes it."""
        from . import plot

        return plot.outlines(self.outline, ax, **style)


@dataclass
class Modes:
    """Modes of variation: the mean, and the shapes `sigma` standard deviations below and above it.

    Attributes
    ----------
    mean : Outlines
        One shape.
    steps : list of Outlines
        Of each mode, shapes at the deviations `sigmas`.
    sigmas : ndarray of shape (s,)
        Standard deviations of the scores at which they are drawn.
    components : list of int
        Components, from 1.
    explained : ndarray of shape (k,)
        Fraction of the variation that each explains.
    deviations : ndarray of shape (k,)
        Standard deviations of their scores.
    """

    mean: Outlines
    steps: list[Outlines]
    sigmas: Floats
    components: list[int]
    explained: Floats
    deviations: Floats

    def plot(self, **style: Any) -> Figure:
        """Draws a row of shapes for each mode."""
        from . import plot

        return plot.modes(self, **style)


@dataclass
class Comparison:
    """A comparison of groups of shapes.

    Attributes
    ----------
    document : Comparison
        The whole answer.
    averages : Outlines
        The average of each group, in the order of `groups`.
    """

    document: t.Comparison
    averages: Outlines

    @property
    def groups(self) -> pd.DataFrame:
        """Groups: their names, numbers of shapes and spreads."""
        pandas = imported("pandas", "a frame")
        frame = pandas.DataFrame(self.document["groups"])
        return cast("pd.DataFrame", frame[["name", "shape_count", "weight", "spread"]])

    @property
    def pairs(self) -> pd.DataFrame:
        """Pairs of groups: distance of the means, pseudo-F, fraction explained, p values, also corrected by Holm."""
        pandas = imported("pandas", "a frame")
        rows = [
            {
                "first": pair["first"],
                "second": pair["second"],
                "distance": pair["distance"].get("value"),
                "pseudo_f": pair["pseudo_f"].get("value"),
                "r_squared": pair["r_squared"],
                "p": pair["pseudo_f"]["test"].get("p"),
                "p_holm": pair["pseudo_f"]["test"].get("p_holm"),
                "permutations": pair["pseudo_f"]["test"]["permutations"],
            }
            for pair in self.document["pairs"]
        ]
        return cast("pd.DataFrame", pandas.DataFrame(rows))

    def effect(self, first: str | None = None, second: str | None = None) -> pd.DataFrame:
        """Differences along the shape between two groups, the second minus the first.

        Returns
        -------
        DataFrame
            `parameter`, coordinates `point.0`, …, `difference.0`, …, `length` in the unit of the averages, `t_squared`,
            and `p`, corrected for the number of points.
        """
        pandas = imported("pandas", "a frame")
        for pair in self.document["pairs"]:
            if first in (None, pair["first"]) and second in (None, pair["second"]):
                frame = pandas.DataFrame(pair["effect"])
                for name in ("point", "difference"):
                    columns = np.array(frame.pop(name).tolist())
                    for axis in range(columns.shape[1]):
                        frame[f"{name}.{axis}"] = columns[:, axis]
                return cast("pd.DataFrame", frame)
        pairs = ", ".join(f"{pair['first']} and {pair['second']}" for pair in self.document["pairs"])
        expect(False, f"expected one of the pairs {pairs}, got {first} and {second}")
        raise AssertionError

    @property
    def warnings(self) -> list[str]:
        """What should be known of the comparison."""
        return self.document["warnings"]

    def plot(self, **style: Any) -> Figure:
        """Draws the averages of the groups, and a map of the effect for each pair."""
        from . import plot

        return plot.comparison(self, **style)


@dataclass
class LinearModel:
    """A linear model of the shapes of a cohort.

    Attributes
    ----------
    document : ShapeModel
        The whole answer.
    predictions : Outlines or None
        Predicted shapes, in the order of `document["predictions"]`; None where numbers are modelled.
    """

    document: t.ShapeModel
    predictions: Outlines | None

    @property
    def table(self) -> pd.DataFrame:
        """Analysis of variance, a row a term: df, sums of squares, R², F, Z and p; then the residual and the total."""
        pandas = imported("pandas", "a frame")
        names = ("df", "sum_of_squares", "mean_square", "r_squared", "partial_eta_squared", "f", "z", "p")
        entries: list[Mapping[str, Any]] = [*self.document["terms"]]
        entries += [cast("Mapping[str, Any]", self.document[name]) for name in ("residual", "total")]
        rows = [{name: entry.get(name) for name in names} for entry in entries]
        index = [*(term["term"] for term in self.document["terms"]), "residual", "total"]
        return cast("pd.DataFrame", pandas.DataFrame(rows, index=index))

    @property
    def coefficients(self) -> dict[str, Floats | float | None]:
        """Coefficients by columns of the design: displacements of the control points, of shape (N, d), or numbers."""
        found: dict[str, Floats | float | None] = {}
        for entry in self.document["coefficients"]:
            shape = entry.get("shape")
            found[entry["column"]] = entry.get("value") if shape is None else np.asarray(shape, dtype=np.float64)
        return found

    @property
    def labels(self) -> list[str]:
        """Values at which the shapes are predicted, as one text each."""
        return [
            ", ".join(f"{name}={short(value)}" for name, value in cast("dict[str, Any]", entry["at"]).items())
            for entry in self.document["predictions"]
        ]

    @property
    def warnings(self) -> list[str]:
        """What should be known of the model."""
        return self.document["warnings"]

    def plot(self, ax: Axes | None = None, **style: Any) -> Figure:
        """Draws the predicted shapes."""
        from . import plot

        expect(self.predictions is not None, "expected a model of shapes, got one of numbers")
        return plot.outlines(cast(Outlines, self.predictions), ax, labels=self.labels, **style)


@dataclass
class Morphospace:
    """Shapes at their scores.

    Attributes
    ----------
    frame : DataFrame
        Scores of the shapes: columns `score.1`, …, and attributes.
    components : (int, int)
        Components along x and y, from 1.
    at : ndarray of shape (n, 2)
        Scores at which shapes are drawn.
    outlines : Outlines
        These shapes.
    explained : ndarray of shape (2,)
        Fraction of the variation that each component explains.
    """

    frame: pd.DataFrame
    components: tuple[int, int]
    at: Floats
    outlines: Outlines
    explained: Floats

    def plot(self, ax: Axes | None = None, *, by: str | None = None, **style: Any) -> Figure:
        """Draws the scores as points and the shapes behind them; `by` names the column that gives the colours."""
        from . import plot

        return plot.morphospace(self, ax, by=by, **style)


@dataclass
class Added:
    """What became of shapes that were added.

    Attributes
    ----------
    added, unchanged, skipped : int
        Numbers of new shapes, of those that stand in the cohort already, and of those left out under `on_error="skip"`.
    revision : int
        Revision of the cohort afterwards.
    ids : list of str or None
        Ids of the stored shapes with `returns="ids"`, None where one was left out.
    faults : list of dict
        Entries of the shapes that were not stored, with their `index` and `error`.
    warnings : list of str
        Of the service.
    """

    added: int = 0
    unchanged: int = 0
    skipped: int = 0
    revision: int = 0
    ids: list[str | None] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def take(self, answer: Mapping[str, Any], before: int) -> None:
        """Adds the answer to a part, before which so many shapes were sent."""
        self.added += answer["added"]
        self.unchanged += answer["unchanged"]
        self.skipped += answer["skipped"]
        self.revision = answer["revision"]
        self.ids += answer.get("ids") or []
        failed = [entry for entry in answer["results"] if "error" in entry]
        self.faults += [{**entry, "index": entry["index"] + before} for entry in failed]
        self.warnings += answer.get("warnings", [])


def short(value: object) -> str:
    """A number with four digits, anything else as text."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
