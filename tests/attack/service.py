"""The program under attack: started with small bounds, watched through /proc, spoken to over loopback.

Used by tests/attack and benches/attack. Python's library only.
"""

import http.client
import json
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

# What a service built for tests may take until it answers, and until it has stopped.
START_SECONDS = 60
STOP_SECONDS = 60
# Bytes of an answer that are looked at; the rest is read and dropped.
KEPT_BYTES = 4 << 20
# How often memory is looked at where the kernel's own mark cannot be set back.
WATCH_SECONDS = 0.01
MIB = 1 << 20
# A process that takes more is ended before it takes the machine with it, by the bounds of a run.
KILL_BEYOND = {"small": 1 << 30, "full": 3 << 30}
# What no request may lead to.
LOG_FAULTS = re.compile(r"panicked|memory allocation of|stack overflow")


class Skipped(Exception):
    """What this machine cannot do."""


class Answer:
    """What came back: no status when nothing did in time, or when the connection broke."""

    def __init__(self, status, headers, body, size, seconds, error=None):
        self.status, self.headers, self.body, self.size = status, headers, body, size
        self.seconds, self.error = seconds, error

    def json(self):
        """The body as JSON; nothing when it is none."""
        try:
            return json.loads(self.body)
        except ValueError:
            return None


@lru_cache
def known_flags(binary):
    """The flags of `serve` that a program has: older ones lack some."""
    text = subprocess.run([binary, "serve", "--help"], capture_output=True, text=True, timeout=60).stdout
    return set(re.findall(r"--[a-z][a-z-]+", text))


def clean_environment(further=None):
    """Without settings of whoever runs this."""
    mine = {k: v for k, v in os.environ.items() if not k.startswith("SHAPELEX_") and k != "DATABASE_URL"}
    return {**mine, **(further or {})}


class Service:
    """One process on a store of its own, in a temporary folder that ends with it."""

    def __init__(self, binary, flags=(), folder=None, environment=None, max_bytes=None, file_bytes=None):
        self.binary = str(Path(binary).resolve())
        known = known_flags(self.binary)
        self.flags = [flag for flag in flags if flag.split("=")[0] in known]
        self.own_folder = folder is None
        self.folder = Path(folder or tempfile.mkdtemp(prefix="shapelex-attack-"))
        self.environment = clean_environment({"RUST_BACKTRACE": "0", **(environment or {})})
        self.max_bytes, self.file_bytes = max_bytes, file_bytes
        self.process, self.address, self.idle, self.log = None, None, 0, self.folder / "log"
        self.fault_mark = 0

    def limits(self):
        """Run in the new process: bounds of the kernel's own."""
        if self.max_bytes:
            resource.setrlimit(resource.RLIMIT_AS, (self.max_bytes, self.max_bytes))
        if self.file_bytes:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self.file_bytes, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def lift_file_bound(self):
        """Files may grow again, as if somebody had made room on the disk."""
        most = resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE)[1]
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (most, most))

    def start(self):
        """Waits for the line with its address, then for readiness."""
        command = [
            self.binary,
            "serve",
            "--listen=127.0.0.1:0",
            f"--data-dir={self.folder}/data",
            "--log=warn",
            *self.flags,
        ]
        log = open(self.log, "ab")
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=log,
            stdin=subprocess.DEVNULL,
            env=self.environment,
            preexec_fn=self.limits,
            text=True,
        )
        log.close()
        line = self.process.stdout.readline()
        if " on http" not in line:
            raise RuntimeError(f"the service does not start: {self.log.read_text()[-1000:]}")
        host, port = line.split("://")[1].strip().split(":")
        self.address = (host, int(port))
        end = time.monotonic() + START_SECONDS
        while self.ready() != 204:
            if time.monotonic() > end or self.ended():
                raise RuntimeError("the service is not ready")
            time.sleep(0.01)
        self.idle = self.resident()
        return self

    def ended(self):
        """Whether the process is gone."""
        return self.process is None or self.process.poll() is not None

    def ready(self, timeout=5):
        """The status of /readyz, or nothing."""
        return self.send("GET", "/readyz", timeout=timeout).status

    def stop(self):
        """As an operator does it; its exit code, or nothing when it had to be killed."""
        if self.process is None:
            return None
        code = self.process.poll()
        if code is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                code = self.process.wait(STOP_SECONDS)
            except subprocess.TimeoutExpired:
                self.kill()
        return code

    def kill(self):
        """At once."""
        if self.process and self.process.poll() is None:
            self.process.kill()
        if self.process:
            self.process.wait()

    def remove(self):
        """Ends the process and removes its folder."""
        self.kill()
        if self.process and self.process.stdout:
            self.process.stdout.close()
        if self.own_folder:
            shutil.rmtree(self.folder, ignore_errors=True)

    def command(self, *arguments, timeout=120):
        """One of the other commands, on the same store."""
        command = [self.binary, *arguments, f"--data-dir={self.folder}/data"]
        return subprocess.run(command, capture_output=True, text=True, env=self.environment, timeout=timeout)

    def key(self, name, role, tenant="default"):
        """A new key as a header."""
        done = self.command("key", "create", f"--name={name}", f"--role={role}", f"--tenant={tenant}")
        if done.returncode:
            raise RuntimeError(f"no key: {done.stderr}")
        return {"authorization": f"Bearer {done.stdout.strip()}"}

    def status_line(self, name):
        """A figure of /proc/PID/status in bytes."""
        try:
            for line in Path(f"/proc/{self.process.pid}/status").read_text().splitlines():
                if line.startswith(name + ":"):
                    return int(line.split()[1]) * 1024
        except OSError:
            pass
        return 0

    def resident(self):
        """Bytes that it has in memory now."""
        return self.status_line("VmRSS")

    def cpu(self):
        """Seconds of processor time so far: by ticks of the kernel, or by its finer clocks where it shows them."""
        try:
            fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def faults(self):
        """New lines of the log that tell of a panic since this was asked last."""
        try:
            with self.log.open("rb") as log:
                log.seek(self.fault_mark)
                text = log.read()
                self.fault_mark += len(text)
        except OSError:
            return []
        return [line for line in text.decode(errors="replace").splitlines() if LOG_FAULTS.search(line)]

    def send(self, method, path, body=None, headers=None, timeout=60, first=None):
        """One request on a connection of its own; never raises for what the service does."""
        return exchange(self.address, method, path, body, headers, timeout, first)

    def post(self, path, body, headers=None, timeout=60):
        """JSON, which must be taken."""
        answer = self.send(
            "POST", path, json.dumps(body).encode(), {"content-type": "application/json", **(headers or {})}, timeout
        )
        if answer.status is None or answer.status >= 300:
            raise RuntimeError(f"POST {path}: {answer.status} {answer.error or answer.body[:500]}")
        return answer.json()

    def quiet(self, seconds=1.0, share=0.1):
        """Whether it computes no more than a share of one processor over some seconds."""
        before = self.cpu()
        time.sleep(seconds)
        return self.cpu() - before <= share * seconds

    @contextmanager
    def watched(self, kill_beyond=None):
        """Peak memory and processor time of what is done inside; the process is killed beyond a bound."""
        watch = Watch(self, kill_beyond)
        watch.start()
        try:
            yield watch
        finally:
            watch.end()


