"""Time and memory against shapes, control points, atoms and clients, with the limits of the machine."""

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt  # noqa: E402

# Colours that readers with colour blindness tell apart; a light card that also reads on a dark page.
BLUE, ORANGE, GREEN, PINK, GREY = "#0072b2", "#d55e00", "#007a5a", "#a8527f", "#6b6b6b"
STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.facecolor": "#fbfbfa",
    "figure.facecolor": "#fbfbfa",
    "axes.edgecolor": "#8a8a88",
    "axes.grid": True,
    "grid.color": "#e2e2df",
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": "#22221f",
    "axes.labelcolor": "#22221f",
    "xtick.color": "#4a4a47",
    "ytick.color": "#4a4a47",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "shapelex",
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
}


def panels(*titles):
    figure, axes = plt.subplots(1, len(titles), figsize=(5 * len(titles), 4.3), layout="constrained")
    for axis, title in zip(axes, titles):
        axis.set_title(title)
        axis.set(xscale="log", yscale="log")
    return figure, axes


def line(axis, x, y, colour, label):
    axis.plot(x, y, color=colour, marker="o", markersize=3.5, linewidth=1.6, label=label)


def limit(axis, x, y, colour, label):
    axis.plot(x, y, color=colour, linestyle=(0, (4, 2)), linewidth=1.1, label=label)


def of(points, name, value):
    """Abscissas and values of the points that have one."""
    found = [(point[name], value(point)) for point in points if value(point) is not None]
    return [x for x, _ in found], [y for _, y in found]


def shapes(report):
    points = report["plots"]["shapes"]
    x = [p["shapes"] for p in points]
    figure, (time, memory) = panels("Time against shapes, curves of 32 points", "Peak memory against shapes")
    series = [
        ("upload", BLUE, "upload"),
        ("cyclic mean", ORANGE, "mean, start points searched"),
        ("mean, two passes", GREEN, "mean, points correspond"),
        ("search", PINK, "10 nearest"),
    ]
    for what, colour, label in series:
        line(time, *of(points, "shapes", lambda p: p.get(what)), colour, label)
    rows = {row["key"]: row for row in report["rows"]}
    shape = rows["ingest"]["bounds"]["2"] / 100_000 * 32 / 50
    limit(time, x, [n * shape for n in x], BLUE, "limit: parse or store alone")
    transform = 1e-9 * report["machine"]["complex transforms, ns"]["32"]
    searched = of(points, "shapes", lambda p: p["shapes"] * transform * p["rounds"] if "rounds" in p else None)
    limit(time, *searched, ORANGE, "limit: a transform a shape and round")
    last = points[-1]
    read = 2 * last["direct read"] / last["store"] * last["bytes"] / last["shapes"]
    limit(time, x, [n * read for n in x], GREEN, "limit: two reads past the cache")
    limit(time, x, [n * transform for n in x], PINK, "limit: a transform a shape")
    time.set(xlabel="shapes", ylabel="seconds")
    for what, colour, label in [
        ("upload", BLUE, "after the upload"),
        ("means", GREEN, "after means"),
        ("searches", PINK, "after searches"),
        ("cyclic mean", ORANGE, "after the mean with start points"),
    ]:
        line(memory, *of(points, "shapes", lambda p: p["megabytes"].get(what)), colour, label)
    limit(memory, x, [max(p["bytes"] / 1e6, 1) for p in points], GREY, "the points themselves")
    memory.set(xlabel="shapes", ylabel="MB", ylim=(10, None))
    return figure, (time, memory)


def control_points(report):
    points = report["plots"]["control points"]
    x, dgemm = [p["points"] for p in points], 1e9 * report["machine"]["dgemm, GF/s"]["2"]
    figure, (time, share) = panels("1000 curves, mean and 20 modes, two threads", "Time over the limit")
    curves = [
        (
            "landmarks",
            GREEN,
            "points correspond",
            [2 * p["shapes"] * (2 * p["points"]) ** 2 / dgemm for p in points],
            "limit: two sums at the rate of dgemm",
        ),
        (
            "cyclic",
            ORANGE,
            "start points searched",
            [p["shapes"] * p["cyclic rounds"] * p["transform"] / 2 for p in points],
            "limit: a transform a curve and round",
        ),
    ]
    for what, colour, label, bound, text in curves:
        line(time, x, [p[what] for p in points], colour, label)
        limit(time, x, bound, colour, text)
        line(share, x, [p[what] / b for p, b in zip(points, bound)], colour, label)
    time.set(xlabel="control points", ylabel="seconds")
    limit(share, x, [1] * len(x), GREY, "the limit")
    share.set(xlabel="control points", ylabel="times the limit")
    for axis in (time, share):
        axis.set_xticks(x, [str(n) for n in x])
    return figure, (time, share)


def atoms(report):
    points = report["plots"]["atoms"]
    x, dgemm = [p["atoms"] for p in points], 1e9 * report["machine"]["dgemm, GF/s"]["2"]
    figure, axes = panels("Lasso of a signal of 128 numbers", "Pursuit of 5 atoms of a signal")
    for axis, name in zip(axes, ("lasso", "pursuit")):
        line(axis, x, [1e6 * p[name] for p in points], BLUE, "Shapelex")
        line(axis, x, [1e6 * p[f"SPAMS {name}"] for p in points], ORANGE, "SPAMS")
        limit(
            axis,
            x,
            [1e6 * 2 * p["atoms"] * p["length"] / dgemm for p in points],
            GREY,
            "limit: products with all atoms, dgemm",
        )
        axis.set(xlabel="atoms", ylabel="µs a signal, two threads")
        axis.set_xticks(x, [str(n) for n in x])
    return figure, axes


def clients(report):
    points = report["plots"]["clients"]
    x = [p["connections"] for p in points]
    figure, (rate, latency) = panels("Requests a second", "Latency: median, and 99 % (thin)")
    for side, style in (("service", line), ("echo", limit)):
        for name, colour in (("project", BLUE), ("livez", ORANGE)):
            label = {"project": "/v1/project", "livez": "/livez"}[name] + (", axum echo" if side == "echo" else "")
            runs = [p[f"{side} {name}"] for p in points]
            style(rate, x, [run["rate"] for run in runs], colour, label)
            style(latency, x, [1e3 * run["p50"] for run in runs], colour, label)
            latency.plot(
                x,
                [1e3 * run["p99"] for run in runs],
                color=colour,
                linewidth=0.6,
                linestyle="-" if side == "service" else ":",
            )
    for axis in (rate, latency):
        axis.set(xlabel="connections")
        axis.set_xticks(x, [str(n) for n in x])
    rate.set(yscale="linear", ylim=(0, None), ylabel="requests a second")
    latency.set(ylabel="ms")
    return figure, (rate, latency)


def draw(report, folder):
    """Writes the pictures."""
    with plt.rc_context(STYLE):
        for name, make in (("shapes", shapes), ("points", control_points), ("atoms", atoms), ("clients", clients)):
            figure, axes = make(report)
            for axis in axes:
                axis.minorticks_off()
                axis.legend(
                    loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2, columnspacing=1.2, handlelength=1.8
                )
            figure.savefig(folder / f"performance-{name}.svg", metadata={"Date": None})
            plt.close(figure)
