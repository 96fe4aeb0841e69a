"""The programs that a run starts and kills: replicas of the service, and a PostgreSQL of its own."""

import http.client
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

START = 90
STOP = 40


def free_port():
    """A port that nobody listens on now."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def wait_until(true, seconds, what):
    """Waits for something that should come soon."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            raise SystemExit(f"{what}: not within {seconds} s")
        time.sleep(0.02)


class Replica:
    """The program on a port of its own; it may be killed and started again at any time."""

    def __init__(self, binary, folder, number, settings):
        self.port = free_port()
        self.command = [binary, "serve", "--listen", f"127.0.0.1:{self.port}", "--no-example"]
        self.log = Path(folder) / f"replica-{number}.log"
        self.environment = {
            k: v for k, v in os.environ.items() if not k.startswith("SHAPELEX_") and k != "DATABASE_URL"
        }
        self.environment |= {"SHAPELEX_LOG": "info", "SHAPELEX_DATA_DIR": str(Path(folder) / "data"), **settings}
        self.process = None

    def start(self):
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(self.command, env=self.environment, stdout=subprocess.DEVNULL, stderr=log)

    def is_ready(self):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=2)
        try:
            connection.request("GET", "/readyz")
            return connection.getresponse().status == 204
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()

    def wait(self):
        """Until it answers; it must not have ended by itself."""

        def answers():
            if self.process.poll() is not None:
                raise SystemExit(
                    f"a replica ended by itself with {self.process.returncode}: {self.log.read_text()[-2000:]}"
                )
            return self.is_ready()

        wait_until(answers, START, "a replica starts")

    def kill(self):
        """As power loss does it to a process: nothing is flushed, nobody is told."""
        self.process.kill()
        self.process.wait()

    def stop(self):
        """As an operator does it; whether it ended as it should."""
        self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(STOP) == 0
        except subprocess.TimeoutExpired:
            self.kill()
            return False


class Postgres:
    """A cluster of its own in a folder; as root it runs as the user `postgres`, which it demands."""

    def __init__(self, folder):
        programs = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
        if not programs:
            raise SystemExit("no PostgreSQL here")
        self.programs, self.data, self.port = programs[-1], Path(folder) / "postgres", free_port()
        self.log = Path(folder) / "postgres.log"
        self.user = "postgres" if os.geteuid() == 0 else None
        if self.user:
            for path in (Path(folder), self.data):
                path.mkdir(exist_ok=True)
                shutil.chown(path, self.user)
        self.call("initdb", "--username=shapelex", "--auth=trust", "--data-checksums", "--pgdata", self.data)
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories="
        self.options = ["--pgdata", self.data, "--log", self.log, "--options", options, "--wait"]
        self.call("pg_ctl", "start", *self.options)
        self.call("createdb", "-h", "127.0.0.1", "-p", str(self.port), "-U", "shapelex", "shapelex")
        self.url = f"postgres://shapelex@127.0.0.1:{self.port}/shapelex"

    def call(self, program, *arguments):
        command = [self.programs / program, *arguments]
        # Its daemon would keep a pipe open.
        subprocess.run(
            command, check=True, user=self.user, cwd="/", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    def crash(self):
        """All its processes end at once, nothing is flushed; then it starts and recovers from its log."""
        self.call("pg_ctl", "restart", "--mode", "immediate", *self.options)

    def stop(self):
        self.call("pg_ctl", "stop", "--mode", "fast", "--pgdata", self.data, "--wait")
