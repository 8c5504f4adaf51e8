import platform
import resource

import numpy as np
import pytest

from glissando._kernels.memory import keep_freed_memory


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_a_large_array_fills_memory_that_another_one_freed():
    keep_freed_memory()
    size = 48 << 20
    first = np.ones(size // 8)
    del first
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    second = np.ones(size // 8)
    assert second[-1] == 1.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before < 20
