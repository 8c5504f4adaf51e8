"""Kernels: functions that numba compiles when they are first called, and caches on disk.

Importing a kernel costs nothing, and a process that calls none never imports numba. An estimate
begins by loading all modules that it and its prior use, compiled in parallel; any other module is
compiled at the first call of one of its kernels, so that unused priors cost no time. Each cache
folder is for the path, time and content of these sources, a version of numba and one of Python, so
that neither an upgrade nor another copy of the package uses outdated code.
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

from glissando._kernels.memory import keep_freed_memory
from glissando._kernels.scratch import StackArray

try:
    import fcntl
except ImportError:  # Windows: two processes at once may compile twice
    fcntl = None  # type: ignore[assignment]

_KERNELS: list[Kernel] = []
_NAMED: set[Path] = set()  # cache folders that messages of this process have named
_LOCK = threading.RLock()
_NOTICE, _AGAIN = 1.0, 5.0  # seconds of compiling until a first message, and until others
_PROCESSES = 4  # largest number of processes that compile at once
_KEPT = 8  # cache folders of other versions and copies that are kept


class Kernel:
    """A function to compile; `signatures` are argument types of calls from Python, if any."""

    def __init__(
        self, function: Callable[..., Any], signatures: tuple[str, ...], *, inline: bool
    ) -> None:
        update_wrapper(self, function)
        self.function, self.signatures, self.inline = function, signatures, inline
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.module = function.__module__.rpartition(".")[2]
        self.compiled: Any = None
        self.ready = False
        _KERNELS.append(self)

    @property
    def _numba_type_(self) -> Any:
        """Type of this kernel in kernels that call it."""
        from numba import types

        return types.Dispatcher(self.compiled)

    @property
    def file(self) -> str:
        """Prefix of numba's cache files of this kernel."""
        return f"{self.module}.{self.function.__name__}"

    def work(self) -> int:
        """Amount of work to compile: bytecode size of the kernel and of all that it calls."""
        calls, seen = [self], {self.name}
        for caller in calls:
            names = caller.function.__code__.co_names
            values = (caller.function.__globals__.get(name) for name in names)
            called = [v for v in values if isinstance(v, Kernel) and v.name not in seen]
            seen |= {each.name for each in called}
            calls += called
        return sum(len(each.function.__code__.co_code) for each in calls)

    def compile(self) -> None:
        """Compile every signature, or load it from the cache."""
        from numba.core.sigutils import normalize_signature

        for signature in self.signatures:
            self.compiled.compile(normalize_signature(signature)[0])

    def __call__(self, *arguments: Any) -> Any:
        if not self.ready:
            load(self.module)
        return self.compiled(*arguments)


class External:
    """A function of another library that kernels call, given by symbol and signature."""

    def __init__(self, symbol: str, signature: str) -> None:
        self.symbol, self.signature = symbol, signature

    @property
    def compiled(self) -> Any:
        """The function as an object of numba."""
        from numba import types
        from numba.core.sigutils import normalize_signature

        arguments, returned = normalize_signature(self.signature)
        return types.ExternalFunction(self.symbol, returned(*arguments))


