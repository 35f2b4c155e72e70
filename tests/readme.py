#!/usr/bin/env python3
"""Runs what the README tells to type.

Every `sh` block is run by a shell and every `python` block by this interpreter, in their order, while the
controller of the README's first command serves. HOST_SIM names the program. Left out: that first command itself
(it serves for ever) and tests/run.sh (this is one of its stages).
"""
import os
import re
import subprocess
import sys
import time
from pathlib import Path

SERVE = "cargo run --release -p host-sim"


def blocks(text):
    return re.findall(r"^```(sh|python)\n(.*?)^```", text, re.M | re.S)


def run(language, code):
    if language == "python":
        return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    lines = [line for line in code.splitlines() if line.split("#")[0].strip() not in (SERVE, "tests/run.sh")]
    return subprocess.run(["bash", "-euo", "pipefail", "-c", "\n".join(lines)], capture_output=True, text=True)


def main():
    readme = Path(sys.argv[1])
    os.chdir(readme.resolve().parent)
    text = readme.read_text(encoding="utf-8")
    assert re.search(rf"^{re.escape(SERVE)}\b", text, re.M), f"the README does not say {SERVE}"
    server = subprocess.Popen([os.environ["HOST_SIM"]], stdout=subprocess.PIPE, text=True)
    try:
        while "TCP" not in (line := server.stdout.readline()):
            assert line, "the server does not start: is port 5025 in use?"
        time.sleep(0.1)
        found = blocks(text)
        assert {language for language, _ in found} == {"sh", "python"}
        for language, code in found:
            done = run(language, code)
            print(f"--- {language}\n{code}--- gives\n{done.stdout}{done.stderr}")
            assert done.returncode == 0, f"this {language} block ends with {done.returncode}"
            if language == "python":
                told = [float(n) for n in re.search(r"POSE ([-\d.,]+)", code)[1].split(",")]
                stands = [float(n) for n in done.stdout.strip().split(";")[-1].split(",")]
                near = [0.05] * 3 + [0.0002] * 3  # um and degrees: half steps, and what they do to each other
                assert all(abs(a - b) < n for a, b, n in zip(told, stands, near, strict=True)), "the stage is elsewhere"
        assert server.poll() is None, "the server has ended"
    finally:
        server.kill()


if __name__ == "__main__":
    main()
