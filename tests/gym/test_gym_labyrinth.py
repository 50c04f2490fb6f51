"""The gymnasium environment: its rules, its reproducibility, and what its numbers mean."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import slamsim.gym
from slamsim.guard.errors import SlamsimError
from slamsim.gym.labyrinth import LabyrinthEnv
from slamsim.world.build import build_world

FORWARD, SPIN = np.array([0.4, 0.0], np.float32), np.array([0.0, 1.0], np.float32)
ACTIONS = np.random.default_rng(5).uniform(-1, 1, (12, 2)).astype(np.float32) * [0.5, 1.5]


@pytest.fixture(scope="module")
def env() -> Iterator[LabyrinthEnv]:
    made = LabyrinthEnv("tiny", map_cells=48, render_mode="rgb_array")
    yield made
    made.close()


def driven(env: Any, seed: int) -> list[bytes]:
    """Everything that an episode tells, as bytes."""
    found, _ = env.reset(seed=seed)
    told = [part.tobytes() for part in found.values()]
    for action in ACTIONS:
        found, reward, *_ = env.step(action)
        told += [*(part.tobytes() for part in found.values()), np.float64(reward).tobytes()]
    return told


def test_gymnasium_finds_no_fault() -> None:
    made = gymnasium.make(slamsim.gym.LABYRINTH, world="tiny", render_mode="rgb_array")
    check_env(made.unwrapped)
    made.close()


def test_the_same_seed_and_actions_give_the_same_bytes(env: LabyrinthEnv) -> None:
    with_another_beside = LabyrinthEnv("tiny", map_cells=48)
    first = driven(env, 3)
    assert driven(with_another_beside, 3) == first
    assert driven(env, 4) != first
    assert driven(env, 3) == first
    with_another_beside.close()


def test_interleaved_environments_do_not_meet(env: LabyrinthEnv) -> None:
    alone = driven(env, 7)
    others = [LabyrinthEnv("tiny", map_cells=48) for _ in range(2)]
    told: list[list[bytes]] = []
    for other in others:
        found, _ = other.reset(seed=7)
        told.append([part.tobytes() for part in found.values()])
    for action in ACTIONS:
        for heard, other in zip(told, others, strict=True):
            found, reward, *_ = other.step(action)
            heard += [*(p.tobytes() for p in found.values()), np.float64(reward).tobytes()]
    for other in others:
        other.close()
    assert told == [alone, alone]


def test_a_step_is_so_many_control_ticks_of_physics(env: LabyrinthEnv) -> None:
    _, before = env.reset(seed=1)
    for _ in range(10):
        *_, after = env.step(FORWARD)
    assert after["time_s"] - before["time_s"] == pytest.approx(1.0)
    # 0.5 m/s^2 up to 0.4 m/s: 0.16 m until then, the rest of the second at full speed, which the
    # motors and the tyres do not quite reach
    moved_m = float(np.linalg.norm(after["pose"][:2] - before["pose"][:2]))
    assert moved_m == pytest.approx(0.24, abs=0.03)


def test_odometry_follows_the_true_motion(env: LabyrinthEnv) -> None:
    _, start = env.reset(seed=1)
    for _ in range(15):
        found, _, _, _, told = env.step(SPIN)
    turned_rad = np.remainder(told["pose"][2] - start["pose"][2], 2 * np.pi)
    assert found["odometry"][2] == pytest.approx(turned_rad, abs=0.05)
    assert found["odometry"][4] == pytest.approx(1.0, abs=0.05)
    assert np.linalg.norm(found["odometry"][:2]) < 0.02


def test_the_reward_adds_up_to_what_was_seen_less_contacts(env: LabyrinthEnv) -> None:
    found, before = env.reset(seed=2)
    rewards, contacts = 0.0, 0
    for _ in range(150):
        found, reward, _, _, told = env.step(FORWARD)
        rewards, contacts = rewards + reward, contacts + told["touched"]
    assert contacts > 0  # the tiny world is crossed in less
    assert rewards == pytest.approx(told["seen_m2"] - before["seen_m2"] - 0.1 * contacts)
    assert env.observation_space.contains(found)


def test_the_map_is_where_the_world_is(env: LabyrinthEnv) -> None:
    """Against the true occupancy: what is drawn free has no wall in the middle of it, what is
    drawn occupied lies on one."""
    _, told = env.reset(seed=2)
    for _ in range(30):
        found, *_, told = env.step(SPIN)
    config = env._config
    world = build_world(config.world, told["world_seed"])
    resolution_m = config.mapping.resolution_m
    true = world.grid(resolution_m, float(env._model.T_base_laser[2, 3]))
    rows, columns = np.nonzero(found["map"][::-1] == 2)
    corner = np.floor((told["pose"][:2]) / resolution_m) - 24
    cells = (
        np.stack([columns, rows], axis=1) + corner - np.rint(np.array(true.origin_m) / resolution_m)
    )
    near = np.zeros(true.occupancy.shape, dtype=bool)
    solid = true.occupancy == 1.0
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            near |= np.roll(solid, (down, right), (0, 1))
    columns, rows = cells.astype(int).T
    assert len(rows) > 50
    assert near[rows, columns].mean() > 0.98


def test_an_episode_is_truncated(env: LabyrinthEnv) -> None:
    short = LabyrinthEnv("tiny", episode_s=0.5)
    short.reset(seed=0)
    ends = [short.step(SPIN)[2:4] for _ in range(4)]
    assert ends[-1] == (False, True)
    assert (False, False) in ends
    short.close()


def test_worlds_change_with_the_seed_unless_they_are_pinned() -> None:
    made = LabyrinthEnv()
    pinned = LabyrinthEnv(world_seed=5)
    seeds = [made.reset(seed=1)[1], made.reset()[1], made.reset(options={"world_seed": 9})[1]]
    assert len({told["world_seed"] for told in seeds}) == 3
    assert seeds[2]["world_seed"] == 9
    assert made.reset(seed=1)[1]["world_seed"] == 1
    assert [pinned.reset(seed=s)[1]["world_seed"] for s in (1, 2)] == [5, 5]
    made.close()
    pinned.close()


def test_a_picture_shows_map_path_and_robot(env: LabyrinthEnv) -> None:
    env.reset(seed=2)
    for _ in range(5):
        env.step(FORWARD)
    picture = env.render()
    assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3
    colours = {tuple(colour) for colour in picture.reshape(-1, 3)}
    assert {(255, 255, 255), (150, 150, 150), (30, 30, 30), (220, 60, 40)} <= colours


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"render_mode": "human"}, "rgb_array"),
        ({"ticks_per_step": 0}, "must be positive"),
        ({"settings": {"sensors.lidar.enabled": False}}, "needs sensors.lidar"),
        ({"settings": {"sensors.lidar.beams": 3}}, "beam_count"),
        ({"world": "labirynth"}, "labyrinth"),
    ],
)
def test_what_cannot_be_is_told(wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(SlamsimError, match=why):
        LabyrinthEnv(**wrong)


def test_actions_and_options_that_are_none_are_refused(env: LabyrinthEnv) -> None:
    with pytest.raises(SlamsimError, match="world_seed, not 'difficulty'"):
        env.reset(options={"difficulty": 1})
    with pytest.raises(SlamsimError, match="whole number"):
        env.reset(options={"world_seed": -1})
    env.reset(seed=0)
    with pytest.raises(SlamsimError, match="an action"):
        env.step(np.array([np.nan, 0.0]))


def vector_of(kind: Any, **more: Any) -> list[bytes]:
    made = kind([lambda: LabyrinthEnv("tiny")] * 2, **more)
    found, _ = made.reset(seed=3)
    told = [part.tobytes() for part in found.values()]
    for action in ACTIONS[:5]:
        found, rewards, *_ = made.step(np.stack([action, action]).astype(np.float32))
        told += [*(part.tobytes() for part in found.values()), rewards.tobytes()]
    made.close()
    return told


@pytest.mark.long
def test_vectors_of_environments_agree() -> None:
    assert vector_of(SyncVectorEnv) == vector_of(AsyncVectorEnv, context="spawn")
