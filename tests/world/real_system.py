"""Runs programs in the real system: a child for each, in a folder of its own.

``python real_system.py FILE``: each line of standard input names a function of FILE. Each line of standard
output is what it returned, in JSON.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import sys
import tempfile
import traceback

PATIENCE = 20
"""s after which a program is killed."""


def main() -> None:
    answers = os.dup(1)
    os.dup2(2, 1)
    spec = importlib.util.spec_from_file_location("programs", sys.argv[1])
    assert spec is not None
    assert spec.loader is not None
    programs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(programs)
    for line in iter(sys.stdin.readline, ""):
        with tempfile.TemporaryDirectory(prefix="crtk-real-") as folder:
            child = os.fork()
            if child == 0:
                signal.alarm(PATIENCE)
                os.chdir(folder)
                os.close(0)
                try:
                    found = {"result": getattr(programs, line.strip())()}
                except BaseException:
                    found = {"error": traceback.format_exc()}
                os.write(answers, json.dumps(found).encode() + b"\n")
                os._exit(0)
            _, status = os.waitpid(child, 0)
        if status:
            os.write(answers, json.dumps({"error": f"status {status}"}).encode() + b"\n")


if __name__ == "__main__":
    main()
