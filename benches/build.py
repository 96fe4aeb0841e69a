"""Programs that cargo builds for measurements. Needs nothing beyond Python's library."""

import json
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def benches(*names):
    """Paths of these benchmarks, and of `shapelex` itself, built with optimisation."""
    command = ["cargo", "bench", "--locked", "--workspace", "--no-run", "--message-format", "json"]
    command += [word for name in names for word in ("--bench", name)]
    lines = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.splitlines()
    messages = [json.loads(line) for line in lines if line.startswith("{")]
    return {m["target"]["name"]: m["executable"] for m in messages if m.get("executable")}
