"""A prior of a user's own is read from robot files, written to posteriors, estimated with."""

import json
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pytest

from glissando import (
    BaseDensity,
    BaseVariance,
    GlissandoError,
    SeparablePrior,
    WhiteNoisePrior,
    estimate,
    load_posterior,
    load_robot,
    save_posterior,
)
from glissando.errors import OldNameWarning
from glissando.geometry import se3
from glissando.io.shipped_robots import robot_file, shipped_robots
from glissando.model.priors import registry
from glissando.model.table import Table
from scenes import sliding_scene


@dataclass(frozen=True)
class Stiffened(WhiteNoisePrior):
    """White noise whose bending is stiffer by a factor."""

    kind: ClassVar[str] = "stiffened"
    factor: float = field(default=1.0)

    @classmethod
    def from_table(cls, prior, robot):
        factor = prior.number("factor")
        return replace(super().from_table(prior, robot), factor=factor)

    def to_table(self):
        table = super().to_table()
        table["prior"]["factor"] = self.factor
        return table

    def along_arclength(self, arclength, at):
        strain, velocity, jump = super().along_arclength(arclength, at)
        return strain / self.factor, velocity, jump


@pytest.fixture
def _registered(monkeypatch):
    monkeypatch.setattr(registry, "_PRIORS", dict(registry._PRIORS))
    registry.register_prior(Stiffened)


def robot_with(folder, *changes, name="tdcr466"):
    text = robot_file(name).read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "mine.toml").write_text(text)
    return load_robot(folder / "mine.toml")


@pytest.mark.slow
@pytest.mark.usefixtures("_registered")
def test_a_prior_of_ones_own_is_read_estimated_with_and_written(tmp_path):
    robot = robot_with(tmp_path, ('kind = "white-noise"', 'kind = "stiffened"\nfactor = 100.0'))
    assert isinstance(robot.prior, Stiffened)
    assert robot.prior.factor == 100.0
    _, grid, readings = sliding_scene()
    stiff, soft = (estimate(p, grid, readings) for p in (robot.prior, sliding_scene()[0]))
    assert stiff.solve.converged
    assert stiff.at(0.2, 0.5).std_position < soft.at(0.2, 0.5).std_position
    save_posterior(stiff, tmp_path / "posterior.nc")
    again = load_posterior(tmp_path / "posterior.nc")
    assert again.prior.factor == 100.0
    np.testing.assert_allclose(again.at(0.2, 0.5).cov, stiff.at(0.2, 0.5).cov, rtol=1e-6)


def test_a_prior_that_nobody_registered_is_named():
    with pytest.raises(
        GlissandoError, match="'magic' is not a kind of prior; known: white-noise, sep"
    ):
        registry.prior_class("magic")


SIX = np.arange(1.0, 7.0)
TURNED = se3.exp(np.array([0.1, 0.2, 0.3, 0.4, -0.5, 0.6]))
PRIORS = {
    "paced": WhiteNoisePrior(
        SIX, 2 * SIX, 3 * SIX, 4 * SIX, None,
        base_pose=TURNED, pace=np.array([1.0, 2.0]), pace_times=np.array([0.5]),
    ),
    "jointed": WhiteNoisePrior(
        SIX, np.outer([1, 2], SIX), SIX, SIX, BaseDensity(SIX, SIX, SIX),
        joints=np.array([0.2]), jumps=SIX[None],
    ),
    "curved": SeparablePrior(
        np.outer([1, 2], SIX), 0.5, BaseVariance(SIX, SIX), joints=np.array([0.2]),
        jumps=SIX[None], rest_strain=np.outer([1, 2], SIX), rest_slope=np.outer([1, 3], SIX),
        base_pose=TURNED,
    ),
} | {name: load_robot(name).prior for name in shipped_robots()}  # fmt: skip


@pytest.mark.parametrize("name", PRIORS)
def test_every_prior_is_read_back_from_what_it_writes(name):
    prior = PRIORS[name]
    table = Table(json.loads(json.dumps(prior.to_table())), "a file", GlissandoError)
    entries = table.table("prior")
    again = registry.prior_class(entries.text("kind")).from_table(entries, table)
    entries.close()
    table.close()
    mine, its = (
        {**vars(p), "base": None if p.base is None else vars(p.base)} for p in (prior, again)
    )
    np.testing.assert_equal(its.keys(), mine.keys())
    for key, value in mine.items():
        if key == "base" or value is None:
            np.testing.assert_equal(its[key], value)
        else:
            np.testing.assert_allclose(its[key], value, atol=1e-15, err_msg=key)


def test_old_names_in_a_robot_file_are_read_and_named(tmp_path):
    parameter = '\n[[unknowns]]\nname = "late"\nkind = "delay"\nstreams = ["coil"]\nstd = [0.01]\n'
    text = robot_file("tdcr466").read_text().replace('"white-noise"', '"kinematic"') + parameter
    (tmp_path / "old.toml").write_text(text)
    sentence = (
        r'^old.toml: \[\[unknowns\]\] is now \[\[sensor_parameters\]\]; kind = "kinematic" is now '
        r'kind = "white-noise"; kind = "delay" is now kind = "time_offset"; rename it.$'
    )
    with pytest.warns(OldNameWarning, match=sentence):
        robot = load_robot(tmp_path / "old.toml")
    assert isinstance(robot.prior, WhiteNoisePrior)
    assert [p.kind for p in robot.sensor_parameters] == ["time_offset"]
