"""Do free boxes and spheres in the physics engine obey closed forms and conservation laws?"""

from __future__ import annotations

import numpy as np
import pytest

from slamsim.config.scenarios.bodies import SolverConfig
from slamsim.core.types import GRAVITY_M_S2, FloatArray
from slamsim.sim import bodies
from slamsim.sim.bodies import BodySurroundings, Box, BurstApart, FreeBodies, Sphere, free_bodies

FLOOR = np.array([[0.0, 0.0, 1.0]])
NOWHERE = np.zeros((0, 3))
EVERY_KIND = [SolverConfig(), SolverConfig(articulated=True), SolverConfig(substeps=3)]


def _standing(count: int, shape_height_m: float) -> FloatArray:
    return np.array([[0.0, 0.0, shape_height_m * (k + 0.5)] for k in range(count)])


@pytest.mark.parametrize("solver", EVERY_KIND)
@pytest.mark.parametrize("shape", [Sphere(0.5), Box((1.0, 0.8, 1.0))])
def test_the_floor_bears_the_weight_of_what_rests_on_it(
    solver: SolverConfig, shape: Sphere | Box
) -> None:
    around = BodySurroundings(FLOOR, friction=0.6)
    with free_bodies(shape, 2.0, _standing(2, 1.0), around, 0.005, solver) as resting:
        resting.advance(300)
        assert resting.load_n() == pytest.approx(2 * 2.0 * GRAVITY_M_S2, rel=1e-3)
        assert np.abs(resting.state().speeds_m_s).max() < 1e-3


@pytest.mark.parametrize("solver", EVERY_KIND)
@pytest.mark.parametrize("stiffness_n_m", [1e4, 1e5])
def test_a_contact_spring_gives_by_weight_over_stiffness(
    solver: SolverConfig, stiffness_n_m: float
) -> None:
    sprung = solver.model_copy(update={"contact_stiffness_n_m": stiffness_n_m})
    around = BodySurroundings(FLOOR, friction=0.6)
    with free_bodies(Sphere(0.5), 1.0, _standing(2, 1.0), around, 0.005, sprung) as resting:
        resting.advance(1000)
        lower_m, upper_m = resting.centres_m()[:, 2]
    slop_m = 2e-5  # that the engine leaves in every contact
    assert 0.5 - lower_m == pytest.approx(2 * GRAVITY_M_S2 / stiffness_n_m, abs=slop_m)
    assert lower_m + 1.0 - upper_m == pytest.approx(GRAVITY_M_S2 / stiffness_n_m, abs=slop_m)


@pytest.mark.parametrize("friction", [0.2, 0.6])
def test_a_box_on_a_slope_slides_with_the_friction_asked_for(friction: float) -> None:
    slope_rad = np.radians(45.0)
    normal = np.array([[np.sin(slope_rad), 0.0, np.cos(slope_rad)]])
    start_m = normal * 0.101 + np.array([[0.0, 0.0, 0.0]])
    solver, around = SolverConfig(), BodySurroundings(normal, friction)
    with free_bodies(Sphere(0.1), 1.0, start_m, around, 0.001, solver) as rolling:
        rolling.advance(500)
        speed_m_s = float(np.linalg.norm(rolling.state().speeds_m_s[0]))
    # A solid ball rolls without sliding where friction is at least 2/7 of the slope's tangent.
    sliding = GRAVITY_M_S2 * (np.sin(slope_rad) - friction * np.cos(slope_rad))
    rolling_m_s2 = 5.0 / 7.0 * GRAVITY_M_S2 * np.sin(slope_rad)
    expected = 0.5 * (rolling_m_s2 if friction >= 2.0 / 7.0 else sliding)
    assert speed_m_s == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("articulated", [False, True])
def test_spheres_that_collide_in_free_fall_keep_their_momentum(articulated: bool) -> None:
    """They begin inside each other and push themselves apart."""
    overlapping = np.array([[0.0, 0.0, 0.0], [0.15, 0.05, 0.02], [-0.1, 0.12, 0.1]])
    solver, around = SolverConfig(articulated=articulated), BodySurroundings(NOWHERE, friction=0.6)
    with free_bodies(Sphere(0.1), 3.0, overlapping, around, 0.002, solver) as falling:
        falling.advance(50)
        state = falling.state()
    assert np.linalg.norm(state.speeds_m_s - state.speeds_m_s.mean(axis=0), axis=1).min() > 0.01
    fallen = np.array([0.0, 0.0, -GRAVITY_M_S2 * 0.1])
    assert state.speeds_m_s.mean(axis=0) == pytest.approx(fallen, abs=1e-9)
    moved_m = (state.centres_m - overlapping).mean(axis=0)
    assert moved_m[:2] == pytest.approx(np.zeros(2), abs=1e-9)


def test_energy_counts_motion_turning_and_height(monkeypatch: pytest.MonkeyPatch) -> None:
    solver, around = SolverConfig(), BodySurroundings(NOWHERE, friction=0.0)
    with free_bodies(Box((1.0, 2.0, 3.0)), 6.0, np.zeros((1, 3)), around, 0.01, solver) as one:
        state = one.state()
        turning = bodies.State(
            np.array([[0.0, 0.0, 4.0]]),
            np.array([[0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]]),  # its x axis along y
            np.array([[1.0, 2.0, 2.0]]),
            np.array([[0.0, 3.0, 0.0]]),
        )
        assert one.energy_j(state) == 0.0
        about_own_x = 6.0 / 12.0 * (2.0**2 + 3.0**2)
        expected = 6.0 * GRAVITY_M_S2 * 4.0 + 6.0 * 9.0 / 2 + about_own_x * 9.0 / 2
        assert one.energy_j(turning) == pytest.approx(expected)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_numbers_that_explode_are_told_and_not_handed_on(
    value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Exploded:
        def getBasePositionAndOrientation(  # noqa: N802
            self, body: int, client: int
        ) -> tuple[tuple[float, ...], tuple[float, ...]]:
            return (0.0, value, 0.0), (0.0, 0.0, 0.0, 1.0)

    monkeypatch.setattr(bodies, "pybullet", Exploded())
    with pytest.raises(BurstApart, match="burst apart"):
        FreeBodies(0, Sphere(1.0), 1.0, 1, (0,), ()).centres_m()
