"""Figures of matplotlib: means, modes, morphospaces, maps of effects, surfaces.

Every function takes axes, or makes a figure, and returns the figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from ._reply import expect, imported
from .results import Comparison, Modes, Morphospace, Outlines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours that people with any kind of colour vision tell apart (Okabe and Ito 2008).
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
GREY = "#9a9a9a"


def new_figure(rows: int = 1, columns: int = 1, *, size: float = 3.2, solid: bool = False) -> tuple[Figure, Any]:
    """A figure and its axes, an array of shape (rows, columns), in space if the shapes are solid."""
    pyplot = imported("matplotlib.pyplot", "a picture")
    keywords = {"subplot_kw": {"projection": "3d"}} if solid else {}
    figure, axes = pyplot.subplots(
        rows, columns, figsize=(size * columns, size * rows), squeeze=False, layout="constrained", **keywords
    )
    return figure, axes


def of_axes(ax: Axes | None, shown: Outlines) -> tuple[Figure, Any]:
    """The figure of given axes, or new ones for the shapes."""
    if ax is not None:
        return cast("Figure", ax.get_figure()), ax
    figure, axes = new_figure(size=4.5, solid=not shown.flat)
    return figure, axes[0, 0]


def draw(ax: Any, shown: Outlines, k: int = 0, **style: Any) -> None:
    """Draws one shape: a line for a curve, points for landmarks, a lit mesh for a surface.

    Parameters
    ----------
    ax : Axes
        Axes in the plane or in space, as the shape is.
    shown : Outlines
        The shapes.
    k : int
        Which one.
    **style
        `color`, `linewidth`, `alpha`, `label` as matplotlib takes them.
    """
    points = shown.points[k]
    if shown.kind in ("surface", "subdivision"):
        rows = points.reshape(-1, 3)
        alpha, colour = style.get("alpha", 1.0), style.get("color", COLOURS[0])
        ax.plot_trisurf(*rows.T, triangles=shown.triangles(), color=colour, alpha=alpha, linewidth=0, shade=True)
        return
    if shown.kind == "landmarks":
        size = 4.0 * style.pop("linewidth", 1.5) ** 2
        ax.scatter(*points.T, s=size, **style)
        return
    ring = np.concatenate([points, points[:1]]) if shown.kind == "closed_curve" else points
    ax.plot(*ring.T, **{"solid_joinstyle": "round", **style})


def tidy(ax: Any, flat: bool, *, bare: bool = True) -> None:
    """Gives both axes one scale, and takes the frame away."""
    if flat:
        ax.set_aspect("equal", adjustable="datalim")
    else:
        ax.set_aspect("equal")
    if bare:
        ax.set_axis_off()


def outlines(shown: Outlines, ax: Axes | None = None, *, labels: Sequence[str] | None = None, **style: Any) -> Figure:
    """Draws shapes over one another.

    Parameters
    ----------
    shown : Outlines
        The shapes.
    ax : Axes, optional
        Default: new ones.
    labels : sequence of str, optional
        A name for each shape, for the legend.
    **style
        As `draw` takes it.
    """
    figure, axes = of_axes(ax, shown)
    for k in range(len(shown)):
        own: dict[str, Any] = {"color": COLOURS[k % len(COLOURS)], "linewidth": 1.5}
        own |= {"label": labels[k]} if labels else {}
        own |= {"alpha": 0.6} if len(shown) > 1 and not shown.flat else {}
        draw(axes, shown, k, **{**own, **style})
    tidy(axes, shown.flat)
    if labels and shown.kind not in ("surface", "subdivision"):
        axes.legend(frameon=False, fontsize="small")
    return figure


def same_limits(axes: NDArray[Any], points: NDArray[np.float64]) -> None:
    """Gives all axes the limits of the points, so that sizes can be compared."""
    rows = points.reshape(-1, points.shape[-1])
    low, high = rows.min(axis=0), rows.max(axis=0)
    margin = 0.05 * float((high - low).max())
    for ax in axes.ravel():
        for axis, name in enumerate("xyz"[: points.shape[-1]]):
            getattr(ax, f"set_{name}lim")(low[axis] - margin, high[axis] + margin)


def modes(found: Modes, *, size: float = 1.9, **style: Any) -> Figure:
    """Draws a row of shapes for each mode, from few to many standard deviations, with the mean in grey behind.

    Parameters
    ----------
    found : Modes
        The modes.
    size : float
        Inches of one shape.
    **style
        As `draw` takes it.
    """
    mean, flat = found.mean, found.mean.flat
    figure, axes = new_figure(len(found.steps), len(found.sigmas), size=size, solid=not flat)
    everything = np.concatenate([step.points for step in found.steps])
    for row, step in enumerate(found.steps):
        for column, sigma in enumerate(found.sigmas):
            ax = axes[row, column]
            if flat:
                draw(ax, mean, color=GREY, linewidth=1.0)
            draw(ax, step, column, **{"color": COLOURS[0] if sigma <= 0 else COLOURS[1], "linewidth": 1.5, **style})
            title = (f"{sigma:+g} σ" if sigma else "mean") if row == 0 else ""
            if column == 0:
                title = f"mode {found.components[row]}: {found.explained[row]:.0%}\n{title}".rstrip()
            ax.set_title(title, fontsize="small")
            ax.set_axis_off()
    same_limits(axes, everything)
    for ax in axes.ravel():
        ax.set_aspect("equal")
    return figure


def comparison(found: Comparison, *, size: float = 4.2, **style: Any) -> Figure:
    """Draws the averages of the groups, and for each pair where they differ.

    Parameters
    ----------
    found : Comparison
        The comparison.
    size : float
        Inches of one picture.
    **style
        As `draw` takes it.
    """
    pairs, shown = found.document["pairs"], found.averages
    names = [group["name"] for group in found.document["groups"]]
    columns = min(len(pairs) + 1, 4)
    rows = -(-(len(pairs) + 1) // columns)
    figure, axes = new_figure(rows, columns, size=size, solid=not shown.flat)
    flat = axes.ravel()
    outlines(shown, flat[0], labels=names, **style)
    flat[0].set_title("averages of the groups", fontsize="small")
    for ax, pair in zip(flat[1:], pairs):
        effect(found, pair["first"], pair["second"], ax)
    for ax in flat[len(pairs) + 1 :]:
        ax.set_axis_off()
    return figure


def effect(found: Comparison, first: str | None = None, second: str | None = None, ax: Axes | None = None) -> Figure:
    """Draws where two groups differ: the average of the first one, coloured by the length of the difference.

    Arrows lead to the second one; points whose corrected p is at most 0.05 are ringed.

    Parameters
    ----------
    found : Comparison
        The comparison.
    first, second : str, optional
        Names of the groups. Default: the first pair.
    ax : Axes, optional
        Default: new ones.
    """
    frame, shown = found.effect(first, second), found.averages
    dimension = shown.points.shape[-1]
    points = frame[[f"point.{axis}" for axis in range(dimension)]].to_numpy(dtype=np.float64)
    difference = frame[[f"difference.{axis}" for axis in range(dimension)]].to_numpy(dtype=np.float64)
    figure, axes = of_axes(ax, shown)
    names = [group["name"] for group in found.document["groups"]]
    pair = next(
        pair for pair in found.document["pairs"] if first in (None, pair["first"]) and second in (None, pair["second"])
    )
    if shown.flat:
        draw(axes, shown, names.index(pair["first"]), color=GREY, linewidth=1.0)
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004, "color": GREY}
        axes.quiver(*points.T, *difference.T, **arrows)
    else:
        axes.quiver(*points.T, *difference.T, color=GREY, linewidth=0.8)
    axes.margins(0.12)
    lengths = frame["length"].to_numpy(dtype=np.float64)
    drawn = axes.scatter(*points.T, c=lengths, cmap="viridis", vmin=0.0, s=18, zorder=3)
    if "p" in frame and (clear := frame["p"].to_numpy(dtype=np.float64) <= 0.05).any():
        axes.scatter(*points[clear].T, s=44, facecolors="none", edgecolors=COLOURS[1], linewidths=1.2, zorder=4)
    figure.colorbar(drawn, ax=axes, shrink=0.6).set_label("length of the difference", fontsize="small")
    p = pair["pseudo_f"]["test"].get("p")
    said = "" if p is None else f", p = {p:.3g}"
    axes.set_title(f"{pair['first']} → {pair['second']}{said}", fontsize="small")
    tidy(axes, shown.flat)
    return figure


def morphospace(found: Morphospace, ax: Axes | None = None, *, by: str | None = None, **style: Any) -> Figure:
    """Draws the scores of shapes as points, and shapes of the plane at their scores behind them.

    Parameters
    ----------
    found : Morphospace
        Scores and shapes.
    ax : Axes, optional
        Default: new ones.
    by : str, optional
        Column of the frame whose values have colours. Default: none.
    **style
        Of the points, as `Axes.scatter` takes it.
    """
    expect(found.outlines.flat, "expected shapes in the plane, got shapes in space: draw them with plot.outlines")
    figure, axes = of_axes(ax, found.outlines)
    points = found.outlines.points
    centred = points - points.mean(axis=1, keepdims=True)
    steps = [np.diff(np.unique(found.at[:, axis])).min() if np.ptp(found.at[:, axis]) else 1.0 for axis in (0, 1)]
    extents = np.ptp(centred, axis=1).max(axis=0)
    # One factor for both axes keeps the shapes as they are: the axes have one scale.
    factor = 0.8 * float(min(step / extent for step, extent in zip(steps, extents)))
    placed = Outlines(centred * factor + found.at[:, None, :], found.outlines.kind)
    for k in range(len(placed)):
        draw(axes, placed, k, color=GREY, linewidth=1.0, zorder=1)
    x, y = (found.frame[f"score.{k}"].to_numpy(dtype=np.float64) for k in found.components)
    groups = [None] if by is None else list(found.frame[by].dropna().unique())
    for place, group in enumerate(groups):
        mask = np.ones(len(x), dtype=bool) if group is None else (found.frame[by] == group).to_numpy()
        colour = COLOURS[place % len(COLOURS)]
        own = {"s": 14, "color": colour, "zorder": 2, "label": None if group is None else str(group), **style}
        axes.scatter(x[mask], y[mask], **own)
    if by is not None:
        axes.legend(frameon=False, fontsize="small", title=by)
    for name, k, part in zip("xy", found.components, found.explained):
        getattr(axes, f"set_{name}label")(f"component {k} ({part:.0%})")
    axes.locator_params(nbins=5)
    tidy(axes, True, bare=False)
    return figure


def surface(
    shown: Outlines, ax: Axes | None = None, *, k: int = 0, values: NDArray[np.float64] | None = None, **style: Any
) -> Figure:
    """Draws a surface, coloured by values where there are any.

    Parameters
    ----------
    shown : Outlines
        Surfaces.
    ax : Axes, optional
        Default: new ones in space.
    k : int
        Which one.
    values : ndarray of as many numbers as the surface has points, optional
        Such as lengths of an effect.
    **style
        As `plot_trisurf` takes it.
    """
    figure, axes = of_axes(ax, shown)
    rows, faces = shown.points[k].reshape(-1, 3), shown.triangles()
    if values is None:
        draw(axes, shown, k, **style)
    else:
        numbers = np.asarray(values, dtype=np.float64).ravel()
        expect(len(numbers) == len(rows), f"expected {len(rows)} values, got {len(numbers)}")
        drawn = axes.plot_trisurf(*rows.T, triangles=faces, linewidth=0, **{"cmap": "viridis", **style})
        drawn.set_array(numbers[faces].mean(axis=1))
        drawn.autoscale()
        figure.colorbar(drawn, ax=axes, shrink=0.7)
    tidy(axes, False)
    return figure
