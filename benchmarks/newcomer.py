"""Time until a new user has a first estimate: the README's steps in a fresh clone.

Clones this checkout's last commit into a temporary folder, makes a virtual environment, installs,
runs the README's script and estimates a simulated recording with pictures. Prints seconds per step.
Usage: newcomer.py [EXTRAS], by default the README's `all`; needs a network for pip.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def steps(extras, clone, python, glissando):
    """Steps of the README in order: name and command."""
    script = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    yield "clone", ["git", "clone", "--quiet", "--depth", "1", ROOT.as_uri(), clone]
    yield "virtual environment", [sys.executable, "-m", "venv", clone / ".venv"]
    yield f"pip install .[{extras}]", [python, "-m", "pip", "install", "-q", f".[{extras}]"]
    yield "the README's script", [python, "-c", script[1]]
    simulate = ["simulate", "--shape", "S", "--slide", "oscillate", "--out", "my_recording"]
    yield "simulate a recording", [glissando, *simulate]
    yield "estimate it, with pictures", [glissando, "estimate", "my_recording", "--out", "results"]


def main(extras="all"):
    environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "glissando"
        bin_ = clone / ".venv" / ("Scripts" if os.name == "nt" else "bin")
        total = 0.0
        for name, command in steps(extras, clone, bin_ / "python", bin_ / "glissando"):
            where = clone if clone.exists() else folder
            start = time.perf_counter()
            done = subprocess.run(
                command, cwd=where, env=environment, capture_output=True, text=True, check=False
            )
            took = time.perf_counter() - start
            total += took
            print(f"{took:7.1f} s  {name}", flush=True)
            if done.returncode:
                sys.exit(f"{name} failed:\n{done.stderr}")
        picture = clone / "results" / "shape.png"
        print(f"{total:7.1f} s  in all; the first picture has {picture.stat().st_size:,} bytes")


if __name__ == "__main__":
    main(*sys.argv[1:])
