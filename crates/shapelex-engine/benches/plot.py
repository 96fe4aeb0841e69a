"""Draws processor time over the number of shapes, from the lines that the example `scale` prints.

    python3 crates/shapelex-engine/benches/plot.py LINES docs/pictures/scale.svg

Needs matplotlib.
"""

import json
import sys

import matplotlib
import matplotlib.pyplot as plot

matplotlib.rcParams["svg.hashsalt"] = "scale"


def main(lines, picture):
    rows = [json.loads(line) for line in open(lines) if line.startswith('{"digest"')]
    shapes, seconds = [row["shapes"] for row in rows], [row["processor_s"] for row in rows]
    figure, axes = plot.subplots(figsize=(6, 4), layout="constrained")
    axes.loglog(shapes, seconds, "o-", color="#0072b2", label="measured")
    slope = [seconds[-1] * n / shapes[-1] for n in shapes]
    axes.loglog(shapes, slope, "--", color="#d55e00", label="exponent 1")
    axes.set_xlabel("shapes of 64 points in the plane")
    axes.set_ylabel("processor time in s: mean and 20 components")
    axes.grid(True, which="major", color="#dddddd")
    axes.legend()
    figure.savefig(picture, metadata={"Date": None})


if __name__ == "__main__":
    main(*sys.argv[1:])
