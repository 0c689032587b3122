"""A forest of readings is a law, finds what readings depend on, and can be saved."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.sparse import csr_array

from acquisition import ModelError, Ping, Reading, Recording
from noise import load_model, save_model
from noise.discrepancy.baseline.forest import AnalogueForest, grown
from noise.discrepancy.baseline.forest_law import LEVELS, quantiles
from noise.discrepancy.baseline.trees import columns, grow
from noise.fitting.batch import Batch
from noise.metrics import crps_with_silence
from noise.model import MAX_RANGE, order_of, simulate, with_order

STEP_M = 0.08
NOISE_M = 0.002


def survey(seed, n_visits=60, n_pings=10):
    rng = np.random.default_rng(seed)
    distance = np.repeat(np.round(rng.uniform(0.5, 4.0, n_visits), 3), n_pings)
    time = np.cumsum(np.where(np.arange(len(distance)) % n_pings == 0, 10.0, 0.1))
    return Ping.of(distance, reflectance=np.repeat(rng.choice([0.1, 0.9], n_visits), n_pings), time=time)


def batch_of(ping, error, rng, miss=0.0):
    value = np.round(ping.distance + error + rng.normal(0.0, NOISE_M, len(ping)), 3)
    return Batch.of(Recording.of(ping, Reading.of(np.where(rng.random(len(ping)) < miss, 0.0, value))))


def step_in_reflectance(seed):
    """Soft targets read longer, and are missed in a third of the pings."""
    ping, rng = survey(seed), np.random.default_rng(seed)
    soft = ping.reflectance < 0.5
    return batch_of(ping, STEP_M * soft, rng, soft / 3.0)


def alternating(seed):
    """The error is `STEP_M` after a reading without it, and 0 after one with it."""
    ping, rng = survey(seed), np.random.default_rng(seed)
    return batch_of(ping, STEP_M * (np.arange(len(ping)) % 2), rng)


def forest_of(batch, seed=0):
    return AnalogueForest.of(batch, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def batch():
    return step_in_reflectance(1)


@pytest.fixture(scope="module")
def forest(batch):
    return forest_of(batch)


def test_a_ping_at_another_time_may_be_at_any_recorded_one():
    ping, rng = survey(4), np.random.default_rng(4)
    late = ping.time > np.median(ping.time)
    model = forest_of(batch_of(ping, STEP_M * late, rng))
    assert "time" in model.similar.names
    later = replace(ping, time=ping.time + 1e6)
    chance = model.law(later).between(np.zeros(len(ping)), ping.distance + 0.5 * STEP_M)
    assert np.mean(chance) == pytest.approx(0.5, abs=0.1)


def test_what_has_changed_stays_so_as_long_as_it_has_been_so():
    ping, rng = survey(4), np.random.default_rng(4)
    late = ping.time > np.median(ping.time)
    model = forest_of(batch_of(ping, STEP_M * late, rng))
    end, half = ping.time.max(), 0.5 * np.ptp(ping.time)

    def chance_of_change(after_s):
        law = model.law(replace(ping, time=np.full(len(ping), end + after_s)))
        return np.mean(law.echo - law.arrival(ping.distance + 0.5 * STEP_M))

    assert chance_of_change(0.5 * half) > 0.9
    assert chance_of_change(10.0 * half) == pytest.approx(0.5, abs=0.15)


def test_in_its_own_place_a_ping_is_predicted_from_the_readings_of_others():
    ping, rng = survey(5), np.random.default_rng(5)
    own = 0.05 * rng.normal(size=60)[np.repeat(np.arange(60), 10)]  # an error of each place, which others do not tell
    found = grown(batch_of(ping, own, rng), np.random.default_rng(0))
    again = batch_of(ping, own, np.random.default_rng(6))
    crps = [
        crps_with_silence(model.law(again.ping, again.past), again.reading).mean()
        for model in (found.model, found.elsewhere())
    ]
    assert crps[0] < 0.5 * crps[1]
    assert crps[1] == pytest.approx(found.crps.mean(), rel=0.15)


def test_in_a_place_without_readings_a_forest_is_the_same_elsewhere():
    found = grown(step_in_reflectance(1), np.random.default_rng(0))
    ping, z = survey(9), np.linspace(0.4, 4.2, 30)[:, None]
    laws = [model.law(ping) for model in (found.model, found.elsewhere())]
    np.testing.assert_allclose(laws[0].arrival(z), laws[1].arrival(z), atol=1e-12)


@pytest.fixture(scope="module")
def with_memory():
    return forest_of(alternating(1))


def test_the_probabilities_of_all_outcomes_sum_to_one(forest, batch):
    law = forest.law(batch.ping[:40], batch.past[:40])
    step = np.arange(1, law.last_step + 1)
    ranges = step * law.resolution
    total = sum(np.exp(law.log_prob(Reading.of(np.full(40, r)))) for r in ranges[ranges < 6.0])
    assert np.allclose(total + law.no_echo, 1.0, atol=1e-9)


def test_samples_have_the_probabilities_of_the_law(forest, batch):
    row = batch.starts[batch.ping.reflectance[batch.starts] < 0.5][:1]
    n = 20_000
    law, many = (forest.law(batch.ping[rows], batch.past[rows]) for rows in (row, np.repeat(row, n)))
    drawn = many.sample(np.random.default_rng(0))
    error = 4.0 * np.sqrt(0.25 / n)
    assert np.mean(drawn.echo) == pytest.approx(law.echo[0], abs=error)
    z = law.quantile(np.full((5, 1), [[0.1], [0.3], [0.5], [0.7], [0.9]]))[:, 0]
    below = np.mean(drawn.echo & (drawn.range <= z[:, None] + 1e-9), axis=1)
    assert np.allclose(below, law.cdf(z[:, None])[:, 0], atol=error)


def test_a_step_in_a_condition_is_recovered(batch, forest):
    own, were_soft = forest.law(batch.ping, batch.past).echo, batch.ping.reflectance < 0.5
    assert np.mean(own[were_soft]) == pytest.approx(np.mean(batch.reading.echo[were_soft]), abs=0.02)
    assert np.min(own[~were_soft]) == pytest.approx(1.0)
    new = survey(2)
    law, soft = forest.law(new), new.reflectance < 0.5
    assert np.allclose(law.quantile(0.5) - new.distance, STEP_M * soft, atol=NOISE_M)


def test_errors_are_transported_and_not_ranges():
    ping = survey(1)
    new = survey(9)
    law = forest_of(Batch.of(Recording.of(ping, Reading.of(ping.distance + 0.05)))).law(new)
    assert np.allclose(law.quantile(0.5), law.distance + 0.05, atol=0.0015)


def test_a_dependence_on_the_previous_reading_is_recovered(with_memory):
    assert with_memory.remembers
    ping = Ping.of(np.full(2, 2.0))
    law = with_memory.law(ping, Reading.of(np.array([2.0, 2.0 + STEP_M])))
    assert np.allclose(law.quantile(0.5) - ping.distance, [STEP_M, 0.0], atol=2.0 * NOISE_M)


def test_inputs_that_tell_nothing_do_no_harm(batch, forest):
    """The error of a law that knows the two medians is NOISE_M; silence is at the end of the register."""
    new = step_in_reflectance(4)
    hard = new.ping.reflectance > 0.5
    score = crps_with_silence(forest.law(new.ping, new.past), new.reading, MAX_RANGE)
    assert np.mean(score[hard]) < NOISE_M


def test_equal_seeds_give_equal_laws(batch, forest):
    assert forest_of(batch).to_dict() == forest.to_dict()
    assert forest_of(batch, seed=1).to_dict() != forest.to_dict()


def test_a_single_ping_has_the_law_of_its_row_in_a_batch(with_memory):
    batch = alternating(2)
    rows = batch.starts[:5]  # a ping alone is the first of its visit
    together = with_memory.law(batch.ping, batch.past)
    for row in rows:
        alone = with_memory.law(batch.ping[[row]], batch.past[[row]])
        assert alone.echo[0] == pytest.approx(together.echo[row])
        assert np.allclose(alone.knots[0], together.knots[row])


def test_a_saved_forest_has_the_same_law(with_memory, tmp_path):
    batch = alternating(2)
    same = load_model(save_model(with_memory, tmp_path / "forest"))
    laws = [model.law(batch.ping, batch.past) for model in (with_memory, same)]
    assert np.array_equal(laws[0].knots, laws[1].knots)
    assert np.array_equal(laws[0].echo, laws[1].echo)
    assert (same.resolution, same.max_range, same.remembers) == (with_memory.resolution, with_memory.max_range, True)


@pytest.mark.parametrize(
    "damage",
    [
        {"error": []},
        {"error": None},
        {"names": []},
        {"typical": [0.0, float("nan")]},
        {"resolution": 0.0},
        {"leaf": [[-1]]},
        {"trees": {}},
    ],
)
def test_a_damaged_forest_is_a_clear_error(forest, damage):
    with pytest.raises(ModelError, match="may be damaged"):
        AnalogueForest.from_dict(forest.to_dict() | damage)


@pytest.mark.parametrize(("part", "value"), [("left", 0), ("right", 10**6), ("feature", 99), ("threshold", np.inf)])
def test_a_damaged_tree_is_a_clear_error(forest, part, value):
    data = forest.to_dict()
    trees = {name: list(values) for name, values in data["trees"].items()}
    trees[part][0] = value  # the first root
    with pytest.raises(ModelError, match="may be damaged"):
        AnalogueForest.from_dict(data | {"trees": trees})


def test_cross_fitted_scores_are_those_of_unseen_visits(batch, forest):
    rng = np.random.default_rng
    crossed, new = grown(batch, rng(0)).crps, step_in_reflectance(3)
    assert crossed.shape == grown(batch, rng(0)).nats.shape == (len(batch),)
    fresh = crps_with_silence(forest.law(new.ping, new.past), new.reading, MAX_RANGE)
    assert np.mean(crossed) == pytest.approx(np.mean(fresh), rel=0.2)


def test_cross_fitted_predictions_do_not_see_the_visit():
    """Errors that are a matter of the visit alone can be read back, but not be predicted."""
    rng, ping = np.random.default_rng(5), survey(5)
    own = np.repeat(rng.normal(0.0, 0.05, 60), 10)
    batch = batch_of(ping, own, rng)
    first = batch.count == 0
    inside = crps_with_silence(forest_of(batch).law(batch.ping, batch.past), batch.reading, MAX_RANGE)[first]
    # of a normal law with a known spread: sigma / sqrt(pi)
    assert np.mean(grown(batch, np.random.default_rng(0)).crps[first]) > 0.8 * 0.05 / np.sqrt(np.pi)
    assert np.mean(inside) < 0.8 * 0.05 / np.sqrt(np.pi)


@pytest.mark.parametrize("n_visits", [1, 2])
def test_few_visits_make_a_forest(n_visits):
    ping = survey(0, n_visits)
    batch = batch_of(ping, 0.0, np.random.default_rng(0))
    assert np.allclose(forest_of(batch).law(ping).quantile(0.5), ping.distance, atol=5.0 * NOISE_M)


def test_readings_without_any_echo_make_a_forest(tmp_path):
    ping = survey(0, 10)
    silent = forest_of(Batch.of(Recording.of(ping, Reading.of(np.zeros(len(ping))))))
    law = load_model(save_model(silent, tmp_path / "silent")).law(ping)
    assert np.array_equal(law.no_echo, np.ones(len(ping)))
    assert not law.sample(np.random.default_rng(0)).echo.any()


def test_a_covariate_that_is_not_given_has_its_typical_value():
    ping, rng = survey(1), np.random.default_rng(1)
    warm = np.repeat(np.arange(60) % 3, 10)  # 0, 1 and 2, of which 1 is the median
    logged = Ping.of(ping.distance, reflectance=ping.reflectance, time=ping.time, level=warm)
    forest = forest_of(batch_of(logged, STEP_M * warm, rng))
    law = forest.law(Ping.of([1.0, 3.0]))
    assert np.allclose(law.quantile(0.5) - law.distance, STEP_M, atol=2.0 * NOISE_M)


def test_the_order_in_a_visit_counts_pings_since_the_condition_changed():
    ping = Ping.of([1.0, 1.0, 1.0, 2.0, 1.0, 1.0], run=[0, 0, 0, 0, 0, 1])
    assert np.allclose(order_of(ping), [0, 1, 2, 0, 0, 0])
    assert np.allclose(order_of(with_order(ping)[[5, 2, 1]]), [0, 2, 1])


def test_what_depends_on_the_order_in_a_visit_is_simulated_ping_by_ping():
    """The first three readings of a visit are long, whatever the one before was."""
    ping, rng = survey(0), np.random.default_rng(0)
    forest = forest_of(batch_of(ping, STEP_M * (np.arange(len(ping)) % 10 < 3), rng))
    assert forest.remembers
    fresh = survey(1)
    error = (simulate(forest, fresh, rng).range - fresh.distance).reshape(-1, 10)
    assert np.allclose(error[:, :3].mean(axis=0), STEP_M, atol=0.2 * STEP_M)
    assert np.allclose(error[:, 4:].mean(axis=0), 0.0, atol=0.2 * STEP_M)


def test_quantiles_of_equal_weights_are_those_of_the_values():
    value = np.arange(5.0)
    found = quantiles(csr_array([[1.0, 1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, 0.0, 0.0]]), value)
    assert np.allclose(found[0], np.clip(5.0 * LEVELS - 0.5, 0.0, 4.0))
    assert np.allclose(found[1], 2.0)


def test_no_tree_sees_a_part_of_a_run_of_a_robot_that_it_leaves_out():
    ping, rng = survey(6), np.random.default_rng(6)
    run = np.repeat(np.arange(12), len(ping) // 12)
    robot = replace(batch_of(ping, 0.0, rng), ping=replace(ping, run=run), by_run=True)
    x = columns(("log_distance",), robot.ping, robot.past, {})
    _, drawn = grow(robot, x, robot.error[:, None], rng)
    of_run = np.stack([drawn[run == k].mean(axis=0) for k in range(12)])
    assert np.isin(of_run, (0.0, 1.0)).all()
    assert 0.0 < of_run.mean() < 1.0


def test_quantiles_rise_evenly_between_the_only_two_values_with_a_weight():
    found = quantiles(csr_array([[0.5, 0.0, 0.0, 0.0, 0.5]]), np.arange(5.0))
    assert np.allclose(found[0], 4.0 * np.clip(2.0 * LEVELS - 0.5, 0.0, 1.0))


WEIGHTS = arrays(float, array_shapes(min_dims=2, max_dims=2), elements=st.sampled_from([0.0, 0.0, 0.1, 1.0, 3.0]))


@given(WEIGHTS, st.integers(0, 2**32 - 1))
def test_quantiles_are_linear_between_the_middles_of_weighted_values(weight, seed):
    value = np.sort(np.random.default_rng(seed).normal(size=weight.shape[1]))
    found = quantiles(csr_array(weight), value)
    for row, own in zip(weight, found, strict=True):
        counted = row > 0.0
        middle = np.cumsum(row[counted]) - 0.5 * row[counted]
        expected = np.interp(LEVELS * row.sum(), middle, value[counted]) if counted.any() else 0.0
        np.testing.assert_allclose(own, expected, atol=1e-9)


@given(WEIGHTS, st.integers(0, 2**32 - 1))
def test_values_without_a_weight_do_not_matter(weight, seed):
    value = np.sort(np.random.default_rng(seed).normal(size=weight.shape[1]))
    for row in weight:
        counted = row > 0.0
        whole, part = (quantiles(csr_array(row[None, c]), value[c]) for c in (np.ones_like(counted), counted))
        np.testing.assert_array_equal(whole, part)


def test_weights_of_readings_sum_to_one_over_those_that_share_a_leaf(forest, batch):
    reached = forest.similar.reached(batch.ping, batch.past)
    every = np.concatenate([each.toarray() for _, each in forest.similar.weights(reached)])
    assert np.allclose(every.sum(axis=1), 1.0)
    alike = (reached[:, None, :] == forest.similar.leaf[None, :, :]).any(axis=2)
    np.testing.assert_array_equal(every > 0.0, alike)
