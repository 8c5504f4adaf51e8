"""Tests that keep real time with devices are judged only while the host lets processes run.

A test marked `alone` that fails while the host kept processes waiting is run again; if it does so
each time, the test is skipped and says why. On a host that does not, a failure is a failure.
"""

import pytest
from _pytest.runner import runtestprotocol

from host_stalls import watched_host

_TRIES = 3


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    if item.get_closest_marker("alone") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for _ in range(_TRIES):
        item._initrequest()
        with watched_host() as stalls:
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if not stalls.disturbed or not any(report.failed for report in reports):
            break
    else:
        number, longest = len(stalls.stretches), 1e3 * stalls.longest
        waited = f"some process waited for {100 * stalls.waited:.0f} % of the time"
        reason = f"the host stalled {number} times, for up to {longest:.0f} ms, and {waited}"
        for report in reports:
            if report.failed:
                print(report.longreprtext)
                report.outcome, report.longrepr = "skipped", (str(item.path), 0, reason)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
