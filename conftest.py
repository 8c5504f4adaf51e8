import os
import signal
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings

from glissando._kernels import jit

# Drawn inputs of most laws; a machine that is busy is slower than any deadline. `--hypothesis-seed`
# and a larger profile look for more: HYPOTHESIS_EXAMPLES=1000 pytest …
settings.register_profile(
    "glissando", max_examples=int(os.environ.get("HYPOTHESIS_EXAMPLES", "40")), deadline=None
)
settings.load_profile("glissando")

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Ctrl-C as at a terminal, here and in what tests start, where the shell ignores it (nohup, `&`).
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Tests of a file with fixtures of its own run in one process, which makes them once."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFixtures(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return file if _has_fixtures(config.rootpath / file) else nodeid

    return ByFixtures(config, log)


@cache
def _has_fixtures(file):
    return file.suffix == ".py" and 'scope="module"' in file.read_text(encoding="utf-8")


DATA = Path(__file__).parent / ".." / "shared" / "data"


@pytest.fixture(scope="session", autouse=True)
def kernels_are_called_as_declared():
    """With other types they are compiled again, by whoever calls them, while he waits."""
    yield
    for kernel in jit._KERNELS:
        if kernel.signatures and kernel.compiled is not None:
            others = kernel.compiled.signatures[len(kernel.signatures) :]
            assert not others, f"{kernel.name} was called with {others}"


def _beside(name, what):
    """What stands beside the checkout; tests that need it are skipped without."""
    path = (DATA / name).resolve()
    if not path.exists():
        pytest.skip(f"{what} not beside the checkout")
    return path


@pytest.fixture(scope="session")
def spacetime() -> Path:
    return _beside("spacetime", "the public space-time recordings are")


@pytest.fixture(scope="session")
def golden() -> Path:
    file = "golden/reference_batch_slow_free_space.csv"
    return _beside(file, "the reference implementation's results are")


@pytest.fixture(scope="session")
def openigtlink() -> Path:
    return _beside("openigtlink", "the wire-exact OpenIGTLink messages are")
