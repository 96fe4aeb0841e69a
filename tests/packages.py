#!/usr/bin/env python3
"""Packages a program and tries the packages as a reader would: pip alone in an empty environment, dpkg, checksums.

    tests/packages.py [--program target/debug/shapelex]

The wheel is installed with the client, a service is started, and the first mean is asked for: at most a minute in all.
A debug program is packaged without its symbols. What a tool is missing for is skipped with a line.
"""

import argparse
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

import environment  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
# Seconds from `pip install` to the first mean. On a machine that is busy with other tests only the figure is told.
LIMIT = 60
FIRST_MEAN = """
import shapelex
with shapelex.Server.start(example=True) as server:
    mean = server.client().cohort("example-cells").mean("similarity")
    assert mean.n_shapes == 120, mean
print(server.url and shapelex.server.find_binary())
"""


def run(*command, **options):
    """Output of a command that must succeed."""
    done = subprocess.run(
        [str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-4000:]}"
    return done.stdout


def clean():
    """The environment without a program to be found."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("SHAPELEX", "CARGO", "PYTHON"))}
    return {**kept, "PYTHONDONTWRITEBYTECODE": "1"}


def check_wheel(out, work):
    """pip brings program and client, and the first mean comes within a minute."""
    (wheel,) = out.glob("*.whl")
    python = environment.created(work / "environment", [])
    begin = time.monotonic()
    run(python, "-m", "pip", "install", "--quiet", "--find-links", out, f"{ROOT / 'clients' / 'python'}[server]")
    installed = time.monotonic() - begin
    said = run(python, "-c", FIRST_MEAN, cwd=work, env=clean())
    seconds = time.monotonic() - begin
    assert str(work / "environment") in said, f"another program was started: {said}"
    idle = os.getloadavg()[0] < 2 * (os.cpu_count() or 1)
    print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, pip {installed:.0f} s, first mean after {seconds:.0f} s")
    assert seconds <= LIMIT or not idle, f"expected the first mean within {LIMIT} s, got it after {seconds:.0f} s"
    assert "shapelex" in run(python.parent / "shapelex", "--version")
    run(python, "-m", "pip", "uninstall", "--quiet", "--yes", "shapelex-server")
    assert not (python.parent / "shapelex").exists(), "the program stays when its package is removed"


def check_same(out, work, program):
    """The same inputs give the same bytes."""
    (wheel,) = out.glob("*.whl")
    texts = ["--licences", out / "licences.txt", "--sbom", out / "sbom.cdx.json"]
    run(sys.executable, ROOT / "deploy" / "wheel.py", program, "--out", work / "again", *texts)
    assert (work / "again" / wheel.name).read_bytes() == wheel.read_bytes(), "another wheel is made each time"


def check_debian(out, work):
    """The package has program, unit, settings, man pages and licences, and the program in it runs."""
    (package,) = out.glob("*.deb")
    fields = run("dpkg-deb", "--field", package)
    assert re.search(r"^Depends: libc6 \(>= \d+\.\d+\), libgcc-s1$", fields, re.MULTILINE), fields
    run("dpkg-deb", "--extract", package, work / "debian")
    wanted = ["usr/bin/shapelex", "lib/systemd/system/shapelex.service", "etc/shapelex/shapelex.toml"]
    wanted += ["usr/share/man/man1/shapelex.1.gz", "usr/share/doc/shapelex/copyright"]
    wanted += ["usr/share/doc/shapelex/licences.txt.gz", "usr/share/doc/shapelex/sbom.cdx.json"]
    missing = [name for name in wanted if not (work / "debian" / name).is_file()]
    assert not missing, f"{package.name} has no {', '.join(missing)}"
    unit = (work / "debian" / "lib/systemd/system/shapelex.service").read_text()
    assert "ExecStart=/usr/bin/shapelex serve" in unit, unit
    assert "shapelex" in run(work / "debian" / "usr/bin/shapelex", "--version")
    print(f"{package.name}: {package.stat().st_size / 1e6:.1f} MB")


def signing_key(work):
    """Variables with a key that is made for the test; none without openssl."""
    if not shutil.which("openssl"):
        return {}
    run("openssl", "genpkey", "-algorithm", "ed25519", "-out", work / "key.pem")
    return {"SIGNING_KEY": str(work / "key.pem")}


def check_sums(out):
    """Checksums fit, and so does their signature."""
    run("sha256sum", "--check", "--strict", "SHA256SUMS", cwd=out)
    if (out / "SHA256SUMS.sig").exists():
        verify = ["openssl", "pkeyutl", "-verify", "-rawin", "-pubin", "-inkey", "SHA256SUMS.pub"]
        run(*verify, "-in", "SHA256SUMS", "-sigfile", "SHA256SUMS.sig", cwd=out)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=TARGET / "debug" / "shapelex")
    program = parser.parse_args().program.resolve()
    for tool in ("cargo", "readelf", "strip", "sha256sum"):
        if not shutil.which(tool):
            print(f"SKIPPED: the packages, there is no {tool}")
            return
    if not program.exists():
        print("SKIPPED: the packages, the program is not built")
        return
    passed = failed = 0
    with tempfile.TemporaryDirectory(prefix="shapelex-packages-") as name:
        work = pathlib.Path(name)
        out, small = work / "packages", work / "shapelex"
        run("strip", "-o", small, program)
        variables = {**os.environ, **signing_key(work)}
        print(run(ROOT / "deploy" / "package.sh", small, out, env=variables).replace(f"{out}/", ""), end="")
        checks = [lambda: check_wheel(out, work), lambda: check_same(out, work, small), lambda: check_sums(out)]
        checks += [lambda: check_debian(out, work)] if shutil.which("dpkg-deb") else []
        for check in checks:
            try:
                check()
                passed += 1
            except environment.Unavailable as reason:
                print(f"SKIPPED: the wheel, no environment can be made: {reason}")
            except AssertionError as fault:
                failed += 1
                print(f"FAIL: {fault}")
    print(f"packages: {passed} passed, {failed} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
