"""A recording to learn from, and learning in the process of the test."""

import pytest

from glissando.calibration.robot import workers
from learn_drawn import same_process, write_arc


@pytest.fixture
def in_process(monkeypatch):
    monkeypatch.setattr(workers, "ProcessPoolExecutor", same_process)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_arc(tmp_path_factory.mktemp("recordings") / "arc")
