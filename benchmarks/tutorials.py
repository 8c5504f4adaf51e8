"""Run the tutorials unchanged and save their pictures: `python benchmarks/tutorials.py`."""

import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"


def run(page, folder):
    """Run the code blocks of a page in order, with shared names, inside a folder."""
    names = {"__name__": "tutorial"}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for block in re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL):
            exec(compile(block, page.name, "exec"), names)
    finally:
        os.chdir(before)


def main(pages):
    for page in pages:
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            run(page, folder)
            print(f"{page.name}: {time.perf_counter() - start:.1f} s")
            for name in re.findall(r"!\[[^\]]*\]\(([\w.-]+)\)", page.read_text()):
                shutil.copy(Path(folder) / name, page.parent / name)


if __name__ == "__main__":
    main([Path(p).resolve() for p in sys.argv[1:]] or sorted(FOLDER.glob("*.md")))
