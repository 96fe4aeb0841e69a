#!/usr/bin/env python3
"""Runs the compiler for cargo (RUSTC_WRAPPER) and appends its cost to the file WEIGHT_LOG.

A line: crate, version, `test` or `-`, processor seconds, peak memory in kB.
"""

import os
import sys

command = sys.argv[1:]
child = os.fork()
if child == 0:
    os.execvp(command[0], command)
_, status, usage = os.wait4(child, 0)
# Questions to the compiler, such as its version, name no crate.
if "--crate-name" in command and (name := command[command.index("--crate-name") + 1]) != "___":
    shape = "test" if "--test" in command else "-"
    seconds = usage.ru_utime + usage.ru_stime
    row = [name, os.environ.get("CARGO_PKG_VERSION", ""), shape, f"{seconds:.2f}", str(usage.ru_maxrss)]
    # One write for each line: compilers of several crates append at the same time.
    log = os.open(os.environ["WEIGHT_LOG"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(log, ("\t".join(row) + "\n").encode())
sys.exit(os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else 1)
