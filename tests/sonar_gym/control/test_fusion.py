"""The filter against known answers: the Kalman gain, moments of a mixture, enumerated chains, and known streets."""

import itertools

import gymnasium
import numpy as np
import pytest
from scipy.stats import norm

from noise import GaussianModel
from sonar_gym.control.driver import ParkingDriver, run_episode
from sonar_gym.control.fusion import FusionSettings, StreetFilter
from sonar_gym.control.street_inference import (
    EDGES,
    edge_log_likelihood,
    expected_ranges,
    linearise,
    pda_update,
    space_probability,
)
from sonar_gym.sensing.mounts import LAYOUTS, in_world, mount_arrays
from sonar_gym.sensing.scene import Box, Scene, WallSegment

EIGHT = LAYOUTS["eight"]
MOUNTS, HALF = mount_arrays(EIGHT)
LIMIT = 3.01
STATE = np.array([0.4, 0.02, 0.05, 0.0, 0.75, -0.32, -0.67, 0.6, 1.0, 1.9])  # two boxes, the second without an end


def test_expected_readings_equal_those_of_the_scene():
    x, y, heading, _, wall, face, kerb, *edges = STATE
    depth, middle = face - kerb, 0.5 * (face + kerb)
    boxes = [
        Box(0.5 * (edges[0] + edges[1]), middle, edges[1] - edges[0], depth),
        Box(edges[2] + 15, middle, 30, depth),
    ]
    scene = Scene([WallSegment(-30, wall, 30, wall), WallSegment(-30, kerb, 30, kerb), *boxes])
    hits = scene.cast(in_world(MOUNTS, np.array([x, y, heading])), HALF, LIMIT)
    assert expected_ranges(STATE, MOUNTS, HALF, LIMIT) == pytest.approx(hits.distance)


def test_jacobian_of_a_wall():
    i = [mount.name for mount in EIGHT].index("left")
    straight = STATE.copy()
    straight[2] = 0.0
    _, slope = linearise(straight, MOUNTS, HALF, LIMIT, 1e-4)
    assert slope[i, [0, 1, 4]] == pytest.approx([0.0, -1.0, 1.0], abs=1e-6)  # along, across, and of the wall itself


def test_update_with_a_certain_reading_is_that_of_a_kalman_filter():
    state, spread = pda_update(np.array([1.0]), np.eye(1) * 0.04, 1.0, np.ones(1), 1.2, 1.0, 0.1, 3.0)
    gain = 0.04 / (0.04 + 0.01)
    assert state[0] == pytest.approx(1.0 + gain * 0.2)
    assert spread[0, 0] == pytest.approx((1.0 - gain) * 0.04)


def test_a_reading_without_credence_changes_nothing():
    state, spread = pda_update(np.array([1.0]), np.eye(1) * 0.04, 1.0, np.ones(1), 1.2, 0.0, 0.1, 3.0)
    assert (state[0], spread[0, 0]) == pytest.approx((1.0, 0.04))


