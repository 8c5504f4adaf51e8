"""A touch that the search for it begins far from."""

import pytest

import contacts


@pytest.mark.filterwarnings("ignore::glissando.FalseConfidenceWarning")  # it is touched
def test_a_touch_is_found_though_a_system_on_the_way_is_singular_by_rounding():
    """Drawn among two hundred: its diagonal spans thirteen decades at the first step."""
    assert contacts.trial([6, 14], contacts.robot(), "sliding", True)[2]  # whether it was found
