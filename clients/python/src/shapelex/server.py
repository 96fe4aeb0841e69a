"""A service of this machine, for notebooks and tests."""

from __future__ import annotations

import atexit
import os
import pathlib
import re
import shutil
import subprocess
import tempfile
import time
from types import TracebackType
from typing import IO, cast

import httpx
from typing_extensions import Self

from ._sync import Client
from .errors import ShapelexError

# Seconds in which a service must be ready: a store of gigabytes is checked at the start.
PATIENCE = 60.0


class NoServer(ShapelexError):
    """No program was found, or it ended before it was ready: what it said last is in the text."""


def find_binary(binary: str | os.PathLike[str] | None = None) -> pathlib.Path | None:
    """The program `shapelex`.

    The argument, `SHAPELEX_BINARY`, the package `shapelex-server`, the search path, then the newest build in a `target`
    folder of the checkout that holds the working folder or this package. What is named but does not exist is an error,
    not a reason to look on.
    """
    named = binary or os.environ.get("SHAPELEX_BINARY")
    if named:
        path = pathlib.Path(named).expanduser()
        if not path.is_file():
            raise NoServer(f"expected the program at {path}, got no file there")
        return path.resolve()
    if installed := of_package():
        return installed
    if found := shutil.which("shapelex"):
        return pathlib.Path(found)
    for start in (pathlib.Path.cwd(), pathlib.Path(__file__).resolve().parent):
        for folder in (start, *start.parents):
            target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", folder / "target"))
            builds = [target / profile / "shapelex" for profile in ("release", "dist", "debug")]
            present = [build for build in builds if build.is_file()]
            if present and (folder / "openapi" / "openapi.json").is_file():
                return max(present, key=lambda build: build.stat().st_mtime)
    return None


def of_package() -> pathlib.Path | None:
    """The program of the package `shapelex-server`, where that is installed."""
    try:
        import shapelex_server
    except ImportError:
        return None
    return cast("pathlib.Path | None", shapelex_server.binary())


class Server:
    """A service on this machine that ends with its owner.

    `Server.start()` makes one. It is a context manager; without `with` it is stopped when Python ends.

    Attributes
    ----------
    url : str
        Its address.
    data_dir : pathlib.Path or None
        Folder of its store; None of a service that was running already.
    """

    def __init__(
        self,
        url: str,
        process: subprocess.Popen[str] | None = None,
        data_dir: pathlib.Path | None = None,
        temporary: tempfile.TemporaryDirectory[str] | None = None,
    ) -> None:
        self.url, self.data_dir = url, data_dir
        self._process, self._temporary = process, temporary
        atexit.register(self.stop)

    @classmethod
    def start(
        cls,
        binary: str | os.PathLike[str] | None = None,
        *,
        url: str | None = None,
        data_dir: str | os.PathLike[str] | None = None,
        example: bool = False,
        options: tuple[str, ...] = (),
    ) -> Server:
        """Starts a service, or takes one that is running.

        Parameters
        ----------
        binary : path, optional
            The program. Default: as `find_binary` finds it.
        url : str, optional
            Address of a service that is taken, and not stopped, if it runs: else one is started there.
        data_dir : path, optional
            Folder of the store. Default: a new one that is removed in the end.
        example : bool
            Whether an empty store gets the example cohort `example-cells` of 120 outlines.
        options : tuple of str
            Further options of `shapelex serve`, such as `"--threads=1"`.

        Raises
        ------
        NoServer
            Without a program, or if it does not start.
        """
        if url and is_ready(url):
            return cls(url.rstrip("/"))
        program = find_binary(binary)
        if program is None:
            raise NoServer(
                "expected the program shapelex as an argument, in SHAPELEX_BINARY, of the package shapelex-server, on "
                "the search path or in the target folder of a checkout, got none of them"
            )
        temporary = None if data_dir else tempfile.TemporaryDirectory(prefix="shapelex-", ignore_cleanup_errors=True)
        folder = pathlib.Path(data_dir or pathlib.Path(temporary.name if temporary else "") / "data")
        listen = httpx.URL(url).netloc.decode() if url else "127.0.0.1:0"
        command = [str(program), "serve", f"--listen={listen}", f"--data-dir={folder}", "--log=warn", *options]
        command += [] if example else ["--no-example"]
        # Settings of another service would be refused, or would change this one.
        kept = {name: value for name, value in os.environ.items() if not name.startswith("SHAPELEX_")}
        log = tempfile.TemporaryFile("w+")
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, env=kept, text=True
        )
        address = address_of(process, log)
        server = cls(address, process, folder, temporary)
        if not is_ready(address, PATIENCE):
            server.stop()
            raise NoServer(f"expected {address} to be ready within {PATIENCE:.0f} s: {ending(log)}")
        return server

    def client(self, key: str | None = None) -> Client:
        """A client of this service."""
        return Client(self.url, key)

    @property
    def pid(self) -> int | None:
        """Process of the service that was started here."""
        return self._process.pid if self._process else None

    def stop(self) -> None:
        """Ends the service that was started here, and removes its store unless that has a folder from you."""
        atexit.unregister(self.stop)
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout:
                process.stdout.close()
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def __repr__(self) -> str:
        return f"<Server {self.url}, {'running' if self._process else 'not started here'}>"


def address_of(process: subprocess.Popen[str], log: IO[str]) -> str:
    """The address that the program prints when it listens."""
    line = process.stdout.readline() if process.stdout else ""
    found = re.search(r" on (https?://\S+)", line)
    if not found:
        process.kill()
        process.wait()
        raise NoServer(f"expected an address from {process.args!r}, got {line.strip() or ending(log)}")
    return found.group(1)


def is_ready(url: str, seconds: float = 0.0) -> bool:
    """Whether a service answers at an address, within so many seconds."""
    end = time.monotonic() + seconds
    with httpx.Client(trust_env=False, timeout=2.0) as http:
        while True:
            try:
                if http.get(f"{url.rstrip('/')}/readyz").is_success:
                    return True
            except httpx.TransportError:
                pass
            if time.monotonic() >= end:
                return False
            time.sleep(0.02)


def ending(log: IO[str]) -> str:
    """The last lines of a log."""
    log.seek(0)
    lines = log.read().strip().splitlines()
    return " / ".join(lines[-5:]) or "it said nothing"
