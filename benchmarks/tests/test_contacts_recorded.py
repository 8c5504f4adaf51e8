"""Contacts of a real robot, as the benchmark finds them."""

from pathlib import Path

import pytest

import contacts_recorded

DATA = Path("../shared/data/spacetime")


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="needs the public recordings in ../shared/data")
def test_a_contact_is_seen_where_the_robot_is_touched_and_none_where_it_is_free():
    for name, window in (("slow_free_space", (19.0, 25.0)), ("fast_contact", (0.0, 8.0))):
        assert not contacts_recorded.scanned(DATA / name, window).detected.any()
    hit = contacts_recorded.scanned(DATA / "fast_contact", (10.0, 13.0))
    assert not hit.detected[hit.time < 11.0].any()
    assert hit.detected[hit.time > 11.0].mean() > 0.3
