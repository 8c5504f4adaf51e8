"""The guard beside a live session: each kind of finding once, and its own end."""

from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor, wait

import numpy as np
import pytest

from glissando import PoseReadings, load_robot
from glissando.evaluation.plausibility.monitor import PlausibilityMonitor


@pytest.mark.parametrize("when", ["submitted", "looking"])
def test_a_guard_whose_process_ends_says_so_once(when):
    class Broken:
        def submit(self, *_, **__):
            if when == "submitted":
                raise BrokenExecutor("gone")
            looking = Future()
            looking.set_exception(BrokenExecutor("gone"))
            return looking

    watch = PlausibilityMonitor(load_robot("tdcr466"), Broken())
    read = PoseReadings(
        time=[0.0], arclength=[0.4], values=np.eye(4)[None], cov=np.full(6, 1e-6), name="p"
    )
    said = [f.sentence for t in (0.0, 20.0, 40.0, 60.0) for f in watch.take([read], t)]
    assert len(said) == 1
    assert "has ended" in said[0]
    assert not watch._streams  # of which nobody looks at any
    assert watch.last(60.0) == []


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "kinds"), [(1.0, set()), (1e3, {"length-unit"})])
def test_a_session_that_goes_on_is_warned_of_each_kind_once(session, unit, kinds):
    robot, (coil,), _, _ = session
    values = coil.values.copy()
    values[:, :3, 3] *= unit
    coil, said = coil.changed(values=values), []
    with ThreadPoolExecutor(1) as executor:
        watch = PlausibilityMonitor(robot, executor, every=2.0)
        for now in np.arange(coil.time[0], coil.time[-1], 0.5):
            fresh = coil.select((coil.time > now - 0.5) & (coil.time <= now))
            said += watch.take([fresh], now)
            wait([watch._looking] if watch._looking else [])
    names = [finding.name for finding in said]
    assert len(names) == len(set(names))
    assert kinds == set(names) - {"noise"}
    assert watch.last(now) == []
    short = PlausibilityMonitor(robot, executor)
    assert short.take([coil], coil.time[-1]) == []
    assert kinds <= {finding.name for finding in short.last(coil.time[-1])}
