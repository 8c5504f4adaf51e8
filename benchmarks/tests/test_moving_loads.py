"""The rods that moving_loads.py draws: an arc under a moment, longer under tension."""

import numpy as np

import moving_loads as program
from glissando.geometry import se3


def test_a_rod_under_a_moment_at_its_tip_is_an_arc():
    moment = np.array([6e-3, -4e-3, 0.0])
    (found,) = np.moveaxis(program.poses(np.concatenate([np.zeros(3), moment])[None]), 1, 0)
    bend = np.concatenate([[0.0, 0.0, 1.0], moment / program.STIFFNESS[3:]])
    arc = se3.exp(np.linspace(0.0, program.LENGTH, len(found))[:, None] * bend)
    np.testing.assert_allclose(found, arc, atol=1e-9)


def test_a_rod_under_tension_is_straight_and_longer():
    tip = program.poses(np.array([[0.0, 0.0, 7.0, 0.0, 0.0, 0.0]]))[-1, 0]
    expected = program.LENGTH * (1.0 + 7.0 / program.STIFFNESS[2])
    np.testing.assert_allclose(tip[:3, 3], [0.0, 0.0, expected], rtol=1e-9)


def test_the_page_states_mode_and_mean():
    numbers = {"bias": 0.01, "rmse": 0.02, "stated": 0.01, "nees": 3.0}
    case = {"std": 0.02, "rate": 20, "still": False, "times": 1.0}
    better = numbers | {"bias": 0.0, "nees": 1.0}
    contacts = [{"std": 0.01, "scale": 0.3, "sliding": True, "touched": 0.005}]
    text = program.page([case | {"mode": numbers, "mean": better}], contacts)
    assert "| 20 mN | 20 | 10 → 0 | 20 → 20 | 10 → 10 | 3.0 → 1.0 |" in text
    assert "| 10 mN | 0.3 | slides | 0.5 % |" in text
