"""Tests that keep real time with devices are judged only while the host lets processes run.

A test marked `alone` that fails while the host kept a watcher waiting is run again; if the host
stalls each time, it is skipped and says so. On a host that does not stall a failure is a failure.
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
        if not stalls.stretches or not any(report.failed for report in reports):
            break
    else:
        number, longest = len(stalls.stretches), 1e3 * stalls.longest
        reason = f"the host stalled {number} times, for up to {longest:.0f} ms; last failure above"
        for report in reports:
            if report.failed:
                print(report.longreprtext)
                report.outcome, report.longrepr = "skipped", (str(item.path), 0, reason)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
