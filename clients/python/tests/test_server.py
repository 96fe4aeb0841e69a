"""Where the program is found, and how it ends."""

import os
import pathlib

import httpx
import pytest

from shapelex import NoServer, Server
from shapelex.server import find_binary


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """A world without a program."""
    for name in ("SHAPELEX_BINARY", "CARGO_TARGET_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shapelex.server.__file__", str(tmp_path / "site-packages" / "shapelex" / "server.py"))
    return tmp_path


def program(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


def test_the_order_of_the_search(bare, monkeypatch):
    assert find_binary() is None
    (bare / "openapi").mkdir()
    (bare / "openapi" / "openapi.json").write_text("{}")
    built = program(bare / "target" / "debug" / "shapelex")
    (bare / "docs").mkdir()
    monkeypatch.chdir(bare / "docs")
    assert find_binary() == built
    newer = program(bare / "target" / "release" / "shapelex")
    os.utime(built, (1, 1))
    assert find_binary() == newer
    on_path = program(bare / "bin" / "shapelex")
    monkeypatch.setenv("PATH", str(bare / "bin"))
    assert find_binary() == on_path
    named = program(bare / "named" / "shapelex")
    monkeypatch.setenv("SHAPELEX_BINARY", str(named))
    assert find_binary() == named
    assert find_binary(on_path) == on_path


def test_what_is_missing_is_told(bare, monkeypatch):
    with pytest.raises(NoServer, match="expected the program shapelex as an argument"):
        Server.start()
    monkeypatch.setenv("SHAPELEX_BINARY", "none/shapelex")
    with pytest.raises(NoServer, match="expected the program at none/shapelex, got no file there"):
        Server.start()


def test_a_program_that_ends_at_once_is_told(tmp_path):
    broken = tmp_path / "shapelex"
    broken.write_text("#!/bin/sh\necho 'the disk is full' >&2\nexit 1\n")
    broken.chmod(0o755)
    with pytest.raises(NoServer, match="the disk is full"):
        Server.start(broken)


def test_a_server_ends_with_its_data(shapelex_server):
    with Server.start(options=("--threads=1",)) as server:
        assert server.client().version()
        folder = pathlib.Path(server.data_dir)
        assert folder.exists()
    assert not folder.exists()
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"{server.url}/readyz", trust_env=False)


def test_data_in_a_named_folder_stay(shapelex_server, tmp_path):
    with Server.start(data_dir=tmp_path / "data", example=True) as server:
        assert server.client().cohort("example-cells").info()["shape_count"] == 120
    with Server.start(data_dir=tmp_path / "data") as server:
        assert server.client().cohort("example-cells").exists()


def test_a_running_service_is_taken_and_left_running(shapelex_server):
    with Server.start(url=shapelex_server.url) as server:
        assert server.pid is None and server.url == shapelex_server.url
    assert shapelex_server.client().version()


def test_settings_of_another_service_do_not_reach_it(shapelex_server, monkeypatch):
    monkeypatch.setenv("SHAPELEX_THREDS", "2")
    with Server.start() as server:
        assert server.client().version()
