"""Each effect against published numbers and calculations by hand."""

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from acquisition import Ping, Recording
from noise.effects import CATALOGUE, Conditions
from noise.effects.medium import ASSUMED_SPEED, ASSUMED_TEMPERATURE_C, sound_speed
from noise.effects.mounting import directivity
from noise.effects.receiver import HALF_WAVE, WALK_DB, WALK_M
from noise.effects.state import DETECTION_WIDTH_DB
from noise.fitting.batch import Batch
from noise.fitting.fit import best_of
from noise.fitting.likelihood import log_likelihood
from noise.fitting.stack import Stack
from noise.fitting.starts import starting_points
from noise.physical import PhysicalModel

torch.set_num_threads(1)


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


def test_directivity_agrees_with_the_bessel_function():
    from scipy.special import j1

    x = np.linspace(1e-3, 8.0, 50)
    np.testing.assert_allclose(directivity(torch.tensor(x)).numpy(), 2 * j1(x) / x, atol=1e-12)


def test_boresight_rotates_the_beam():
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


def test_a_ray_cone_reads_the_shortest_ray_that_meets_the_face():
    """The reading is that of a fan of 20,001 rays, each intersected with a plate by its end points."""
    rng = np.random.default_rng(1)
    half, width, steepest = np.radians(18.0), 0.25, np.radians(50.0)
    distance, angle, incidence = rng.uniform(0.4, 4.0, 300), rng.uniform(-0.7, 0.7, 300), rng.uniform(-0.9, 0.9, 300)
    ray = np.linspace(-half, half, 20_001)
    expected = np.full(300, np.inf)
    for k in range(300):
        centre, along = distance[k] * np.exp(1j * angle[k]), 1j * np.exp(1j * (angle[k] - incidence[k]))
        turned = np.exp(-1j * ray)  # into the frame of each ray, where it is the real axis
        first, last = (centre - width * along) * turned, (centre + width * along) * turned
        share = first.imag / (first.imag - last.imag)
        reach = first.real + share * (last.real - first.real)
        steep = np.abs(ray - angle[k] + incidence[k])
        met = (share >= 0.0) & (share <= 1.0) & (reach > 0.0) & (steep < steepest)
        expected[k] = reach[met].min() if met.any() else np.inf
    cone = CATALOGUE["ray_cone"](half_deg=18.0, half_width_m=width, steepest_deg=50.0)
    state = PhysicalModel([cone]).state(Conditions.of(Ping.of(distance=distance, angle=angle, incidence=incidence)))
    lost_db = level([], distance=distance) - state.direct.level_db[0].numpy()
    met = np.isfinite(expected)
    assert 100 < met.sum() < 250
    np.testing.assert_allclose(state.direct.length.numpy()[met], expected[met], rtol=1e-3)
    assert lost_db[met].max() < 0.1  # a fan has gaps
    assert lost_db[~met].min() > 0.0
    mirrored = PhysicalModel([cone]).state(
        Conditions.of(Ping.of(distance=distance, angle=-angle, incidence=-incidence))
    )
    np.testing.assert_allclose(mirrored.direct.length.numpy(), state.direct.length.numpy(), rtol=1e-12)


def test_specular_loss_is_that_of_a_plate():
    lost = CATALOGUE["specular_loss"](strength=1.0, half_width_m=0.1)
    angle = np.radians([0.0, 5.0, 10.0, 15.0, 20.0])
    loss = level([lost], distance=1.0, incidence=angle) - level([], distance=1.0)
    # Kirchhoff integrals of a disc and a plate of that size at 1 m: 0, -5/-7, -20/-21, -27/-23, -30/-23 dB
    np.testing.assert_allclose(loss, [0.0, -6.0, -20.5, -25.0, -26.5], atol=3.5)


def test_a_slightly_tilted_face_is_read_at_the_foot_of_the_perpendicular():
    foot = CATALOGUE["perpendicular_foot"](share=1.0)
    assert median([foot], distance=1.0, incidence=np.radians(5)) == pytest.approx(1 - 0.0038, abs=4e-4)
    assert median([foot], distance=1.0, incidence=np.radians(40)) == pytest.approx(1.0, abs=1e-5)


def test_edge_echo_is_36_mm_early_at_22_5_degrees_and_33_db_weaker_at_1_m():
    edge = CATALOGUE["edge_diffraction"](presence=1.0)
    state = PhysicalModel([edge]).state(Conditions.of(Ping.of(distance=1.0, incidence=[0.0, np.radians(22.5)])))
    assert float(state.paths[1].length[1]) == pytest.approx(1 - 0.036, abs=3e-3)
    assert float(state.paths[1].level_db[0, 0] - state.paths[0].level_db[0, 0]) == pytest.approx(-33.6, abs=0.1)


