#!/usr/bin/env python3
"""Environments of Python packages, for the checks that need some.

    tests/environment.py FOLDER PACKAGE...      or `-r FILE`, as pip takes them

`created` makes one; `Unavailable` says why it cannot be had. As a program it ends with 1 then, with a line on standard
error.
"""

import importlib.util
import os
import pathlib
import shutil
import subprocess
import sys

# Seconds for one call of apt-get or pip: on a busy machine the largest take minutes.
PATIENCE = 900


class Unavailable(Exception):
    """Why there is no such environment."""


def last_line(text):
    """What a program said at last."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "it says nothing")


def run(command):
    """Runs a program that must succeed."""
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=PATIENCE,
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise Unavailable(f"{command[0]}: {error}") from error
    if done.returncode != 0:
        raise Unavailable(f"{pathlib.Path(command[0]).name} ended with {done.returncode}: {last_line(done.stdout)}")


def seeded():
    """Whether this Python can make environments: Debian leaves that to a package of its own."""
    return all(importlib.util.find_spec(name) for name in ("venv", "ensurepip"))


def debian(*packages):
    """Installs packages of Debian, as apt-get takes them."""
    run([str(pathlib.Path(__file__).resolve().parent / "debian.sh"), *packages])


def prepare():
    """Sees to it that environments can be made, by that package where the rights are there."""
    if seeded():
        return
    if os.geteuid() == 0 and shutil.which("apt-get"):
        debian("python3-venv")
        importlib.invalidate_caches()
    if not seeded():
        raise Unavailable(f"{sys.executable} has no ensurepip (Debian: python3-venv)")


def created(folder, packages, options=()):
    """Python of a new environment in `folder` with these packages, as pip takes them."""
    folder = pathlib.Path(folder)
    prepare()
    shutil.rmtree(folder, ignore_errors=True)
    run([sys.executable, "-m", "venv", str(folder)])
    python = folder / "bin" / "python"
    if packages:
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *options]
        run([*pip, *(str(package) for package in packages)])
    return python


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    try:
        created(sys.argv[1], sys.argv[2:])
    except Unavailable as reason:
        shutil.rmtree(sys.argv[1], ignore_errors=True)
        sys.exit(f"{sys.argv[1]}: {reason}")


if __name__ == "__main__":
    main()
