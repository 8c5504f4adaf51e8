"""What priors, rods and tendons are made with in Python is checked, in one sentence each."""

import numpy as np
import pytest

from glissando import (
    BaseVariance,
    Grid,
    PoseReadings,
    SeparablePrior,
    WhiteNoisePrior,
    estimate,
    load_robot,
)
from glissando.errors import GlissandoError
from glissando.model.mechanics import Mechanics
from glissando.model.priors.mechanical.prior import MechanicalPrior
from glissando.model.tendons.tendons import Tendons

SIX = np.ones(6)
STIFF = np.array([1e4, 1e4, 2e4, 1e-2, 1e-2, 8e-3])
ROD = {"stiffness": STIFF, "mass_per_length": 0.01, "gravity": [0.0, 0.0, -9.81]}
GIVEN = {
    Mechanics: ROD,
    MechanicalPrior: {
        "mechanics": Mechanics(**ROD), "psd_load": SIX, "psd_strain_error": SIX, "var_tip": SIX,
        "time_scale": 1.0, "var_base": SIX,
    },
    SeparablePrior: {
        "psd_strain_arclength": SIX, "time_scale": 1.0, "base": BaseVariance(SIX, SIX)
    },
    WhiteNoisePrior: {
        "psd_velocity_time": SIX, "psd_strain_arclength": SIX, "psd_strain_time": SIX,
        "psd_velocity_arclength": SIX, "base": None,
    },
    Tendons: {"radius": [5e-3], "angle": [0.0], "end": [0.4], "stiffness": [1e4]},
}  # fmt: skip


@pytest.mark.parametrize("model", GIVEN, ids=lambda model: model.__name__)
def test_lists_do_as_well_as_arrays(model):
    given = GIVEN[model].items()
    lists = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in given}
    made, listed = model(**GIVEN[model]), model(**lists)
    for name, value in vars(made).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(listed, name), value)


@pytest.mark.parametrize(
    ("model", "wrong", "sentence"),
    [
        (Mechanics, {"stiffness": -STIFF}, "stiffness holds -10000; give finite numbers above 0"),
        (Mechanics, {"stiffness": STIFF[:5]}, r"stiffness has shape \(5,\); give \(6,\)"),
        (Mechanics, {"mass_per_length": -1.0}, "mass_per_length holds -1; give .* from 0"),
        (Mechanics, {"gravity": -9.81}, r"gravity has shape \(\); give \(3,\)"),
        (Mechanics, {"joints": [0.2]}, r"stiffness has one row for 2 segments"),
        (Mechanics, {"joints": [0.4, 0.2]}, "joints is .* increase"),
        (Mechanics, {"tip_mass": np.nan}, "tip_mass holds nan"),
        (MechanicalPrior, {"psd_load": SIX[:3]}, r"psd_load has shape \(3,\); give \(6,\)"),
        (MechanicalPrior, {"time_scale": 0.0}, "time_scale holds 0; give .* above 0"),
        (MechanicalPrior, {"points": [0.2]}, r"var_points has shape \(0, 6\); give \(1, 6\)"),
        (MechanicalPrior, {"mechanics": STIFF}, "give a Mechanics"),
        (SeparablePrior, {"psd_strain_arclength": -SIX}, "psd_strain_arclength holds -1"),
        (SeparablePrior, {"psd_strain_arclength": "stiff"}, "is 'stiff'; give numbers"),
        (SeparablePrior, {"base": None}, "base is None; give a BaseVariance"),
        (SeparablePrior, {"base_pose": 2 * np.eye(4)}, "base_pose is not a pose"),
        (SeparablePrior, {"base_pose": np.eye(4) + 300 * np.eye(4, k=3)}, "not millimetres"),
        (SeparablePrior, {"rest_strain": 0 * SIX}, "extension of 0; a straight rod"),
        (SeparablePrior, {"joints": [0.2], "jumps": SIX}, r"jumps has shape \(6,\)"),
        (WhiteNoisePrior, {"psd_strain_time": 0 * SIX}, "psd_strain_time holds 0"),
        (WhiteNoisePrior, {"pace": [1.0, 2.0]}, r"pace has shape \(2,\); give \(1,\)"),
        (WhiteNoisePrior, {"base": 1.0}, "give a BaseDensity or None"),
        (Tendons, {"stiffness": [-1e4]}, "stiffness is .* above zero"),
        (Tendons, {"radius": [5.0]}, "radius is .* metres: 0.0045 for 4.5 mm"),
        (Tendons, {"angle": [120.0]}, "angle is .* radians, not degrees"),
        (Tendons, {"end": [400.0]}, "end reaches 400 m; give metres, not millimetres"),
        (Tendons, {"friction": [np.nan]}, "friction is .* finite"),
        (Tendons, {"slack": [5.0]}, "slack reaches 5 m"),
        (Tendons, {"pitch": [0.0]}, "pitch is .* inf if straight"),
    ],
)
def test_what_cannot_be_is_one_sentence(model, wrong, sentence):
    with pytest.raises(GlissandoError, match=f"^{model.__name__}: .*{sentence}"):
        model(**GIVEN[model] | wrong)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"stiffness": STIFF * [1, 1, 1, 1e6, 1e6, 1e6]}, "m thick; give N"),
        ({"stiffness": STIFF * 1e-6}, "could not carry its own weight"),
        ({"gravity": [0.0, 0.0, -9810.0]}, "in m/s²"),
        ({"tip_mass": 20.0}, "not grams"),
        ({"stiffness": np.tile(STIFF, (2, 1)), "joints": [0.6]}, "beyond the tip"),
    ],
)
def test_a_rod_in_other_units_is_not_estimated(wrong, sentence):
    given = GIVEN[MechanicalPrior] | {"mechanics": Mechanics(**ROD | wrong)}
    pose = load_robot("tdcr466").prior.base_pose
    tip = PoseReadings(time=[0.0], arclength=[0.5], values=pose[None], cov=1e-6 * SIX)
    with pytest.raises(GlissandoError, match=f"Mechanics: .*{sentence}"):
        estimate(MechanicalPrior(**given), Grid([0.0, 0.25, 0.5], [0.0, 0.1]), [tip])