@pytest.mark.parametrize(
    ("effect", "later"),
    [
        (lambda missed: CATALOGUE["repeated_bounce"](presence=0.0, missed=missed), lambda d: 2.0 * d),
        (
            lambda missed: CATALOGUE["multipath"](presence=0.0, height_m=0.5, missed=missed),
            lambda d: 0.5 * (np.hypot(d, 1.0) + d),
        ),
    ],
    ids=["repeated_bounce", "multipath"],
)
@given(st.floats(0.0, 0.5), st.floats(0.3, 3.0), st.floats(-0.02, 0.02), st.floats(-0.05, 0.05))
def test_a_later_echo_is_read_where_a_loud_first_one_is_missed(effect, later, missed, distance, error, offset_m):
    effects = [effect(missed), CATALOGUE["clock_scale"](error=error), CATALOGUE["zero_offset"](offset_m=offset_m)]
    law = PhysicalModel(effects).law(Ping.of(distance=distance))
    for exact, share in ((distance, 1.0 - missed), (later(distance), missed)):
        at = exact * (1.0 + error) + offset_m
        assert (law.cdf(at + 0.002) - law.cdf(at - 0.002))[0] == pytest.approx(share, abs=1e-6)


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
def test_the_second_path_is_read_when_the_direct_echo_is_missed(effect, expected):
    stack = [CATALOGUE[name](**values) for name, values in effect.items()]
    law = PhysicalModel(stack).law(Ping.of(distance=2.0))
    if expected > 2.0:  # first echo wins
        assert law.quantile(0.5)[0] == pytest.approx(2.0)
    gone = [CATALOGUE["specular_loss"](strength=2.0), CATALOGUE["sensitivity"](loss_db=10.0)]
    law = PhysicalModel([*stack, *gone]).law(Ping.of(distance=2.0, incidence=np.radians(60)))
    assert law.quantile(0.5)[0] == pytest.approx(expected, abs=0.01)


def test_a_wall_behind_has_no_beam_loss_and_a_post_has():
    beam, angle = CATALOGUE["beam_width"](ka=4.8), np.radians([0.0, 20.0])
    loss = []
    for follow in (0.0, 1.0):
        behind = CATALOGUE["background_reflector"](presence=1.0, behind_m=0.4, follow=follow)
        state = PhysicalModel([beam, behind]).state(Conditions.of(Ping.of(distance=[2.0] * 2, angle=angle)))
        loss.append(float(state.paths[1].level_db[0].diff()[0]))
    np.testing.assert_allclose(loss, [0.0, -6.2], atol=0.06)  # two-way loss of the beam at 20 deg


def test_temperature_scales_the_path_of_a_previous_ping_but_not_the_interval():
    stack = [CATALOGUE["previous_ping"](presence=1.0, far_m=12.0), CATALOGUE["sound_speed"](temperature_c=0.0)]
    law = PhysicalModel(stack).law(Ping.of(distance=5.0, interval_s=0.06))
    assert law.quantile(0.5)[0] == pytest.approx(12.0 * ASSUMED_SPEED / 331.3 - ASSUMED_SPEED * 0.03, abs=0.001)


@given(st.floats(0.0, 2.0), st.floats(3.0, 5.0), st.floats(-1.0, 1.0), st.floats(0.03, 0.05))
def test_an_echo_of_the_previous_ping_comes_from_where_its_target_was(trips, distance, rate_mps, interval_s):
    far_m = ASSUMED_SPEED * interval_s / 2.0 + 0.5 - trips * (distance - rate_mps * interval_s)
    assume(far_m >= 0.0)
    effect = CATALOGUE["previous_ping"](presence=1.0, far_m=far_m, trips=trips)
    law = PhysicalModel([effect]).law(Ping.of(distance=distance, interval_s=interval_s, range_rate_mps=rate_mps))
    assert law.cdf(0.502)[0] - law.cdf(0.498)[0] > 0.99


def test_the_first_ping_has_no_echo_of_a_previous_one():
    effect = CATALOGUE["previous_ping"](presence=1.0, far_m=12.0)
    law = PhysicalModel([effect]).law(Ping.of(distance=5.0, interval_s=[0.0, 0.2]))
    np.testing.assert_allclose(law.quantile(0.5), 5.0)


