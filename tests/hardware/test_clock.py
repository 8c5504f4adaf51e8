"""A counter's clock: right to a fraction of the delays, and honest about it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from draws import generators, law
from glissando.hardware.drivers.clock import ClockFit

PERIOD = 0.025
DELAYS = {
    "exponential": lambda rng, n: rng.exponential(3e-3, n),
    "uniform": lambda rng, n: rng.uniform(0.0, 5e-3, n),
    "small": lambda rng, n: rng.exponential(2e-4, n),
    "sometimes 100 ms": lambda rng, n: (
        rng.exponential(2e-3, n) + rng.uniform(0.0, 0.1, n) * (rng.uniform(size=n) < 0.3)
    ),
}


def arrived(rng, kind, count, period=PERIOD, skew=None):
    """Counts, their true times, and when they arrived."""
    skew = 5e-5 * rng.standard_normal() if skew is None else skew
    n = np.arange(count)
    true = rng.uniform(0.0, 1e5) + period * (1.0 + skew) * n
    return n, true, true + DELAYS[kind](rng, count)


@pytest.mark.slow
@pytest.mark.parametrize("kind", DELAYS)
@pytest.mark.parametrize("count", [20, 200, 1000])
def test_errors_of_time_and_rate_are_what_the_clock_says(kind, count):
    rng = np.random.default_rng(count)
    errors, rates, sizes = [], [], []
    for _ in range(20):
        n, true, arrival = arrived(rng, kind, count)
        clock = ClockFit(PERIOD, 2**32)
        for k in n:
            clock.add(int(k), arrival[k])
        assert clock.restarts == 0
        error = clock.time(n[-1]) - true[-1]
        errors.append((error / clock.std_time(n[-1])) ** 2)
        slope = (true[-1] - true[0]) / (count - 1)
        rates.append((clock.period - slope) ** 2 / clock.cov[1, 1])
        sizes.append(abs(error))
    assert 0.05 < np.mean(errors) < 3.0
    assert np.mean(rates) < 3.0
    mean_delay = max(1e-3, np.mean(DELAYS[kind](rng, 10_000)))
    assert np.median(sizes) < mean_delay / (1.0 if count < 100 else 8.0 if count < 1000 else 16.0)


@given(generators)
@settings(law, max_examples=6)
def test_the_line_is_near_the_lower_envelope_of_all_readings(rng):
    n, _, arrival = arrived(rng, "exponential", 800)
    clock = ClockFit(PERIOD, 2**32)
    for k in n:
        clock.add(int(k), arrival[k])
    # The slow twin: the highest line that no arrival is below, through all of them.
    y = arrival - arrival[0] - PERIOD * n
    rows = np.column_stack([np.ones(n.size), PERIOD * n])
    found = linprog(-rows.sum(axis=0), A_ub=rows, b_ub=y, bounds=[(None, None)] * 2)
    envelope = arrival[0] + PERIOD * n[-1] + rows[-1] @ found.x
    assert abs(clock.time(n[-1]) - envelope) < 3e-4


@pytest.mark.slow
@given(generators, st.sampled_from([2**32, 32768]))
@settings(law, max_examples=20)
def test_a_counter_that_wraps_goes_on(rng, modulus):
    n, true, arrival = arrived(rng, "small", 300, period=1e-3)
    n = n * 7  # a servo is asked now and then
    arrival = true[0] + 7 * (arrival - true[0])
    start = modulus - int(rng.integers(1, 2000))
    clock = ClockFit(1e-3, modulus)
    counts = [clock.add(int((start + k) % modulus), a) for k, a in zip(n, arrival, strict=True)]
    assert np.array_equal(np.array(counts) - counts[0], n)
    assert clock.restarts == 0


def test_a_servo_silent_for_longer_than_its_tick_wraps_is_unwrapped_by_the_host():
    clock = ClockFit(1e-3, 32768)
    for k in range(100):
        clock.add(10 * k, 5.0 + 0.01 * k)
    later = 200_000
    assert clock.add(later % 32768, 5.0 + 1e-3 * later) == later
    assert clock.restarts == 0


@pytest.mark.slow
@given(generators)
@law
def test_counts_and_times_are_each_others_inverse(rng):
    n, _, arrival = arrived(rng, "uniform", 50)
    clock = ClockFit(PERIOD, 2**32, latency=0.01)
    for k in n:
        clock.add(int(k), arrival[k])
    for count in rng.uniform(-1e3, 1e3, 5):
        assert np.isclose(clock.count_at(clock.time(count)), count, atol=1e-6)
    assert np.all(np.linalg.eigvalsh(clock.cov) > 0.0)


def test_a_known_latency_is_taken_off_and_its_doubt_kept():
    plain, known = ClockFit(PERIOD, 2**32), ClockFit(PERIOD, 2**32, latency=0.01, std_latency=2e-3)
    for k in range(100):
        for clock in (plain, known):
            clock.add(k, 3.0 + PERIOD * k)
    assert np.isclose(plain.time(50) - known.time(50), 0.01, atol=1e-9)
    assert np.isclose(known.std_time(50) ** 2 - plain.std_time(50) ** 2, 4e-6)


def test_memory_does_not_grow():
    clock = ClockFit(PERIOD, 2**32)
    for k in range(20_000):
        clock.add(k, PERIOD * k + 1e-3 * (k * k % 7))
    held = [value for value in vars(clock).values() if isinstance(value, list)]
    assert sum(map(len, held)) <= 64


@pytest.mark.parametrize(
    ("number", "slip"), [(0, 0.0), (500, 0.0), (2**31, 0.0), (1300, 0.5)],
    ids=["back", "little", "far", "slips"],
)  # fmt: skip
def test_a_counter_that_jumps_or_slips_starts_anew(number, slip):
    clock = ClockFit(PERIOD, 2**32)
    for k in range(1000, 1300):
        clock.add(k, PERIOD * k)
    true = 1300 * PERIOD + slip
    for k in range(100):
        clock.add(number + k, true + PERIOD * k)
    assert clock.restarts == 1
    assert abs(clock.time(number + 99) - (true + PERIOD * 99)) < 3e-3


def test_a_host_that_is_late_for_a_second_changes_nothing():
    clock = ClockFit(PERIOD, 2**32)
    for k in range(300):
        late = 1.0 - PERIOD * (k - 200) if 200 <= k < 240 else 0.0
        clock.add(k, PERIOD * k + late)
    assert clock.restarts == 0
    assert abs(clock.time(299) - PERIOD * 299) < 1e-3


def test_the_same_number_again_adds_nothing():
    one, other = ClockFit(PERIOD, 2**32), ClockFit(PERIOD, 2**32)
    for k in range(100):
        for _ in range(3):
            one.add(k, PERIOD * k)
        other.add(k, PERIOD * k)
    one.add(99, 1e4)  # a device that stands still
    assert (one.time(50), one.std_time(50)) == (other.time(50), other.std_time(50))
    assert one.restarts == 0
