"""Tendons as a sensor beside a sliding coil, as the benchmark measures it."""

import pytest

import tendon_sensor


@pytest.mark.slow
def test_tendons_beside_a_sliding_coil_halve_the_error_of_the_body(tmp_path):
    found = tendon_sensor.measured([3], tmp_path)
    for shape in ("C", "S"):
        alone, both = found[f"{shape} coil"], found[f"{shape} coil,tendons"]
        assert both["rmse_mm"] < 0.5 * alone["rmse_mm"]
        assert both["inside_95"] > 0.9