def test_time_walk_follows_its_table():
    walk = CATALOGUE["time_walk"](scale=1.0)
    for margin, late in ((20.0, 0.0135), (2.0, 0.044), (12.0, 0.022)):
        loss = CATALOGUE["sensitivity"](loss_db=60.0 - margin)
        assert median([walk, loss], distance=1.0) == pytest.approx(1.0 + late, abs=5e-5)


@pytest.mark.parametrize("margin_db", [4.0, 8.0, 14.0, 25.0])
def test_the_scatter_of_the_level_scatters_the_time_walk(margin_db):
    effects = [CATALOGUE["sensitivity"](loss_db=60.0 - margin_db), CATALOGUE["time_walk"](scale=1.0)]
    law = PhysicalModel(effects, 1e-5).law(Ping.of(distance=1.0))
    levels = margin_db + DETECTION_WIDTH_DB * stats.norm.ppf((np.arange(2000) + 0.5) / 2000)
    late = np.interp(levels, WALK_DB, WALK_M)
    width = np.diff([law.quantile(q)[0] for q in (0.16, 0.84)])[0]
    assert width == pytest.approx(np.diff(np.quantile(late, [0.16, 0.84]))[0], rel=0.25)


def test_loud_echoes_have_no_time_walk_to_scatter():
    law = PhysicalModel([CATALOGUE["time_walk"](scale=1.0)], 1e-6).law(Ping.of(distance=1.0))
    assert np.diff([law.quantile(q)[0] for q in (0.01, 0.99)])[0] < 1e-5


def test_cycle_slip_is_a_comb():
    law = PhysicalModel([CATALOGUE["cycle_slip"](probability=0.3)], 1e-5).law(Ping.of(distance=[1.0] * 3))
    at = 1.0 + HALF_WAVE * np.arange(3)
    np.testing.assert_allclose(law.cdf(at + 1e-4) - law.cdf(at - 1e-4), [0.7, 0.21, 0.09], atol=1e-9)


def test_scintillation_widens_the_detection_curve():
    # a normal level of spread s over a threshold of spread w is one of spread sqrt(s^2 + w^2)
    loss = CATALOGUE["sensitivity"](loss_db=43.0)
    air = CATALOGUE["scintillation"](sigma_at_6m_db=2.0)
    margin = 60.0 - 43.0 - 20 * math.log10(6.0)
    echo = PhysicalModel([loss, air]).law(Ping.of(distance=6.0)).echo[0]
    assert echo == pytest.approx(stats.norm.cdf(margin / math.hypot(2.0, 1.5)), abs=2e-3)


def test_ring_down_does_not_scatter_as_echoes_do():
    ring = CATALOGUE["ring_down"](probability=1.0, range_m=0.1, decay_m=0.01)
    jitter = CATALOGUE["travel_time_jitter"](sigma_m=0.05)
    assert median([ring, jitter], distance=2.0) == pytest.approx(median([ring], distance=2.0), abs=1e-9)


def test_false_alarms_come_before_the_echo_only():
    law = PhysicalModel([CATALOGUE["false_alarm"](per_metre=0.05)]).law(Ping.of(distance=[2.0, 4.0]))
    np.testing.assert_allclose(law.cdf(np.array([1.9, 3.9])), 1 - np.exp(-0.05 * np.array([1.9005, 3.9005])), atol=1e-9)
    np.testing.assert_allclose(law.cdf(np.array([2.1, 4.1])), 1.0)


def test_ring_down_is_exponential_from_the_end_of_blanking():
    ring = CATALOGUE["ring_down"](probability=0.4, range_m=0.1, decay_m=0.05)
    law = PhysicalModel([ring], 1e-4).law(Ping.of(distance=[2.0] * 3))
    expected = 0.4 * (1 - np.exp(-np.array([0.0, 0.05, 0.10]) / 0.05))
    np.testing.assert_allclose(law.cdf(np.array([0.0999, 0.15, 0.20])), expected, atol=1e-3)


@given(st.floats(0.0, 1.0), st.floats(0.05, 0.75), st.floats(0.05, 1.5), st.floats(-0.02, 0.02))
def test_echoes_of_nearer_targets_are_held_until_the_ring_down_ends(held, end_m, distance, offset_m):
    assume(abs(end_m - distance) > 0.01)
    effects = [CATALOGUE["ring_down"](range_m=end_m, held=held), CATALOGUE["zero_offset"](offset_m=offset_m)]
    law = PhysicalModel(effects).law(Ping.of(distance=distance))
    for exact, share in ((distance, 1.0 - held * (distance < end_m)), (end_m, held * (distance < end_m))):
        assert law.cdf(exact + offset_m + 0.002)[0] - law.cdf(exact + offset_m - 0.002)[0] == pytest.approx(share)