class Watch(threading.Thread):
    """Looks at a process until told to stop."""

    def __init__(self, service, kill_beyond):
        super().__init__(daemon=True)
        self.service, self.kill_beyond, self.done = service, kill_beyond, threading.Event()
        self.marked = self.reset_mark()
        self.peak, self.killed, self.seconds = service.resident(), False, 0.0
        self.begin_cpu, self.begin = service.cpu(), time.monotonic()
        self.last_cpu = self.begin_cpu

    def reset_mark(self):
        """Sets the kernel's own mark of the peak back, where it lets us."""
        try:
            Path(f"/proc/{self.service.process.pid}/clear_refs").write_text("5")
            return True
        except OSError:
            return False

    def run(self):
        while not self.done.wait(WATCH_SECONDS):
            self.look()

    def look(self):
        """Notes the figures; a process that is gone has none, and what was seen last stays."""
        if self.service.ended():
            return
        mark = self.service.status_line("VmHWM") if self.marked else self.service.resident()
        self.peak, self.last_cpu = max(self.peak, mark), max(self.last_cpu, self.service.cpu())
        if self.kill_beyond and self.service.resident() > self.kill_beyond:
            self.killed = True
            self.service.process.kill()

    def end(self):
        self.done.set()
        self.join()
        self.look()
        self.seconds = time.monotonic() - self.begin

    @property
    def cpu(self):
        """Seconds of processor time while it was watched."""
        return self.last_cpu - self.begin_cpu

    @property
    def above_idle(self):
        """Bytes of the peak above what the service took when it had started."""
        return max(0, self.peak - self.service.idle)


def exchange(address, method, path, body=None, headers=None, timeout=60, first=None):
    """One request and its whole answer, of which the first megabytes are kept; the time is for all of it, that to its
    first bytes may be bounded on its own."""
    begin = time.monotonic()
    connection = http.client.HTTPConnection(*address, timeout=first or timeout)
    spent = lambda: time.monotonic() - begin
    try:
        try:
            connection.request(method, path, body, headers or {})
        except (BrokenPipeError, ConnectionResetError):
            # Refused before all of the body was taken: the answer may be there all the same.
            pass
        response = connection.getresponse()
        kept, size = [], 0
        # A stream of events has no end: it is there with its first bytes.
        if response.getheader("content-type", "").startswith("text/event-stream"):
            chunk = response.read1(1 << 16)
            return Answer(response.status, {}, chunk, len(chunk), spent())
        while chunk := response.read(1 << 16):
            if size < KEPT_BYTES:
                kept.append(chunk)
            size += len(chunk)
            if spent() > timeout:
                raise TimeoutError("the answer goes on")
        found = {name.lower(): value for name, value in response.getheaders()}
        return Answer(response.status, found, b"".join(kept), size, spent())
    except (OSError, http.client.HTTPException) as error:
        return Answer(None, {}, b"", 0, spent(), f"{type(error).__name__}: {error}")
    finally:
        connection.close()


def head(address, method, path, length, headers):
    """The first lines of a request, as bytes."""
    lines = [f"{method} {path} HTTP/1.1", f"host: {address[0]}:{address[1]}", f"content-length: {length}"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def send_and_leave(address, method, path, body, headers, seconds):
    """Sends a request, waits, and is gone before the answer."""
    with socket.create_connection(address, timeout=30) as connection:
        connection.sendall(head(address, method, path, len(body), headers) + body)
        time.sleep(seconds)
        # Gone at once, without a farewell that could wait.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")


def percentile(values, q):
    """The `q`-th percentile of values that need not be in order; nothing of none."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(q / 100 * len(ordered)))] if ordered else None
