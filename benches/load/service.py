"""The program as a process with a port and a folder of its own. Needs nothing beyond Python's library."""

import http.client
import json
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class Service:
    """The program on a port of its own."""

    def __init__(self, binary, folder, url=None, flags=()):
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            self.port = listener.getsockname()[1]
        self.command = [binary, "serve", "--listen", f"127.0.0.1:{self.port}", "--no-example", "--log", "warn", *flags]
        self.environment = {
            k: v for k, v in os.environ.items() if not k.startswith("SHAPELEX_") and k != "DATABASE_URL"
        }
        self.environment |= {"DATABASE_URL": url} if url else {"SHAPELEX_DATA_DIR": str(folder / "data")}
        self.process = None

    def start(self):
        """Milliseconds until it says that it is ready."""
        begin = time.perf_counter()
        self.process = subprocess.Popen(self.command, env=self.environment, stdout=subprocess.DEVNULL)
        while not self.is_ready():
            if self.process.poll() is not None or time.perf_counter() - begin > 120:
                raise SystemExit("the service does not start")
            time.sleep(0.001)
        return 1e3 * (time.perf_counter() - begin)

    def is_ready(self):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5)
        try:
            connection.request("GET", "/readyz")
            return connection.getresponse().status == 204
        except OSError:
            return False
        finally:
            connection.close()

    def stop(self, how=signal.SIGTERM):
        self.process.send_signal(how)
        self.process.wait(60)

    def megabytes(self, line="VmRSS"):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(next(row for row in status.splitlines() if row.startswith(line)).split()[1]) * 1024 / 1e6

    def call(self, method, path, body=None):
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=600)
        connection.request(
            method, path, None if body is None else json.dumps(body), {"content-type": "application/json"}
        )
        answer = connection.getresponse()
        text = answer.read()
        if answer.status >= 400:
            raise SystemExit(f"{method} {path}: {answer.status} {text[:1000]}")
        return json.loads(text) if text else None


def upload(port, cohort, path):
    """Sends a file of lines to a cohort as one request; seconds, and status and body of the answer."""
    begin, size = time.perf_counter(), path.stat().st_size
    with socket.create_connection(("127.0.0.1", port)) as connection, path.open("rb") as file:
        head = (
            f"POST /v1/cohorts/{cohort}/shapes HTTP/1.1\r\nhost: 127.0.0.1:{port}\r\nconnection: close\r\n"
            f"content-type: application/x-ndjson\r\ncontent-length: {size}\r\n\r\n"
        )
        connection.sendall(head.encode())
        connection.sendfile(file)
        response = http.client.HTTPResponse(connection)
        response.begin()
        return time.perf_counter() - begin, response.status, json.loads(response.read())


def prioritise(niceness):
    """Sets the priority of this process; whether that was allowed."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    except PermissionError:
        return False
    return True