def test_ring_down_has_no_time_walk():
    ring = CATALOGUE["ring_down"](probability=1.0, range_m=0.1, decay_m=0.01)
    walks = [CATALOGUE["sensitivity"](loss_db=46.0), CATALOGUE["time_walk"](scale=1.0)]
    alone = median([ring], distance=2.0)
    assert median([ring, *walks], distance=2.0) == pytest.approx(alone, abs=1e-4)


def test_quantised_readings_lie_on_the_steps():
    model = PhysicalModel([CATALOGUE["quantisation"](step_m=0.01), CATALOGUE["travel_time_jitter"](sigma_m=0.02)])
    drawn = model.law(Ping.of(distance=np.full(500, 1.234))).sample(np.random.default_rng(1))
    np.testing.assert_allclose(drawn.range * 100, np.rint(drawn.range * 100), atol=1e-9)
    assert drawn.range.mean() == pytest.approx(1.234, abs=0.003)


def test_truncated_readings_lie_on_the_steps_and_are_half_a_step_short():
    model = PhysicalModel([CATALOGUE["truncation"](step_m=0.01), CATALOGUE["zero_offset"](offset_m=0.002)])
    law = model.law(Ping.of(distance=[1.2379, 1.2381, 1.2479]))
    np.testing.assert_allclose(law.quantile(0.5), [1.23, 1.24, 1.24], atol=1e-9)
    spread = np.random.default_rng(3).uniform(1.0, 3.0, 4000)
    drawn = PhysicalModel([CATALOGUE["truncation"](step_m=0.01)]).law(Ping.of(distance=spread)).sample
    assert np.mean(drawn(np.random.default_rng(4)).range - spread) == pytest.approx(-0.005, abs=3e-4)


def test_an_uncompensated_sensor_follows_the_logged_temperature():
    stack = [CATALOGUE["sound_speed"](temperature_c=20.0, logged_share=1.0)]
    logged = np.array([0.0, 20.0, 40.0])
    law = PhysicalModel(stack, 1e-5).law(Ping.of(distance=[3.0] * 3, temperature_c=logged))
    expected = 3.0 * ASSUMED_SPEED / sound_speed(torch.tensor(logged)).numpy()
    np.testing.assert_allclose(law.quantile(0.5), expected, atol=2e-5)
    assert "per kelvin of the thermometer" in stack[0].statement()
    assert "-0.17 %" in stack[0].statement()  # half of 1 / 293 K


def test_there_is_no_echo_beyond_the_gate():
    law = PhysicalModel([CATALOGUE["range_gate"](listen_m=3.0)]).law(Ping.of(distance=[2.9, 3.1]))
    np.testing.assert_allclose(law.echo, [1.0, 0.0])


def test_warm_up_decays_exponentially():
    warm = CATALOGUE["warm_up"](offset_m=0.02, tau_s=100.0)
    law = PhysicalModel([warm], 1e-5).law(Ping.of(distance=1.0, time=[0.0, 100.0, 5000.0]))
    np.testing.assert_allclose(law.quantile(0.5), [1.02, 1.0 + 0.02 / math.e, 1.0], atol=2e-5)


def test_reflectance_of_a_tenth_costs_20_db():
    soft = CATALOGUE["reflectance_loss"](strength=1.0)
    assert level([soft], distance=1.0, reflectance=0.1) == pytest.approx(40.0)


def test_the_blind_range_loses_near_echoes_but_not_later_ones():
    late = CATALOGUE["rearm_dead_time"](deaf_m=0.5)
    law = PhysicalModel([late]).law(Ping.of(distance=[0.45, 0.55]))
    np.testing.assert_allclose(law.echo, [0.0, 1.0])
    behind = CATALOGUE["background_reflector"](presence=1.0, behind_m=0.3, loss_db=10.0)
    assert PhysicalModel([late, behind]).law(Ping.of(distance=0.45)).quantile(0.5)[0] == pytest.approx(0.75)