def jit(*signatures: str, inline: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorator that makes a kernel; sums inside it may be reordered.

    Args:
        signatures: Types of the arguments in numba's notation, for kernels that are called from
            Python; none for those that only kernels call.
        inline: Compile it into the kernels that call it, in which sizes of arrays are known.
    """
    return lambda function: Kernel(function, signatures, inline=inline)


def load(*modules: str) -> None:
    """Make kernels callable: compile them, the first time on this machine, or load them.

    Args:
        modules: Names of the modules of kernels, which are compiled in parallel.
    """
    with _LOCK:
        kernels = [k for k in _KERNELS if k.signatures and not k.ready and k.module in modules]
        if not kernels:
            return
        keep_freed_memory()
        folder = _dispatchers()
        _compile_once(sorted(kernels, key=lambda kernel: -kernel.work()), folder)
        for kernel in kernels:
            kernel.ready = True
            kernel.function.__globals__[kernel.function.__name__] = kernel.compiled


def called_from_python() -> set[str]:
    """Names of the kernels, of modules imported so far, that are called from Python."""
    return {kernel.function.__qualname__ for kernel in _KERNELS if kernel.signatures}


def compile_named(claims: Path, names: Sequence[str]) -> None:
    """Compile some kernels into the cache, in a process that `load` started.

    Args:
        claims: Folder in which processes that share the work claim a kernel, each by a file.
        names: Full names of kernels that have signatures.
    """
    _dispatchers()
    kernels = {kernel.name: kernel for kernel in _KERNELS}
    for name in names:
        with suppress(FileExistsError):
            (claims / name).touch(exist_ok=False)
            kernels[name].compile()


def _dispatchers() -> Path:
    """Create numba's dispatchers of new kernels and link them; returns the cache folder."""
    import numba

    config: Any = numba.config
    kernels = [kernel for kernel in _KERNELS if kernel.compiled is None]
    folder, before = cache_folder(numba.__version__), config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        for kernel in kernels:
            wrappers = {"no_cfunc_wrapper": True, "no_cpython_wrapper": not kernel.signatures}
            options: dict[str, Any] = {**wrappers, "fastmath": {"contract", "reassoc", "nsz"}}
            options |= {"error_model": "numpy", "forceinline": kernel.inline}
            options["cache"] = bool(kernel.signatures)  # processes would overwrite what they share
            kernel.compiled = numba.njit(**options)(kernel.function)
            if kernel.signatures:
                _save_if_possible(kernel.compiled)
    finally:
        config.CACHE_DIR = before
    for kernel in kernels:
        for name, value in kernel.function.__globals__.items():
            if isinstance(value, (External, StackArray)):
                kernel.function.__globals__[name] = value.compiled
    return folder


def _save_if_possible(compiled: Any) -> None:
    """Let a kernel run although its code cannot be saved, as on a full disk."""
    cache = compiled._cache
    save = cache.save_overload

    def save_overload(*code: Any) -> None:
        with suppress(OSError):
            save(*code)

    cache.save_overload = save_overload


def _compile_once(kernels: list[Kernel], folder: Path) -> None:
    """Compile kernels unless an earlier process did, with messages if it takes long.

    Separate processes compile, the largest kernels first, and all others load the results, so that
    every process runs the same code: numba's varies in the last digit with the hash order of
    strings. A process loads a kernel when it is first called; functions that several kernels share
    are those of the first one loaded.
    """
    if not _missing(kernels, folder):
        return
    over = threading.Event()
    threading.Thread(target=_say, args=(kernels, folder, over), daemon=True).start()
    try:
        with _locked(folder):
            missing = _missing(kernels, folder)  # another process may have compiled them meanwhile
            with tempfile.TemporaryDirectory(dir=folder) as claims:
                count = min(os.cpu_count() or 1, _PROCESSES, len(missing))
                for process in [_start_compiler(claims, missing, folder) for _ in range(count)]:
                    if process is not None:
                        process.wait()
            done = _on_disk(folder)
            for kernel in kernels:  # if no process could
                if kernel.file not in done:
                    kernel.compile()
            saved = _on_disk(folder)
            names = [k.name for k in kernels if k.name in missing and k.file in saved]
            with suppress(OSError), (folder / "compiled").open("a", encoding="utf-8") as file:
                file.write("".join(f"{name}\n" for name in names))
    finally:
        over.set()


def _on_disk(folder: Path) -> set[str]:
    """Prefixes of the cache files of compiled kernels."""
    return {path.name.partition("-")[0] for path in folder.rglob("*.nbc")}  # not its index, .nbi


def _missing(kernels: list[Kernel], folder: Path) -> list[str]:
    """Names of kernels that no process has compiled yet."""
    compiled: set[str] = set()
    with suppress(OSError):
        compiled = set((folder / "compiled").read_text(encoding="utf-8").split())
    return [kernel.name for kernel in kernels if kernel.name not in compiled]


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock with which one process at a time compiles, where the system has locks."""
    with (folder / "lock").open("w") as file:
        if fcntl is not None:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _start_compiler(claims: str, names: list[str], folder: Path) -> subprocess.Popen[bytes] | None:
    """Start a process that compiles into the cache; None inside a program other than Python."""
    if "python" not in Path(sys.executable or "").name.lower():
        return None
    command = [sys.executable, "-m", "glissando._kernels.compile", claims, *names]
    environment = {**os.environ, "GLISSANDO_CACHE": str(folder.parent), "PYTHONHASHSEED": "0"}
    nothing = subprocess.DEVNULL
    with suppress(OSError):
        return subprocess.Popen(
            command, env=environment, stdin=nothing, stdout=nothing, stderr=nothing
        )
    return None


def _say(kernels: list[Kernel], folder: Path, over: threading.Event) -> None:
    """Print the progress of compilation to stderr until it is over.

    Kernels that were on disk before take no time now, so they are in neither the share nor the sum.
    """
    before = _on_disk(folder)
    work = {kernel.file: kernel.work() for kernel in kernels if kernel.file not in before}
    began = time.monotonic()
    while not over.wait(_AGAIN if folder in _NAMED else _NOTICE):
        _NAMED.add(folder)
        elapsed = time.monotonic() - began
        done = sum(work[file] for file in _on_disk(folder) & work.keys())
        share = min(done / max(sum(work.values()), 1), 0.99)
        what = f"compiling its inner loops, once, into {folder}"
        if share > 0.0:
            what += f"; {100 * share:.0f} % done, about {elapsed * (1 / share - 1):.0f} s left"
        print(f"glissando: {what}", file=sys.stderr, flush=True)


def cache_folder(numba_version: str) -> Path:
    """Cache folder of compiled kernels: the user's, or a temporary one where that fails.

    Args:
        numba_version: Version of the compiler.
    """
    digest = hashlib.sha256(f"{numba_version} {sys.version}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        changed = source.stat().st_mtime_ns  # numba recompiles if the time of a source differs
        digest.update(f"{source} {changed}".encode() + source.read_bytes())
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
    """Whether the folder exists or can be made, is writable, and belongs to this user."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return False
    return not hasattr(os, "getuid") or folder.stat().st_uid == os.getuid()


def _drop_others(root: Path, name: str) -> None:
    """Remove cache folders of other versions, except the latest ones, which may be in use."""
    with suppress(OSError):
        now = time.time_ns()  # finer than what the system sets by itself
        os.utime(root / name, ns=(now, now))
        others = [p for p in root.glob("kernels-*") if p.name != name]
        for folder in sorted(others, key=lambda p: p.stat().st_mtime)[:-_KEPT]:
            shutil.rmtree(folder, ignore_errors=True)
