"""A ROS 2 domain for each process of tests, where rclpy is installed."""

import os

import pytest

REASON = "rclpy is not installed; pip install 'glissando[ros2]' has wheels for Python 3.11"


@pytest.fixture
def domain():
    """An address in a domain of this test's own."""
    pytest.importorskip("rclpy", reason=REASON)
    return f"ros2?domain={100 + os.getpid() % 100}"