def test_there_are_no_false_alarms_in_the_blind_range():
    stack = [CATALOGUE["rearm_dead_time"](deaf_m=0.5), CATALOGUE["false_alarm"](per_metre=0.2)]
    law = PhysicalModel(stack).law(Ping.of(distance=[2.0, 2.0]))
    np.testing.assert_allclose(law.cdf(np.array([0.499, 1.5])), [0.0, 1 - np.exp(-0.2)], atol=2e-4)


def test_the_burst_of_another_clock_shifts_by_the_difference_of_the_intervals():
    other = CATALOGUE["asynchronous_crosstalk"](presence=1.0, period_s=0.07, first_s=0.01, spread_m=0.002)
    law = PhysicalModel([other]).law(Ping.of(distance=[5.0] * 4, time=[0.0, 0.001, 0.065, 0.0701]))
    expected = ASSUMED_SPEED / 2 * np.array([0.01, 0.009, 0.015, 0.0099])
    np.testing.assert_allclose(law.quantile(0.5), expected, atol=0.001)


def test_a_wrong_bit_changes_the_count_by_a_power_of_two():
    model = PhysicalModel([CATALOGUE["corrupted_byte"](probability=0.5, unit_m=0.01)], 0.01, 11.0)
    drawn = model.law(Ping.of(distance=np.full(2000, 1.5))).sample(np.random.default_rng(2))
    off = np.abs(np.rint(drawn.range * 100) - 150)
    moved = off[(off > 1) & (off < 900)]  # the register ends at 11 m
    nearest = 2.0 ** np.rint(np.log2(moved))
    assert np.mean(np.abs(moved - nearest) <= 1) > 0.98
    # each of 16 bits is as likely; the lowest hides in the rounding and the highest six in the register's end
    assert len(moved) / len(drawn) == pytest.approx(0.5 * 9 / 16, abs=0.04)


@pytest.mark.parametrize("offset_m", [0.0, -0.1])
def test_a_wrong_bit_leads_somewhere_wherever_the_count_is(offset_m):
    """The law of the effect is one of probability also where the echo itself would be read at or below zero."""
    effects = [CATALOGUE["zero_offset"](offset_m=offset_m), CATALOGUE["corrupted_byte"](probability=0.5, unit_m=1e-3)]
    law = PhysicalModel(effects, 0.001, 11.0).law(Ping.of(distance=np.linspace(0.02, 3.0, 50)))
    np.testing.assert_allclose(law.cdf_step(np.full(50, law.last_step)) + law.no_echo + law.no_answer, 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("rearm_dead_time", {"deaf_m": 0.62}),
        ("asynchronous_crosstalk", {"presence": 0.6, "period_s": 0.0917, "first_s": 0.031, "spread_m": 0.02}),
        ("corrupted_byte", {"probability": 0.08, "unit_m": 0.01}),
        ("range_gate", {"listen_m": 2.408}),
    ],
)
def test_a_fit_recovers_the_parameters(name, values):
    rng = np.random.default_rng(5)
    scatter = CATALOGUE["travel_time_jitter"](sigma_m=0.004)
    time = np.cumsum(rng.uniform(0.09, 0.11, 900))  # a recording counts it from its first ping
    ping = Ping.of(distance=rng.uniform(0.3, 4.0, 900), time=time - time[0])
    reading = PhysicalModel([scatter, CATALOGUE[name](**values)]).law(ping).sample(rng)
    batch = Batch.of(Recording.of(ping, reading))
    plain = Stack.of(PhysicalModel([scatter]))
    keys = [(name, p.name) for p in CATALOGUE[name].parameters]
    starts = sorted(starting_points(plain, name, batch, rng), key=lambda s: -log_likelihood(s, batch).sum())
    found = best_of(starts[:2], keys, batch)
    for key, value in values.items():
        assert found.stack.get((name, key)) == pytest.approx(value, rel=0.25, abs=0.001)


@pytest.mark.parametrize(("name", "size"), [("noise_burst", {"sigma_m": 0.1}), ("corrupted_byte", {"unit_m": 0.01})])
def test_a_wrong_reading_of_an_echo_is_none_of_a_target_that_is_not_heard(name, size):
    ping = Ping.of(distance=np.array([1.0, 9.0]))
    deaf = CATALOGUE["sensitivity"](loss_db=55.0)
    wrong = CATALOGUE[name](probability=0.5, **size)
    without, with_it = (PhysicalModel(effects).law(ping) for effects in ([deaf], [deaf, wrong]))
    assert without.echo[1] < 1e-6
    np.testing.assert_allclose(with_it.echo, without.echo, rtol=1e-9, atol=1e-15)
