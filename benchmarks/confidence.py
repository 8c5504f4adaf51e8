"""Writes docs/confidence.md: every number of that page is measured here.

More is measured by `real.py`, `real_slide.py`, `outliers.py` and `nodes.py`, which need the public
recordings and take minutes.
"""

import argparse
import subprocess
import sys
from pathlib import Path

SECTIONS = ("invariance", "shapes")

TEXT = """\
# Is confidence true? Measured

Written by `python benchmarks/confidence.py`.

## What nodes and watching do to confidence

A still robot with a coil at its tip: standard deviation of position at mid-length and
mid-recording, and its change when something is doubled that tells nothing new there.

{invariance}

## Shapes of a physics that is not ours

{shapes}
"""


def measured(section):
    """What the script of a section prints."""
    script = Path(__file__).with_name(f"{section}.py")
    command = [sys.executable, "-W", "ignore", str(script)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/confidence.md"))
    options = parser.parse_args()
    found = {section: measured(section) for section in SECTIONS}
    options.page.write_text(TEXT.format(**found), encoding="utf-8")
    print(options.page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
