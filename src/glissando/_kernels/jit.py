"""Kernels: functions that numba compiles when the first of them is called, and keeps on disk.

Importing a kernel costs nothing, and a process that calls none never imports numba. What is
compiled stands in a folder of its own for these sources, this numba and this Python, so an upgrade
never meets what was compiled before it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import update_wrapper
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # Windows: two processes at once may compile twice
    fcntl = None  # type: ignore[assignment]

_KERNELS: list[Kernel] = []
_LOCK = threading.RLock()
_NOTICE, _AGAIN = 1.0, 5.0  # seconds of compiling until a person reads why, and between lines


class Kernel:
    """A function to compile: `signatures` are the argument types it is called with, if any."""

    def __init__(self, function: Callable[..., Any], signatures: tuple[str, ...]) -> None:
        update_wrapper(self, function)
        self.function, self.signatures = function, signatures
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.compiled: Any = None
        _KERNELS.append(self)

    def compile(self) -> None:
        """Compile every signature, or load it from the cache, which calls find by types alone."""
        from numba.core.sigutils import normalize_signature

        for signature in self.signatures:
            self.compiled.compile(normalize_signature(signature)[0])

    def __call__(self, *arguments: Any) -> Any:
        if self.compiled is None:
            load()
        return self.compiled(*arguments)


class External:
    """A function of another library that kernels call, by its symbol and its type."""

    def __init__(self, symbol: str, signature: str) -> None:
        self.symbol, self.signature = symbol, signature

    def compiled(self) -> Any:
        """What numba takes for it."""
        from numba import types
        from numba.core.sigutils import normalize_signature

        arguments, returned = normalize_signature(self.signature)
        return types.ExternalFunction(self.symbol, returned(*arguments))


def jit(*signatures: str) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that makes a kernel; sums inside it may be done in any order.

    Args:
        signatures: Types of the arguments as numba writes them, of kernels that others call from
            Python; none for those that only kernels call.
    """
    return lambda function: Kernel(function, signatures)


def load() -> None:
    """Make every kernel callable: compile it, the first time on this machine, or load it."""
    with _LOCK:
        kernels, folder = _dispatchers()
        _compile_once(kernels, folder)


def compile_named(names: Sequence[str]) -> None:
    """Compile some kernels into the cache: what `load` asks of a second process.

    Args:
        names: Full names of kernels that have signatures.
    """
    for kernel in _dispatchers()[0]:
        if kernel.name in names:
            kernel.compile()


def _dispatchers() -> tuple[list[Kernel], Path]:
    """The kernels that numba has not met, made known to it and to one another; their cache."""
    import numba

    config: Any = numba.config
    kernels = [kernel for kernel in _KERNELS if kernel.compiled is None]
    folder, before = cache_folder(numba.__version__), config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        for kernel in kernels:
            kernel.compiled = numba.njit(
                cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"}
            )(kernel.function)
    finally:
        config.CACHE_DIR = before
    for kernel in kernels:
        for name, value in kernel.function.__globals__.items():
            if isinstance(value, Kernel):
                kernel.function.__globals__[name] = value.compiled
            elif isinstance(value, External):
                kernel.function.__globals__[name] = value.compiled()
    return kernels, folder


def _compile_once(kernels: list[Kernel], folder: Path) -> None:
    """Compile the given signatures unless an earlier process did, with a word if it takes long.

    Two processes compile and all others load, so that every process runs the same code: numba's
    own varies in the last digit with what is in its cache.
    """
    wanted = sorted((k for k in kernels if k.signatures), key=lambda kernel: kernel.name)
    if not _missing(wanted, folder):
        return
    over = threading.Event()
    threading.Thread(target=_say, args=(folder, over), daemon=True).start()
    try:
        with _locked(folder):
            missing = _missing(wanted, folder)  # another process may have compiled meanwhile
            half = len(missing) * 2 // 5  # modules apart, as kernels of one share what they call
            parts = [_compiling(names, folder) for names in (missing[:half], missing[half:])]
            for process in filter(None, parts):
                process.wait()
            for kernel in wanted:  # from the cache, or here if a process could not
                kernel.compile()
            with suppress(OSError), (folder / "compiled").open("a", encoding="utf-8") as file:
                file.write("".join(f"{name}\n" for name in missing))
    finally:
        over.set()


def _missing(kernels: list[Kernel], folder: Path) -> list[str]:
    """Names of kernels that no process has compiled yet."""
    compiled: set[str] = set()
    with suppress(OSError):
        compiled = set((folder / "compiled").read_text(encoding="utf-8").split())
    return [kernel.name for kernel in kernels if kernel.name not in compiled]


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let one process at a time compile, where the system has such locks."""
    with (folder / "lock").open("w") as file:
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _compiling(names: list[str], folder: Path) -> subprocess.Popen[bytes] | None:
    """A process that compiles kernels into the cache; None inside a program that is no Python."""
    if not names or "python" not in Path(sys.executable or "").name.lower():
        return None
    command = [sys.executable, "-m", "glissando._kernels.compile", *names]
    environment = {**os.environ, "GLISSANDO_CACHE": str(folder.parent)}
    nothing = subprocess.DEVNULL
    with suppress(OSError):
        return subprocess.Popen(
            command, env=environment, stdin=nothing, stdout=nothing, stderr=nothing
        )
    return None


def _say(folder: Path, over: threading.Event) -> None:
    """Say what is being compiled, and how much of it is done, until it is over."""
    began, wait = time.monotonic(), _NOTICE
    while not over.wait(wait):
        wait, elapsed = _AGAIN, time.monotonic() - began
        share = min(sum(1 for _ in folder.rglob("*.nbi")) / len(_KERNELS), 0.99)
        what = f"compiling its inner loops, once, into {folder}"
        if share > 0.0:
            what += f"; {100 * share:.0f} % done, about {elapsed * (1 / share - 1):.0f} s left"
        print(f"glissando: {what}", file=sys.stderr, flush=True)


def cache_folder(numba_version: str) -> Path:
    """The folder of what is compiled: the user's cache, or a temporary one where that fails.

    Args:
        numba_version: Version of the compiler.
    """
    digest = hashlib.sha256(f"{numba_version} {sys.version}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    name = f"kernels-{digest.hexdigest()[:16]}"
    given = os.environ.get("GLISSANDO_CACHE")
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    temporary = Path(tempfile.gettempdir()) / f"glissando-{getattr(os, 'getuid', int)()}"
    for root in (*([Path(given)] if given else []), Path(user) / "glissando", temporary):
        if _is_writable(root / name):
            _drop_others(root, name)
            return root / name
    return Path(tempfile.mkdtemp(prefix="glissando-"))


def _is_writable(folder: Path) -> bool:
    """Whether the folder is, or can be made, a place of this user's own to write to."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return False
    return not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()


def _drop_others(root: Path, name: str) -> None:
    """Remove what other versions compiled, but for the newest of them, which may be in use."""
    with suppress(OSError):
        others = [p for p in root.glob("kernels-*") if p.name != name]
        for folder in sorted(others, key=lambda p: p.stat().st_mtime)[:-1]:
            shutil.rmtree(folder, ignore_errors=True)
