"""The laws of the catalogue, stated once; every member runs through them."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from acquisition import EchoStatus, Ping, Reading, Recording, SettingError
from noise.cells import Batch
from noise.effects import CATALOGUE, Conditions
from noise.effects.medium import ASSUMED_SPEED, ASSUMED_TEMPERATURE_C, sound_speed
from noise.effects.mounting import directivity
from noise.effects.receiver import HALF_WAVE
from noise.fit import best_of, log_likelihood
from noise.physical import PhysicalModel
from noise.stack import Stack
from noise.starts import starting_points

torch.set_num_threads(1)
MEMBERS = pytest.mark.parametrize("name", CATALOGUE)
FINE = {"period_s": 1e-11}  # a clock of 71 ms turns 35,000 times in the time that these pings take
STEP, REACH = 0.01, 6.0  # a coarse register, so that whole laws can be summed


def ordinary(*left_out):
    """Effects under which every other one can show: finite levels, a beam, scatter wider than a step."""
    stack = {
        "sensitivity": {"loss_db": 46.0},
        "beam_width": {"ka": 4.8},
        "travel_time_jitter": {"sigma_m": 0.008},
        "specular_loss": {"strength": 0.5},
    }
    return [CATALOGUE[name](**values) for name, values in stack.items() if name not in left_out]


def conditions(copies=1):
    """Return 8 varied conditions, each `copies` times in a row, with what came before them."""
    d = np.array([0.2, 0.6, 1.2, 1.8, 2.5, 3.4, 4.4, 5.5])
    ping = Ping.of(
        distance=d,
        angle=np.radians([0, 4, 12, 25, 0, 8, 2, 0]),
        incidence=np.radians([0, 30, 12, 3, 1, 2, 0, 20]),
        reflectance=[0.9, 0.1, 0.9, 0.5, 0.1, 0.9, 0.9, 0.9],
        time=np.linspace(30.0, 2500.0, 8),
        interval_s=[0.065, 0.04, 0.05, 0.06, 0.05, 0.065, 0.0, 0.055],
        temperature_c=[5.0, 12.0, 18.0, 20.0, 24.0, 28.0, 31.0, 35.0],
    )
    past = Reading.of([0.3, 0.0, 1.3, 0.0, 2.5, 3.3, 4.2, 0.0], [1, 0, 1, 2, 1, 1, 1, 0])
    rows = np.repeat(np.arange(8), copies)
    return ping[rows], past[rows]


def at_start(name):
    """Return the effect where a fit would begin; well off its null where that is where a fit begins."""
    parameters = CATALOGUE[name].parameters
    if any(p.starts[-1] != p.null for p in parameters):
        return CATALOGUE[name](**{p.name: p.starts[-1] for p in parameters})
    return CATALOGUE[name](**{p.name: p.null + 0.3 * (p.high - p.null) for p in parameters})


def whole_register(model):
    """Return P(each step), P(no echo), P(no answer), by log_prob alone: (8, steps), (8,), (8,)."""
    steps = round(REACH / STEP)
    ping, past = conditions(copies=steps)
    law = model.law(ping, past)
    each = np.exp(law.log_prob(Reading.of(np.tile(np.arange(1, steps + 1) * STEP, 8)))).reshape(8, steps)
    silent = np.exp(law.log_prob(Reading.of(np.zeros(len(ping))))).reshape(8, steps)[:, 0]
    dead = np.exp(law.log_prob(Reading.of(np.zeros(len(ping)), np.full(len(ping), EchoStatus.NO_ANSWER))))
    return each, silent, dead.reshape(8, steps)[:, 0]


def some_readings():
    ping, past = conditions(copies=6)
    near = np.round((ping.distance + np.tile([-0.05, -0.01, 0.0, 0.02, 0.0, 0.0], 8)) / STEP) * STEP
    status = np.tile([1, 1, 1, 1, 0, 2], 8)
    return ping, past, Reading.of(np.where(status == 1, near, 0.0), status)


DESIGNED = """sound_speed thermal_drift air_absorption scintillation beam_width boresight zero_offset pivot_offset
specular_loss edge_diffraction perpendicular_foot background_reflector fixed_clutter multipath repeated_bounce
sensitivity time_walk cycle_slip ring_down false_alarm rearm_dead_time quantisation range_gate clock_scale warm_up
previous_ping synchronous_crosstalk asynchronous_crosstalk dropped_reading stale_repeat stuck spike noise_burst
corrupted_byte"""


def test_the_catalogue_holds_every_effect_that_can_be_named():
    assert set(DESIGNED.split()) <= set(CATALOGUE)
    assert len(CATALOGUE) >= 35


@MEMBERS
def test_every_member_is_told_in_full(name):
    effect = CATALOGUE[name]
    assert effect.name == name
    assert effect.summary
    assert not effect.summary.endswith(".")
    for p in effect.parameters:
        assert p.unit
        assert p.source
        assert p.low < p.high
        assert p.low <= p.null <= p.high or p.null == 0.0
        assert p.starts, f"{name}.{p.name} gives a fit nowhere to begin"
        assert all(p.low <= start <= p.high for start in p.starts)
    assert math.prod(len(p.starts) for p in effect.parameters) <= 9


@MEMBERS
def test_null_leaves_the_law_alone(name):
    ping, past, reading = some_readings()
    for stack in ([], ordinary(name)):
        without = PhysicalModel(stack, STEP, REACH).law(ping, past).log_prob_tensor(reading)
        with_null = PhysicalModel([*stack, CATALOGUE[name]()], STEP, REACH).law(ping, past).log_prob_tensor(reading)
        np.testing.assert_allclose(with_null.numpy(), without.numpy(), rtol=0, atol=1e-12)


@MEMBERS
def test_a_start_changes_the_law(name):
    keen = [CATALOGUE["sensitivity"](loss_db=10.0), CATALOGUE["specular_loss"](strength=2.0)]
    change = 0.0
    for stack in (ordinary(name), keen):  # weak ways show where the direct one is lost and the receiver is keen
        without = whole_register(PhysicalModel(stack, STEP, REACH))
        stack = [effect for effect in stack if effect.name != name]
        changed = whole_register(PhysicalModel([*stack, at_start(name)], STEP, REACH))
        change = max(change, *(np.abs(a - b).max() for a, b in zip(without, changed, strict=True)))
    assert change > 1e-3


@MEMBERS
def test_probabilities_sum_to_one(name):
    each, silent, dead = whole_register(PhysicalModel([*ordinary(name), at_start(name)], STEP, REACH))
    assert np.all(each >= 0)
    np.testing.assert_allclose(each.sum(axis=1) + silent + dead, 1.0, atol=1e-12)


@MEMBERS
def test_samples_agree_with_log_prob(name):
    model = PhysicalModel([*ordinary(name), at_start(name)], STEP, REACH)
    each, silent, dead = whole_register(model)
    copies = 2000
    ping, past = conditions(copies)
    drawn = model.law(ping, past).sample(np.random.default_rng(0))
    kind = np.where(drawn.echo, np.rint(drawn.range / STEP).astype(int), -drawn.status.astype(int)).reshape(8, copies)
    for row in range(8):
        expected = copies * np.concatenate([[dead[row], silent[row]], each[row]])
        observed = np.bincount(np.where(kind[row] == -2, 0, kind[row] + 1), minlength=len(expected))
        few = expected < 8
        counts = [np.append(x[~few], x[few].sum()) for x in (observed, expected)]
        keep = counts[1] > 1e-9
        assert np.all(counts[0][~keep] == 0)
        if keep.sum() > 1:
            # 8 rows of 34 members: one in 1e6 keeps the whole catalogue's false alarms below one in 3000
            assert stats.chisquare(counts[0][keep], counts[1][keep] * copies / counts[1][keep].sum()).pvalue > 1e-6


@MEMBERS
@pytest.mark.parametrize("place", ["null", "start"])
def test_gradients_are_finite(name, place):
    ping, past, reading = some_readings()
    effect = CATALOGUE[name]() if place == "null" else at_start(name)
    leaves = {key: torch.tensor(value, dtype=torch.float64, requires_grad=True) for key, value in effect.values.items()}
    model = PhysicalModel([*ordinary(name), CATALOGUE[name](**leaves)], STEP, REACH)
    total = model.law_of(Conditions.of(ping, past)).log_prob_tensor(reading).sum()
    if not total.requires_grad:
        assert name in ("quantisation", "truncation"), "only a step may be without a derivative"
        return
    for gradient in torch.autograd.grad(total, list(leaves.values()), allow_unused=True):
        assert gradient is None or torch.isfinite(gradient)


@MEMBERS
def test_gradients_are_those_of_differences(name):
    if name in ("quantisation", "truncation", "stuck"):
        pytest.skip("a place on the grid has no derivative, as its docstring says")
    ping, past, reading = some_readings()
    values = at_start(name).values

    def total(**changed):
        effect = CATALOGUE[name](**{**values, **changed})
        law = PhysicalModel([*ordinary(name), effect], STEP, REACH).law_of(Conditions.of(ping, past))
        return law.log_prob_tensor(reading).sum()

    for p in CATALOGUE[name].parameters:
        inside = min(max(values[p.name], p.low + 1e-4 * (p.high - p.low)), p.high - 1e-4 * (p.high - p.low))
        leaf = torch.tensor(inside, dtype=torch.float64, requires_grad=True)
        # readings that the law all but excludes have steep logarithms: compare by central differences of a small step
        h = FINE.get(p.name, 1e-6) * (p.high - p.low)
        slope = float(torch.autograd.grad(total(**{p.name: leaf}), leaf)[0])
        difference = float(total(**{p.name: inside + h}) - total(**{p.name: inside - h})) / (2 * h)
        assert slope == pytest.approx(difference, rel=2e-3, abs=2e-3)


@MEMBERS
def test_order_in_the_stack_does_not_matter(name):
    ping, past, reading = some_readings()
    stack = [*ordinary(name), at_start(name)]
    there = PhysicalModel(stack, STEP, REACH).law(ping, past).log_prob(reading)
    back = PhysicalModel(stack[::-1], STEP, REACH).law(ping, past).log_prob(reading)
    np.testing.assert_array_equal(there, back)


@MEMBERS
def test_round_trip_through_plain_data(name):
    ping, past, reading = some_readings()
    model = PhysicalModel([at_start(name)], STEP, REACH)
    again = PhysicalModel.from_dict(model.to_dict())
    assert again.to_dict() == model.to_dict()
    np.testing.assert_array_equal(again.law(ping, past).log_prob(reading), model.law(ping, past).log_prob(reading))


@MEMBERS
def test_statement_is_a_sentence_with_a_number(name):
    sentence = at_start(name).statement()
    assert sentence[0].isupper()
    assert sentence.endswith(".")
    assert any(letter.isdigit() for letter in sentence)


@MEMBERS
def test_tensor_and_array_likelihoods_agree(name):
    ping, past, reading = some_readings()
    law = PhysicalModel([*ordinary(name), at_start(name)], STEP, REACH).law(ping, past)
    floor = math.log(1e-300)
    # the array form takes 1 - P(echo) where the tensor form does too: both lose digits below 1e-12
    np.testing.assert_allclose(
        np.exp(np.maximum(law.log_prob(reading), floor)), np.exp(law.log_prob_tensor(reading).numpy()), atol=1e-14
    )


@MEMBERS
def test_values_outside_the_bounds_are_refused(name):
    p = CATALOGUE[name].parameters[0]
    with pytest.raises(SettingError, match=rf"{name}\.{p.name} must lie in \["):
        CATALOGUE[name](**{p.name: p.high + (p.high - p.low)})
    with pytest.raises(TypeError, match="has no parameter 'colour'"):
        CATALOGUE[name](colour=1.0)


def median(effects, **condition):
    return float(PhysicalModel(effects, 1e-5, 11.008).law(Ping.of(**condition)).quantile(0.5)[0])


def test_sound_speed_scales_by_temperature():
    assert float(sound_speed(torch.tensor(0.0))) == pytest.approx(331.3)
    assert pytest.approx(22.8, abs=0.05) == ASSUMED_TEMPERATURE_C
    # dry air of 19 degC: +0.60 %, physics of c = 331.3 sqrt(1 + T / 273.15) against 58 us/cm
    read = median([CATALOGUE["sound_speed"](temperature_c=19.0)], distance=6.0)
    assert read == pytest.approx(6.0 * 1.0065, abs=0.003)
    assert read == pytest.approx(6.0 * ASSUMED_SPEED / float(sound_speed(torch.tensor(19.0))), abs=2e-5)
    sentence = CATALOGUE["sound_speed"](temperature_c=31.2).statement()
    assert sentence.startswith("Readings run short by 1.4 % of distance: the air was at 31.2 degC")


def test_thermal_drift_of_one_kelvin_is_ten_millimetres_at_six_metres():
    drift = CATALOGUE["thermal_drift"](rate_k_per_h=1.0)
    assert median([drift], distance=6.0, time=3600.0) == pytest.approx(6.0 - 0.0101, abs=3e-4)
    assert median([drift], distance=6.0, time=0.0) == pytest.approx(6.0, abs=1e-5)


def level(effects, **condition):
    state = PhysicalModel(effects).state(Conditions.of(Ping.of(**condition)))
    return state.direct.level_db[0].numpy()


def test_absorption_takes_15_db_at_6_m():
    clean, humid = level([], distance=6.0), level([CATALOGUE["air_absorption"](alpha_db_per_m=1.29)], distance=6.0)
    assert clean - humid == pytest.approx(15.48)


def test_a_beam_of_ka_4_8_has_the_published_two_way_losses():
    angle = np.radians([5.0, 10.0, 15.0, 20.0, 22.5, 25.0, 30.0])
    loss = level([CATALOGUE["beam_width"](ka=4.80)], distance=1.0, angle=angle) - level([], distance=1.0)
    np.testing.assert_allclose(loss, [-0.4, -1.5, -3.5, -6.2, -7.9, -9.9, -14.5], atol=0.06)
    assert "55 deg" in CATALOGUE["beam_width"](ka=4.80).statement()


def test_directivity_is_that_of_bessel():
    from scipy.special import j1

    x = np.linspace(1e-3, 8.0, 50)
    np.testing.assert_allclose(directivity(torch.tensor(x)).numpy(), 2 * j1(x) / x, atol=1e-12)


def test_boresight_turns_the_beam():
    stack = [CATALOGUE["beam_width"](ka=4.8), CATALOGUE["boresight"](yaw_deg=10.0)]
    on_beam, mirrored = level(stack, distance=1.0, angle=np.radians([10.0, -10.0]))
    assert on_beam == pytest.approx(60.0)
    assert mirrored == pytest.approx(60.0 - 6.2, abs=0.06)


def test_pivot_of_300_mm_adds_88_mm_at_45_degrees():
    pivot = CATALOGUE["pivot_offset"](axial_m=0.3)
    assert median([pivot], distance=1.0, incidence=np.radians(45)) == pytest.approx(1.088, abs=5e-4)


def test_parallax_of_25_mm_is_two_and_a_half_millimetres_at_30_mm():
    parallax = CATALOGUE["baseline_parallax"](spacing_m=0.025)
    assert median([parallax], distance=0.030) == pytest.approx(0.0325, abs=1e-4)
    assert median([parallax], distance=0.5) == pytest.approx(0.50016, abs=2e-5)


def test_specular_loss_is_that_of_a_plate():
    lost = CATALOGUE["specular_loss"](strength=1.0, half_width_m=0.1)
    angle = np.radians([0.0, 5.0, 10.0, 15.0, 20.0])
    loss = level([lost], distance=1.0, incidence=angle) - level([], distance=1.0)
    # Kirchhoff integrals of a disc and a plate of that size at 1 m: 0, -5/-7, -20/-21, -27/-23, -30/-23 dB
    np.testing.assert_allclose(loss, [0.0, -6.0, -20.5, -25.0, -26.5], atol=3.5)


def test_tilted_face_reads_its_perpendicular_foot_while_it_is_seen():
    foot = CATALOGUE["perpendicular_foot"](share=1.0)
    assert median([foot], distance=1.0, incidence=np.radians(5)) == pytest.approx(1 - 0.0038, abs=4e-4)
    assert median([foot], distance=1.0, incidence=np.radians(40)) == pytest.approx(1.0, abs=1e-5)


def test_edge_echo_is_36_mm_early_at_22_5_degrees_and_33_db_weaker_at_1_m():
    edge = CATALOGUE["edge_diffraction"](presence=1.0)
    state = PhysicalModel([edge]).state(Conditions.of(Ping.of(distance=1.0, incidence=[0.0, np.radians(22.5)])))
    assert float(state.paths[1].length[1]) == pytest.approx(1 - 0.036, abs=3e-3)
    assert float(state.paths[1].level_db[0, 0] - state.paths[0].level_db[0, 0]) == pytest.approx(-33.6, abs=0.1)


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        ({"background_reflector": {"presence": 1.0, "behind_m": 0.3}}, 2.3),
        ({"multipath": {"presence": 1.0, "height_m": 1.5}}, 2.80),
        ({"repeated_bounce": {"presence": 1.0}}, 4.0),
        ({"fixed_clutter": {"presence": 1.0, "range_m": 3.25}}, 3.25),
        ({"synchronous_crosstalk": {"presence": 1.0, "other_m": 2.6}}, 2.3),
        ({"previous_ping": {"presence": 1.0, "far_m": 14.0}}, 14.0 - ASSUMED_SPEED * 0.065 / 2),
    ],
    ids=lambda x: next(iter(x)) if isinstance(x, dict) else "",
)
def test_the_way_behind_is_read_when_the_reflector_is_missed(effect, expected):
    stack = [CATALOGUE[name](**values) for name, values in effect.items()]
    law = PhysicalModel(stack).law(Ping.of(distance=2.0))
    if expected > 2.0:  # first echo wins
        assert law.quantile(0.5)[0] == pytest.approx(2.0)
    gone = [CATALOGUE["specular_loss"](strength=2.0), CATALOGUE["sensitivity"](loss_db=10.0)]
    law = PhysicalModel([*stack, *gone]).law(Ping.of(distance=2.0, incidence=np.radians(60)))
    assert law.quantile(0.5)[0] == pytest.approx(expected, abs=0.01)


def test_a_wall_behind_answers_at_every_angle_and_a_post_only_in_the_beam():
    beam, angle = CATALOGUE["beam_width"](ka=4.8), np.radians([0.0, 20.0])
    loss = []
    for follow in (0.0, 1.0):
        behind = CATALOGUE["background_reflector"](presence=1.0, behind_m=0.4, follow=follow)
        state = PhysicalModel([beam, behind]).state(Conditions.of(Ping.of(distance=[2.0] * 2, angle=angle)))
        loss.append(float(state.paths[1].level_db[0].diff()[0]))
    np.testing.assert_allclose(loss, [0.0, -6.2], atol=0.06)  # two-way loss of the beam at 20 deg


def test_warm_air_stretches_the_way_of_a_previous_ping_but_not_the_interval():
    stack = [CATALOGUE["previous_ping"](presence=1.0, far_m=12.0), CATALOGUE["sound_speed"](temperature_c=0.0)]
    law = PhysicalModel(stack).law(Ping.of(distance=5.0, interval_s=0.06))
    assert law.quantile(0.5)[0] == pytest.approx(12.0 * ASSUMED_SPEED / 331.3 - ASSUMED_SPEED * 0.03, abs=0.001)


def test_no_previous_ping_no_ghost():
    ghost = CATALOGUE["previous_ping"](presence=1.0, far_m=12.0)
    law = PhysicalModel([ghost]).law(Ping.of(distance=5.0, interval_s=[0.0, 0.2]))
    np.testing.assert_allclose(law.quantile(0.5), 5.0)


def test_time_walk_follows_its_table():
    walk = CATALOGUE["time_walk"](scale=1.0)
    for margin, late in ((20.0, 0.0135), (2.0, 0.044), (12.0, 0.022)):
        loss = CATALOGUE["sensitivity"](loss_db=60.0 - margin)
        assert median([walk, loss], distance=1.0) == pytest.approx(1.0 + late, abs=5e-5)


def test_cycle_slip_is_a_comb():
    law = PhysicalModel([CATALOGUE["cycle_slip"](probability=0.3)], 1e-5).law(Ping.of(distance=[1.0] * 3))
    at = 1.0 + HALF_WAVE * np.arange(3)
    np.testing.assert_allclose(law.cdf(at + 1e-4) - law.cdf(at - 1e-4), [0.7, 0.21, 0.09], atol=1e-9)


def test_scintillation_softens_detection_as_a_wider_normal():
    # a normal level of spread s over a threshold of spread w is one of spread sqrt(s^2 + w^2)
    loss = CATALOGUE["sensitivity"](loss_db=43.0)
    air = CATALOGUE["scintillation"](sigma_at_6m_db=2.0)
    margin = 60.0 - 43.0 - 20 * math.log10(6.0)
    echo = PhysicalModel([loss, air]).law(Ping.of(distance=6.0)).echo[0]
    assert echo == pytest.approx(stats.norm.cdf(margin / math.hypot(2.0, 1.5)), abs=2e-3)


def test_false_alarms_come_before_the_echo_only():
    law = PhysicalModel([CATALOGUE["false_alarm"](per_metre=0.05)]).law(Ping.of(distance=[2.0, 4.0]))
    np.testing.assert_allclose(law.cdf(np.array([1.9, 3.9])), 1 - np.exp(-0.05 * np.array([1.9005, 3.9005])), atol=1e-9)
    np.testing.assert_allclose(law.cdf(np.array([2.1, 4.1])), 1.0)


def test_ring_down_begins_at_the_end_of_blanking_and_thins_out():
    ring = CATALOGUE["ring_down"](probability=0.4, range_m=0.1, decay_m=0.05)
    law = PhysicalModel([ring], 1e-4).law(Ping.of(distance=[2.0] * 3))
    expected = 0.4 * (1 - np.exp(-np.array([0.0, 0.05, 0.10]) / 0.05))
    np.testing.assert_allclose(law.cdf(np.array([0.0999, 0.15, 0.20])), expected, atol=1e-3)


def test_quantised_readings_lie_on_the_steps():
    model = PhysicalModel([CATALOGUE["quantisation"](step_m=0.01), CATALOGUE["travel_time_jitter"](sigma_m=0.02)])
    drawn = model.law(Ping.of(distance=np.full(500, 1.234))).sample(np.random.default_rng(1))
    np.testing.assert_allclose(drawn.range * 100, np.rint(drawn.range * 100), atol=1e-9)
    assert drawn.range.mean() == pytest.approx(1.234, abs=0.003)


def test_cut_readings_lie_on_the_steps_and_run_half_a_step_short():
    model = PhysicalModel([CATALOGUE["truncation"](step_m=0.01), CATALOGUE["zero_offset"](offset_m=0.002)])
    law = model.law(Ping.of(distance=[1.2379, 1.2381, 1.2479]))
    np.testing.assert_allclose(law.quantile(0.5), [1.23, 1.24, 1.24], atol=1e-9)
    spread = np.random.default_rng(3).uniform(1.0, 3.0, 4000)
    drawn = PhysicalModel([CATALOGUE["truncation"](step_m=0.01)]).law(Ping.of(distance=spread)).sample
    assert np.mean(drawn(np.random.default_rng(4)).range - spread) == pytest.approx(-0.005, abs=3e-4)


def test_a_sensor_without_a_thermometer_reads_warm_air_short_by_the_log():
    stack = [CATALOGUE["sound_speed"](temperature_c=20.0, logged_share=1.0)]
    logged = np.array([0.0, 20.0, 40.0])
    law = PhysicalModel(stack, 1e-5).law(Ping.of(distance=[3.0] * 3, temperature_c=logged))
    expected = 3.0 * ASSUMED_SPEED / sound_speed(torch.tensor(logged)).numpy()
    np.testing.assert_allclose(law.quantile(0.5), expected, atol=2e-5)
    assert "for every kelvin that the thermometer rises" in stack[0].statement()
    assert "-0.17 %" in stack[0].statement()  # half of 1 / 293 K


def test_a_parameter_counts_where_its_covariate_was_logged_and_varies():
    share = CATALOGUE["sound_speed"].parameters[1]
    assert share.tellable({"temperature_c": np.array([18.0, 22.0])})
    assert not share.tellable({"temperature_c": np.array([18.0, 18.5])})
    assert not share.tellable({})


def test_gate_silences_what_lies_beyond():
    law = PhysicalModel([CATALOGUE["range_gate"](listen_m=3.0)]).law(Ping.of(distance=[2.9, 3.1]))
    np.testing.assert_allclose(law.echo, [1.0, 0.0])


def test_warm_up_dies_away():
    warm = CATALOGUE["warm_up"](offset_m=0.02, tau_s=100.0)
    law = PhysicalModel([warm], 1e-5).law(Ping.of(distance=1.0, time=[0.0, 100.0, 5000.0]))
    np.testing.assert_allclose(law.quantile(0.5), [1.02, 1.0 + 0.02 / math.e, 1.0], atol=2e-5)


def test_reflectance_of_a_tenth_costs_20_db():
    soft = CATALOGUE["reflectance_loss"](strength=1.0)
    assert level([soft], distance=1.0, reflectance=0.1) == pytest.approx(40.0)


def test_deaf_ears_lose_what_is_near_but_not_what_follows():
    late = CATALOGUE["rearm_dead_time"](deaf_m=0.5)
    law = PhysicalModel([late]).law(Ping.of(distance=[0.45, 0.55]))
    np.testing.assert_allclose(law.echo, [0.0, 1.0])
    behind = CATALOGUE["background_reflector"](presence=1.0, behind_m=0.3, loss_db=10.0)
    assert PhysicalModel([late, behind]).law(Ping.of(distance=0.45)).quantile(0.5)[0] == pytest.approx(0.75)


def test_deaf_ears_hear_no_false_alarm_either():
    stack = [CATALOGUE["rearm_dead_time"](deaf_m=0.5), CATALOGUE["false_alarm"](per_metre=0.2)]
    law = PhysicalModel(stack).law(Ping.of(distance=[2.0, 2.0]))
    np.testing.assert_allclose(law.cdf(np.array([0.499, 1.5])), [0.0, 1 - np.exp(-0.2)], atol=2e-4)


def test_another_clock_is_early_by_what_the_intervals_differ():
    other = CATALOGUE["asynchronous_crosstalk"](presence=1.0, period_s=0.07, first_s=0.01, spread_m=0.002)
    law = PhysicalModel([other]).law(Ping.of(distance=[5.0] * 4, time=[0.0, 0.001, 0.065, 0.0701]))
    expected = ASSUMED_SPEED / 2 * np.array([0.01, 0.009, 0.015, 0.0099])
    np.testing.assert_allclose(law.quantile(0.5), expected, atol=0.001)


def test_a_wrong_bit_moves_the_count_by_a_power_of_two():
    model = PhysicalModel([CATALOGUE["corrupted_byte"](probability=0.5, unit_m=0.01)], 0.01, 11.0)
    drawn = model.law(Ping.of(distance=np.full(2000, 1.5))).sample(np.random.default_rng(2))
    off = np.abs(np.rint(drawn.range * 100) - 150)
    moved = off[(off > 1) & (off < 900)]  # the register ends at 11 m
    nearest = 2.0 ** np.rint(np.log2(moved))
    assert np.mean(np.abs(moved - nearest) <= 1) > 0.98
    # of 16 bits up and 8 down, none below zero, the lowest hide in the rounding and the highest in the register's end
    assert len(moved) / len(drawn) == pytest.approx(0.5 * 16 / 24, abs=0.04)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rearm_dead_time", {"deaf_m": 0.62}),
        ("asynchronous_crosstalk", {"presence": 0.6, "period_s": 0.0917, "first_s": 0.031, "spread_m": 0.02}),
        ("corrupted_byte", {"probability": 0.08, "unit_m": 0.01}),
    ],
)
def test_what_was_put_in_is_found_again(name, values):
    rng = np.random.default_rng(5)
    scatter = CATALOGUE["travel_time_jitter"](sigma_m=0.004)
    ping = Ping.of(distance=rng.uniform(0.3, 4.0, 900), time=np.cumsum(rng.uniform(0.09, 0.11, 900)))
    heard = PhysicalModel([scatter, CATALOGUE[name](**values)]).law(ping).sample(rng)
    batch = Batch.of(Recording.of(ping, heard))
    plain = Stack.of(PhysicalModel([scatter]))
    keys = [(name, p.name) for p in CATALOGUE[name].parameters]
    starts = sorted(starting_points(plain, name, batch, rng), key=lambda s: -log_likelihood(s, batch).sum())
    found = best_of(starts[:2], keys, batch)
    for key, value in values.items():
        assert found.stack.get((name, key)) == pytest.approx(value, rel=0.25, abs=0.001)