@pytest.mark.parametrize("credence", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("reading", [1.05, 1.4, 2.5])
def test_update_with_an_uncertain_reading_has_the_moments_of_the_posterior(credence, reading):
    """Numerical integration of the prior times a mixture of a normal and a uniform likelihood over 3 m."""
    at = np.linspace(-1.0, 3.0, 40001)
    likely = credence * norm.pdf(reading, at, 0.1) + (1.0 - credence) / 3.0
    share = norm.pdf(at, 1.0, 0.2) * likely
    share /= share.sum()
    mean = share @ at
    state, spread = pda_update(np.array([1.0]), np.eye(1) * 0.04, 1.0, np.ones(1), reading, credence, 0.1, 3.0)
    assert state[0] == pytest.approx(mean, abs=1e-4)
    assert spread[0, 0] == pytest.approx(share @ (at - mean) ** 2, rel=1e-3)


def test_probability_of_a_space_agrees_with_enumeration_of_all_state_sequences():
    rng = np.random.default_rng(0)
    far, credence = rng.random(8) < 0.5, rng.uniform(0.2, 0.95, 8)
    credence[3] = 0.0
    step, span, hazard = rng.uniform(0.01, 0.3, 8), 0.8, 2.0
    total = np.zeros((2, 8))
    change = 0.5 * (1.0 - np.exp(-2.0 * hazard * step))
    for way in itertools.product((0, 1), repeat=8):
        p = 0.5
        for k, state in enumerate(way):
            if k:
                p *= change[k] if state != way[k - 1] else 1.0 - change[k]
            right = credence[k] if far[k] == bool(state) else 0.0
            wrong = (1.0 - credence[k]) * (span if far[k] else 1.0 - span)
            p *= right + wrong if credence[k] > 0 else 1.0
        for k, state in enumerate(way):
            total[state, k] += p
    assert space_probability(far, credence, step, span, hazard) == pytest.approx(total[1] / total.sum(axis=0))


def test_likelihood_of_an_edge_is_greatest_at_its_position():
    side = [k for k, mount in enumerate(EIGHT) if mount.name.startswith("right ")]
    at, log = np.linspace(0.85, 1.15, 61), np.zeros(61)
    for x in np.arange(0.4, 1.2, 0.03):
        state = STATE.copy()
        state[:3] = x, 0.0, 0.0
        reading = expected_ranges(state, MOUNTS[side], HALF[side], LIMIT)
        poses = in_world(MOUNTS[side], state[:3])
        log += edge_log_likelihood(
            state, EDGES + 1, at, poses, HALF[side], reading, np.full(2, 0.9), (0.05, 0.01), LIMIT
        )
    assert at[np.argmax(log)] == pytest.approx(1.0, abs=0.006)


def followed(odometry, seed, sonar="ideal", steps=60):
    """Drive along the lane by the true pose; return the errors of odometry and filter: lateral, m, and heading, rad."""
    env = gymnasium.make("SonarParking-v0", odometry=odometry, sonar=sonar)
    world, driver = env.unwrapped, ParkingDriver(perception="fusion")
    observation, _ = env.reset(seed=seed)
    begin = world.street.start.copy()
    for _ in range(steps):
        driver.act(observation)
        _, y, heading = world.car.pose
        bend = np.arctan(0.26 * (-16.0 * y - 8.0 * heading)) / np.radians(30.0)
        observation = env.step(np.array([np.clip(bend, -1, 1), 0.6], dtype=np.float32))[0]
    driver.act(observation)
    true = world.car.pose - [*begin[:2], 0.0]
    odometry, estimate = world.fleet.odometer.pose, driver.perception.pose
    return [abs(odometry[1] - true[1]), abs(odometry[2] + begin[2] - true[2])], np.abs(estimate - true)[1:]


@pytest.mark.parametrize("sonar", ["ideal", "srf08-mlp"])
def test_filter_corrects_the_curvature_bias_of_odometry(sonar):
    pairs = [followed({"pull": np.radians(3.0)}, seed, sonar) for seed in range(6)]
    odometry, estimate = np.array(pairs).swapaxes(0, 1)
    assert np.all(np.sqrt(np.mean(estimate**2, axis=0)) < 0.5 * np.sqrt(np.mean(odometry**2, axis=0)))


def test_fusion_parks_with_worn_odometry():
    env = gymnasium.make("SonarParking-v0", odometry="worn", sonar="srf08-mlp")
    driver = ParkingDriver(perception="fusion")
    episodes = [run_episode(env, driver, seed) for seed in range(500, 512)]
    assert np.mean([episode.success for episode in episodes]) >= 0.9


def test_filter_measures_the_space_and_the_kerb():
    env = gymnasium.make("SonarParking-v0", odometry="wheels")
    driver = ParkingDriver(perception="fusion")
    off = []
    for seed in range(8):
        assert run_episode(env, driver, seed).success
        street = env.unwrapped.street
        space = driver.perception.space
        off.append(
            [space.length - (street.gap[1] - street.gap[0]), driver.perception.kerb - (street.kerb - street.start[1])]
        )
    assert np.abs(np.mean(off, axis=0)).max() < 0.03
    assert np.std(off, axis=0) == pytest.approx([0.0, 0.0], abs=0.05)


def test_filter_without_echoes_follows_odometry():
    env = gymnasium.make("SonarParking-v0", sonar=GaussianModel(miss=1.0))
    driver = ParkingDriver(perception="fusion")
    observation, _ = env.reset(seed=0)
    for _ in range(20):
        driver.act(observation)
        observation = env.step(np.array([0.0, 0.5], dtype=np.float32))[0]
    driver.act(observation)
    assert driver.perception.pose == pytest.approx(env.unwrapped.fleet.odometer.pose, abs=1e-6)
    assert driver.perception.spaces() == []


def test_settings_change_the_estimate():
    sure, unsure = (StreetFilter(EIGHT, LIMIT, FusionSettings(wall=(0.75, spread))) for spread in (1e-3, 0.15))
    for street in (sure, unsure):
        street.update(np.zeros(3), np.full(8, 0.9), np.full(8, 0.9))
    assert abs(sure.state[4] - 0.75) < 0.01 < abs(unsure.state[4] - 0.75)
