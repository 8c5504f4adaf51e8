"""What a program does to the files in a folder, seen through Python's audit events."""

import os
import sys
from contextlib import contextmanager
from pathlib import Path

_WATCH = {"folder": None, "before": None}


def _heard(event, args):
    folder = _WATCH["folder"]
    if folder is None or event not in ("open", "os.rename", "os.remove", "os.truncate"):
        return
    if event == "open" and not _writes(args):
        return
    paths = [os.path.abspath(os.fsdecode(a)) for a in args[: 1 + (event == "os.rename")]
             if isinstance(a, (str, bytes, os.PathLike))]  # fmt: skip
    if any(path.startswith(folder + os.sep) for path in paths):
        _WATCH["before"](event, paths)


def _writes(args):
    """Whether an open is one for writing; descriptors that are opened again are not."""
    _, mode, flags = args
    return (isinstance(mode, str) and set(mode) & set("wax+")) or (
        isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR) != 0
    )


sys.addaudithook(_heard)


@contextmanager
def watched(folder, before):
    """Call `before(event, paths)` ahead of each change below the folder; it may raise."""
    _WATCH.update(folder=os.path.abspath(folder), before=before)
    try:
        yield
    finally:
        _WATCH.update(folder=None, before=None)


def hidden(path, folder):
    """Whether some part of a path below the folder is hidden: it is still being written."""
    return any(part.startswith(".") for part in Path(path).relative_to(folder).parts)


def contents(folder):
    """Bytes of every file below a folder that is not hidden."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file() and not hidden(path, folder)
    }


class Renamed:
    """Tells files that were renamed into place, by themselves or in a folder, from all others."""

    def __init__(self, folder):
        self.folder, self.places, self.opened = os.path.abspath(folder), set(), set()
        self.old = {p: p.stat().st_mtime_ns for p in Path(folder).rglob("*") if p.is_file()}

    def __call__(self, event, paths):
        if event == "os.rename":
            self.places.add(paths[1])
        elif event == "open" and not hidden(paths[0], self.folder):
            self.opened.add(paths[0])

    def written_in_place(self, growing=()):
        """Files that are new or changed and were not renamed; `growing` may be names of some."""
        bad = set(self.opened)
        for path in Path(self.folder).rglob("*"):
            if not path.is_file() or self.old.get(path) == path.stat().st_mtime_ns:
                continue
            here = {str(path), *(str(p) for p in path.parents)}
            if not here & self.places:
                bad.add(str(path))
        return {Path(p).relative_to(self.folder).as_posix() for p in bad
                if not any(part in growing for part in Path(p).parts)}  # fmt: skip
