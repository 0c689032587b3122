"""Composed models: known answers for every kind of effect, on ideal, Gaussian, physical and learned laws."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import noise
import sonar_gym  # noqa: F401  (registers the environment)
from acquisition import Ping, Reading, SettingError
from noise import Faulty, GaussianModel, compose, load_model, save_model, simulate
from noise.composed import ComposedModel, adds, with_differences
from noise.discrepancy.baseline.forest import AnalogueForest
from noise.effects import CATALOGUE
from noise.faults import Constant, Noise
from noise.law import ExtrapolationWarning
from noise.physical import PhysicalModel
from noise.rig import RigModel
from tests.noise.discrepancy.made import batch_of

pytestmark = pytest.mark.filterwarnings("error")
LEARNED = load_model("srf08-mlp")
FAR = Ping.of(distance=np.linspace(0.4, 3.0, 200), angle=0.1)


def diagnosed(simulated=(), **causes):
    """Return the parts of a diagnosis that a composition needs; causes are given as effect -> parameters."""
    named = [
        SimpleNamespace(
            effect=name,
            believed=True,
            parameters={key: SimpleNamespace(value=value) for key, value in values.items()},
        )
        for name, values in causes.items()
    ]
    verdict = SimpleNamespace(causes=named)
    return SimpleNamespace(verdict=verdict, emulator=PhysicalModel(simulated), causes_only=None)


def effect(name, **values):
    return CATALOGUE[name](**values)


def test_without_causes_the_law_is_unchanged():
    with pytest.warns(UserWarning, match="names no cause"):
        composed = compose(LEARNED, diagnosed())
    reading = simulate(LEARNED, FAR, np.random.default_rng(0))
    np.testing.assert_allclose(composed.law(FAR).log_prob(reading), LEARNED.law(FAR).log_prob(reading), atol=1e-6)
    np.testing.assert_allclose(composed.law(FAR).echo, LEARNED.law(FAR).echo, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in CATALOGUE if not adds(name)])
def test_an_effect_that_the_recording_shares_with_the_simulation_leaves_the_law_alone(name):
    starts = {p.name: p.starts[-1] for p in CATALOGUE[name].parameters if p.starts}
    composed, left_out = with_differences(LEARNED, {name: starts}, {})
    ping = Ping.of(distance=np.linspace(0.05, 9.0, 40), angle=0.1)
    edges = np.linspace(0.0, 11.0, 300)[:, None]
    np.testing.assert_allclose(composed.law(ping).arrival(edges), LEARNED.law(ping).arrival(edges), atol=1e-9)
    assert not left_out


def test_a_shorter_window_and_coarser_steps_than_the_simulation_has_act_in_full():
    before = {"range_gate": {"listen_m": 4.0}, "rearm_dead_time": {"deaf_m": 0.1}, "quantisation": {"step_m": 0.01}}
    causes = {"range_gate": {"listen_m": 2.0}, "rearm_dead_time": {"deaf_m": 0.3}, "quantisation": {"step_m": 0.1}}
    law = with_differences(GaussianModel(0.001, 0.0), before, causes)[0].law(Ping.of(distance=[0.2, 1.22, 3.0]))
    np.testing.assert_allclose(law.echo, [0.0, 1.0, 0.0], atol=1e-9)
    assert law.quantile(0.5)[1] == pytest.approx(1.2)


@pytest.mark.parametrize(
    ("cause", "values", "expected"),
    [
        ("zero_offset", {"offset_m": 0.03}, lambda d: d + 0.03),
        ("clock_scale", {"error": 0.02}, lambda d: 1.02 * d),
        ("sound_speed", {"temperature_c": 0.0}, lambda d: d * 344.83 / 331.3),
        ("quantisation", {"step_m": 0.1}, lambda d: np.round(d / 0.1) * 0.1),
        ("pivot_offset", {"axial_m": 0.3}, lambda d: d + 0.3 * (1 - np.cos(0.1))),
        ("baseline_parallax", {"spacing_m": 0.2}, lambda d: np.hypot(d, 0.1)),
    ],
)
def test_ranges_are_changed_as_the_formula_says(cause, values, expected):
    exact = GaussianModel(0.0005, 0.0)
    composed = compose(exact, diagnosed(**{cause: values}))
    distance = np.array([0.52, 1.21, 2.43])
    median = composed.law(Ping.of(distance=distance, angle=0.1)).quantile(0.5)
    np.testing.assert_allclose(median, expected(distance), atol=0.0016)


def test_a_cause_that_is_not_believed_is_not_added():
    doubtful = diagnosed(zero_offset={"offset_m": 0.05})
    doubtful.verdict.causes[0].believed = False
    with pytest.warns(UserWarning, match="names no cause"):
        assert not compose(LEARNED, doubtful).after.effects


def test_what_the_simulation_already_has_is_not_added_again():
    both = [effect("zero_offset", offset_m=0.03), effect("clock_scale", error=0.01)]
    composed = compose(GaussianModel(0.0005, 0.0), diagnosed(both, zero_offset={"offset_m": 0.05}))
    assert composed.law(Ping.of(distance=[2.0])).quantile(0.5)[0] == pytest.approx(2.02, abs=0.0012)


@pytest.mark.parametrize("model", [LEARNED, GaussianModel(0.01, 0.0, 0.1)], ids=["learned", "gaussian"])
def test_lost_readings_multiply_the_probability_of_an_echo(model):
    composed = compose(model, diagnosed(dropped_reading={"probability": 0.25}))
    np.testing.assert_allclose(composed.law(FAR).echo, 0.75 * model.law(FAR).echo, atol=1e-9)


def test_replaced_readings_occur_beyond_their_rate_in_the_simulation():
    stuck = {"probability": 0.3, "value_m": 1.5}
    one = compose(GaussianModel(0.001, 0.0), diagnosed(stuck=stuck)).law(Ping.of(distance=[0.5]))
    assert np.exp(one.log_prob(Reading.of([1.5])))[0] == pytest.approx(0.3, abs=1e-6)
    had = [effect("stuck", probability=0.1, value_m=1.5)]
    two = compose(GaussianModel(0.001, 0.0), diagnosed(had, stuck=stuck)).law(Ping.of(distance=[0.5]))
    assert np.exp(two.log_prob(Reading.of([1.5])))[0] == pytest.approx(0.2, abs=1e-6)


def test_a_fixed_object_is_read_only_by_targets_behind_it():
    cause = {"presence": 0.08, "range_m": 0.7, "spread_m": 0.004}
    law = compose(LEARNED, diagnosed(fixed_clutter=cause)).law(Ping.of(distance=[0.4, 2.0]))
    own = LEARNED.law(Ping.of(distance=[0.4, 2.0]))
    near, far = law.arrival(np.full(2, 0.75)) - law.arrival(np.full(2, 0.65))
    base_near, base_far = own.arrival(np.full(2, 0.75)) - own.arrival(np.full(2, 0.65))
    assert far - base_far == pytest.approx(0.08, abs=0.005)
    assert near - base_near == pytest.approx(0.0, abs=0.005)


def test_a_loss_of_level_acts_where_the_simulation_is_near_its_threshold():
    base = [effect("sensitivity", loss_db=48.0)]
    law = compose(GaussianModel(0.001, 0.0), diagnosed(base, sensitivity={"loss_db": 54.0})).law(FAR)
    for name, loss in (("before", 48.0), ("after", 54.0)):
        assert PhysicalModel([effect("sensitivity", loss_db=loss)]).law(FAR).echo.min() >= 0, name
    expected = (
        PhysicalModel([effect("sensitivity", loss_db=54.0)]).law(FAR).echo
        / PhysicalModel([effect("sensitivity", loss_db=48.0)]).law(FAR).echo
    )
    np.testing.assert_allclose(law.echo, expected, atol=1e-6)
    assert law.echo[0] > 0.999
    assert law.echo[-1] < 0.5


def test_added_scatter_has_the_standard_deviation_of_both():
    base = [effect("travel_time_jitter", sigma_m=0.003)]
    composed = compose(GaussianModel(0.003, 0.0), diagnosed(base, travel_time_jitter={"sigma_m": 0.01}))
    drawn = composed.law(Ping.of(distance=np.full(2000, 1.0))).sample(np.random.default_rng(0))
    assert drawn.range.std() == pytest.approx(0.01, rel=0.08)


def test_every_step_of_the_register_has_its_probability():
    causes = {
        "sound_speed": {"temperature_c": 5.0},
        "false_alarm": {"per_metre": 0.05, "share": 1.0, "from_m": 0.1},
        "noise_burst": {"probability": 0.1, "sigma_m": 0.1},
        "cycle_slip": {"probability": 0.3},
        "scintillation": {"sigma_at_6m_db": 3.0},
    }
    composed = compose(LEARNED, diagnosed(**causes))
    steps = np.arange(1, composed.law(Ping.of(distance=1.5)).last_step + 1)
    law = composed.law(Ping.of(distance=np.full(len(steps), 1.5)))
    total = np.exp(law.log_prob(Reading.of(steps * composed.resolution))).sum()
    assert total + law.no_echo[0] + law.no_answer[0] == pytest.approx(1.0, abs=1e-6)


def test_every_effect_of_the_catalogue_but_that_of_a_log_is_composed():
    for name, kind in CATALOGUE.items():
        if name == "latency":  # of a log: see the next test
            continue
        starts = {p.name: p.starts[0] for p in kind.parameters if p.starts}
        composed = compose(LEARNED, diagnosed(**{name: starts}))
        assert name in [each.name for each in composed.after.effects]
        law = composed.law(FAR)
        assert np.isfinite(law.log_prob(law.sample(np.random.default_rng(0)))).all(), name


def test_what_cannot_be_composed_is_warned_of():
    had = [effect("spike", probability=0.2), effect("travel_time_jitter", sigma_m=0.02)]
    fewer = diagnosed(had, spike={"probability": 0.05}, travel_time_jitter={"sigma_m": 0.002}, latency={"delay_s": 0.3})
    with pytest.warns(UserWarning, match=r"spike .*travel_time_jitter .*latency"):
        composed = compose("srf08-mlp", fewer)
    assert not any(each.name == "spike" for each in composed.after.effects)


def test_numbers_that_are_no_parameters_are_ignored():
    composed = compose(LEARNED, diagnosed(zero_offset={"offset_m": 0.02, "percent_at_1m": 2.0}))
    assert composed.after.effects[0].values == {"offset_m": 0.02}


def test_a_model_that_can_only_be_sampled_is_rejected():
    with pytest.raises(SettingError, match="can only be sampled"):
        compose(RigModel(), diagnosed(zero_offset={"offset_m": 0.01}))


def test_readings_are_drawn_from_the_law_also_where_outcome_and_range_have_a_number_each():
    composed = compose(LEARNED, diagnosed(zero_offset={"offset_m": 0.05}))
    assert composed.persistence == LEARNED.persistence
    assert compose(LEARNED, diagnosed(spike={"probability": 0.1, "span_m": 3.0})).persistence is None
    law = composed.law(Ping.of(distance=np.full(20_000, 2.5), angle=0.35, incidence=0.35, reflectance=0.4))
    drawn = law.sample(np.random.default_rng(0))
    reads = np.linspace(2.3, 2.8, 6)[:, None]
    below = np.mean(drawn.echo & (drawn.range <= reads + 1e-9), axis=1)
    np.testing.assert_allclose(below, law.cdf(reads)[:, 0], atol=0.015)
    assert drawn.echo.mean() == pytest.approx(law.echo[0], abs=0.015)


def test_an_offset_moves_the_readings_of_a_sonar_with_faults_as_a_whole():
    faulty = Faulty(LEARNED, [Noise(0.2, sigma=0.1), Constant(0.1, value=1.0)])
    edges = np.linspace(0.3, 3.5, 50)[:, None]
    moved = compose(faulty, diagnosed(zero_offset={"offset_m": 0.05})).law(FAR)
    np.testing.assert_allclose(moved.arrival(edges + 0.05), faulty.law(FAR).arrival(edges), atol=1e-6)
    assert moved.rate.tolist() == pytest.approx([0.7, 0.2, 0.1])


def test_the_composed_law_extrapolates_where_the_learned_one_does():
    composed = compose("srf08-mlp", diagnosed(zero_offset={"offset_m": 0.05}))
    with pytest.warns(ExtrapolationWarning):
        law = composed.law(Ping.of(distance=[1.0, 1.0], temperature_c=[20.0, 80.0]))
    assert law.extrapolates.tolist() == [False, True]


@pytest.mark.parametrize("name", ["srf08-mlp", "srf08-lstm"])
def test_a_saved_model_has_the_same_law_and_drives(tmp_path, name):
    causes = {"zero_offset": {"offset_m": 0.05}, "stale_repeat": {"probability": 0.2}}
    composed = compose(name, diagnosed(**causes))
    loaded = load_model(save_model(composed, tmp_path / "composed"))
    assert isinstance(loaded, ComposedModel)
    run = Ping.of(distance=np.linspace(0.5, 2.0, 40))
    one, two = (simulate(model, run, np.random.default_rng(1)) for model in (composed, loaded))
    np.testing.assert_array_equal(one.range, two.range)
    assert np.mean(np.diff(one.range) == 0) > 0.05
    for sonar in (composed, str(tmp_path / "composed")):
        environment = gymnasium.make("SonarParking-v0", sonar=sonar, credence_driver=None)
        environment.reset(seed=0)
        environment.step(environment.action_space.sample())
        environment.close()


def test_the_name_in_the_package_remains_the_function():
    assert noise.compose is compose


def test_a_cause_acts_on_the_readings_of_a_simulation():
    loud = {"sensitivity": {"loss_db": 0.0}}
    forest = AnalogueForest.of(batch_of(loud), np.random.default_rng(0))
    moved, left_out = with_differences(forest, {}, {"zero_offset": {"offset_m": 0.03}})
    assert not left_out
    new = batch_of(loud, seed=1).ping
    change = moved.law(new).quantile(0.5) - forest.law(new).quantile(0.5)
    np.testing.assert_allclose(change, 0.03, atol=1.5e-3)


def test_what_cannot_be_taken_out_of_a_law_is_named():
    before = {"false_alarm": {"per_metre": 0.1}}
    _, left_out = with_differences(LEARNED, before, {"false_alarm": {"per_metre": 0.01}})
    assert set(left_out) == {"false_alarm"}
