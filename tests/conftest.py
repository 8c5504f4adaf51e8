import os
from pathlib import Path

import pytest
from hypothesis import settings

# Drawn inputs of most laws; a machine that is busy is slower than any deadline. `--hypothesis-seed`
# and a larger profile look for more: HYPOTHESIS_EXAMPLES=1000 pytest …
settings.register_profile(
    "glissando", max_examples=int(os.environ.get("HYPOTHESIS_EXAMPLES", "40")), deadline=None
)
settings.load_profile("glissando")

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests that share a fixture of their module run in one process, which makes it once."""
    for item in items:
        known = getattr(item, "_fixtureinfo", None)
        made = known.name2fixturedefs.values() if known else ()
        if any(definitions[-1].scope == "module" for definitions in made):
            item.add_marker(pytest.mark.xdist_group(str(item.path)))


DATA = Path(__file__).parents[1] / ".." / "shared" / "data"


@pytest.fixture(scope="session")
def spacetime() -> Path:
    folder = (DATA / "spacetime").resolve()
    if not folder.is_dir():
        pytest.skip("the public space-time recordings are not beside the checkout")
    return folder


@pytest.fixture(scope="session")
def golden() -> Path:
    file = (DATA / "golden" / "reference_batch_slow_free_space.csv").resolve()
    if not file.is_file():
        pytest.skip("the reference implementation's results are not beside the checkout")
    return file


@pytest.fixture(scope="session")
def openigtlink() -> Path:
    folder = (DATA / "openigtlink").resolve()
    if not folder.is_dir():
        pytest.skip("the wire-exact OpenIGTLink messages are not beside the checkout")
    return folder
