"""A sender's clock may be set at any time; delays of the network do not look like that."""

import numpy as np
import pytest

from glissando.hardware.openigtlink import stamp_of
from glissando.hardware.openigtlink.sender_clock import SenderClock

STEP = 0.025


@pytest.mark.parametrize("back", [0.3, 0.5, 3.0, 4.9, 6.0])
def test_a_clock_that_is_set_back_is_followed_within_a_moment(back):
    clock, late = SenderClock(), []
    for k in range(400):
        at = k * STEP
        stamp = 1000.0 + at - (back if k >= 200 else 0.0)
        late.append(at - clock.monotonic(stamp_of(stamp), at + 0.002))
    off = np.flatnonzero(np.abs(late) > 0.02)
    assert off.size <= 5
    assert set(off) <= set(range(200, 205))


@pytest.mark.parametrize("seed", range(5))
def test_delays_and_devices_that_come_in_any_order_restart_nothing(seed):
    """Six devices with stamps a few ms apart, in any order, over a line that stalls for long."""
    rng = np.random.default_rng(seed)
    clock, free, worst = SenderClock(), 0.0, []
    for k in range(400):
        for own in rng.permutation(6):
            at = 0.1 * k + 0.003 * own
            stall = rng.uniform(0.1, 0.3) if rng.random() < 0.01 else 0.0
            free = max(free, 0.1 * k + 0.02 + rng.exponential(0.005)) + stall
            heard = clock.monotonic(stamp_of(1000.0 + at), free)
            if k > 50:
                worst.append(heard - at)
    assert clock._fit.restarts == 0
    assert np.ptp(worst) < 0.05
