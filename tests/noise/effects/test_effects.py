"""Properties that every effect of the catalogue has."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from acquisition import EchoStatus, Ping, Reading, SettingError
from noise.effects import CATALOGUE, Conditions
from noise.effects.medium import ASSUMED_SPEED
from noise.physical import PhysicalModel

torch.set_num_threads(1)
MEMBERS = pytest.mark.parametrize("name", CATALOGUE)
FINE = {"period_s": 1e-11}  # a clock of 71 ms has 35,000 periods during these pings
STEP, REACH = 0.01, 6.0  # a coarse register, so that whole laws can be summed


def ordinary(*left_out):
    """Return effects under which all others are observable: finite levels, a beam, scatter wider than a step."""
    stack = {
        "sensitivity": {"loss_db": 46.0},
        "beam_width": {"ka": 4.8},
        "travel_time_jitter": {"sigma_m": 0.008},
        "specular_loss": {"strength": 0.5},
    }
    return [CATALOGUE[name](**values) for name, values in stack.items() if name not in left_out]


def conditions(copies=1):
    """Return 8 varied conditions, each `copies` times in a row, with their previous readings."""
    d = np.array([0.2, 0.6, 1.2, 1.8, 2.5, 3.4, 4.4, 5.5])
    ping = Ping.of(
        distance=d,
        angle=np.radians([0, 4, 12, 25, 0, 8, 2, 0]),
        incidence=np.radians([0, 30, 12, 3, 1, 2, 0, 20]),
        reflectance=[0.9, 0.1, 0.9, 0.5, 0.1, 0.9, 0.9, 0.9],
        time=np.linspace(30.0, 2500.0, 8),
        interval_s=[0.065, 0.04, 0.05, 0.06, 0.05, 0.065, 0.0, 0.055],
        temperature_c=[5.0, 12.0, 18.0, 20.0, 24.0, 28.0, 31.0, 35.0],
        range_rate_mps=[0.1, -0.3, 0.5, -0.2, 0.4, 0.6, -0.5, 0.3],
    )
    past = Reading.of([0.3, 0.0, 1.3, 0.0, 2.5, 3.3, 4.2, 0.0], [1, 0, 1, 2, 1, 1, 1, 0])
    rows = np.repeat(np.arange(8), copies)
    return ping[rows], past[rows]


def at_start(name):
    """Return the effect at an initial value of a fit, or away from its null if the initial value is the null."""
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
    no_echo = np.exp(law.log_prob(Reading.of(np.zeros(len(ping))))).reshape(8, steps)[:, 0]
    no_answer = np.exp(law.log_prob(Reading.of(np.zeros(len(ping)), np.full(len(ping), EchoStatus.NO_ANSWER))))
    return each, no_echo, no_answer.reshape(8, steps)[:, 0]


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
def test_every_member_is_described_completely(name):
    effect = CATALOGUE[name]
    assert effect.name == name
    assert effect.summary
    assert not effect.summary.endswith(".")
    for p in effect.parameters:
        assert p.unit
        assert p.source
        assert p.low < p.high
        assert p.low <= p.null <= p.high or p.null == 0.0
        assert p.starts, f"{name}.{p.name} has no initial value for a fit"
        assert all(p.low <= start <= p.high for start in p.starts)
    assert math.prod(len(p.starts) for p in effect.parameters) <= 9


@MEMBERS
def test_null_leaves_the_law_unchanged(name):
    ping, past, reading = some_readings()
    for stack in ([], ordinary(name)):
        without = PhysicalModel(stack, STEP, REACH).law(ping, past).log_prob_tensor(reading)
        with_null = PhysicalModel([*stack, CATALOGUE[name]()], STEP, REACH).law(ping, past).log_prob_tensor(reading)
        np.testing.assert_allclose(with_null.numpy(), without.numpy(), rtol=0, atol=1e-12)


@MEMBERS
def test_a_start_changes_the_law(name):
    sensitive = [CATALOGUE["sensitivity"](loss_db=10.0), CATALOGUE["specular_loss"](strength=2.0)]
    change = 0.0
    for stack in (
        ordinary(name),
        sensitive,
    ):  # weak paths are observable if the direct echo is lost and the receiver is sensitive
        without = whole_register(PhysicalModel(stack, STEP, REACH))
        stack = [effect for effect in stack if effect.name != name]
        changed = whole_register(PhysicalModel([*stack, at_start(name)], STEP, REACH))
        change = max(change, *(np.abs(a - b).max() for a, b in zip(without, changed, strict=True)))
    assert change > 1e-3


@MEMBERS
def test_probabilities_sum_to_one(name):
    each, no_echo, no_answer = whole_register(PhysicalModel([*ordinary(name), at_start(name)], STEP, REACH))
    assert np.all(each >= 0)
    np.testing.assert_allclose(each.sum(axis=1) + no_echo + no_answer, 1.0, atol=1e-12)


@MEMBERS
def test_samples_agree_with_log_prob(name):
    model = PhysicalModel([*ordinary(name), at_start(name)], STEP, REACH)
    each, no_echo, no_answer = whole_register(model)
    copies = 2000
    ping, past = conditions(copies)
    drawn = model.law(ping, past).sample(np.random.default_rng(0))
    kind = np.where(drawn.echo, np.rint(drawn.range / STEP).astype(int), -drawn.status.astype(int)).reshape(8, copies)
    for row in range(8):
        expected = copies * np.concatenate([[no_answer[row], no_echo[row]], each[row]])
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
        assert name in ("quantisation", "truncation"), "only a step may have no derivative"
        return
    for gradient in torch.autograd.grad(total, list(leaves.values()), allow_unused=True):
        assert gradient is None or torch.isfinite(gradient)


@MEMBERS
def test_gradients_agree_with_finite_differences(name):
    if name in ("quantisation", "truncation", "stuck"):
        pytest.skip("a value on the grid has no derivative, see its docstring")
    ping, past, reading = some_readings()
    values = at_start(name).values

    def total(**changed):
        effect = CATALOGUE[name](**{**values, **changed})
        law = PhysicalModel([*ordinary(name), effect], STEP, REACH).law_of(Conditions.of(ping, past))
        return law.log_prob_tensor(reading).sum()

    for p in CATALOGUE[name].parameters:
        if (name, p.name) == ("false_alarm", "from_m"):
            continue  # the likelihood jumps at every reading, see its docstring
        inside = min(max(values[p.name], p.low + 1e-4 * (p.high - p.low)), p.high - 1e-4 * (p.high - p.low))
        leaf = torch.tensor(inside, dtype=torch.float64, requires_grad=True)
        # nearly impossible readings have steep logarithms: compare by central differences of a small step
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
def test_values_outside_the_bounds_raise(name):
    p = CATALOGUE[name].parameters[0]
    with pytest.raises(SettingError, match=rf"{name}\.{p.name} must lie in \["):
        CATALOGUE[name](**{p.name: p.high + (p.high - p.low)})
    with pytest.raises(TypeError, match="has no parameter 'colour'"):
        CATALOGUE[name](colour=1.0)


def test_a_burst_lies_about_what_the_echo_would_have_read():
    weak = {"distance": 2.5, "angle": 0.4, "incidence": 0.4, "reflectance": 0.1}
    late = [CATALOGUE["sensitivity"](loss_db=30.0), CATALOGUE["time_walk"](scale=1.0)]
    burst = CATALOGUE["noise_burst"](probability=0.9, sigma_m=0.02)
    plain, scattered = (PhysicalModel(effects).law(Ping.of(**weak)) for effects in (late, [*late, burst]))
    assert plain.quantile(0.5)[0] > 2.51  # the threshold is crossed late
    assert scattered.quantile(0.5) == pytest.approx(plain.quantile(0.5), abs=0.002)


def test_a_parameter_is_identifiable_if_its_covariate_is_logged_and_varies():
    share = CATALOGUE["sound_speed"].parameters[1]
    assert share.identifiable({"temperature_c": np.array([18.0, 22.0])})
    assert not share.identifiable({"temperature_c": np.array([18.0, 18.5])})
    assert not share.identifiable({})


@pytest.mark.parametrize("trips", [0.0, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("loss_db", [0.0, 50.0])
def test_a_previous_ping_is_heard_as_often_as_it_is_present(trips, loss_db):
    """However far a simulation's own echoes lie above the threshold: that says nothing of another path."""
    interval_s, distance = 0.06, 2.4
    far_m = ASSUMED_SPEED * interval_s / 2.0 + 0.5 - trips * distance
    effects = [CATALOGUE["previous_ping"](presence=0.4, far_m=far_m, trips=trips)]
    effects.append(CATALOGUE["sensitivity"](loss_db=loss_db))
    law = PhysicalModel(effects).law(Ping.of(distance=distance, interval_s=interval_s))
    assert law.cdf(0.52)[0] == pytest.approx(0.4, abs=1e-3)


def test_the_first_ping_of_a_burst_hears_no_previous_one():
    effect = CATALOGUE["previous_ping"](presence=1.0, trips=2.0, wait_m=0.3)
    ping = Ping.of(distance=2.0, interval_s=[0.014, 3.0])
    law = PhysicalModel([effect]).law(ping, Reading.of([2.0, 2.0]))
    np.testing.assert_allclose(law.quantile(0.5), [1.7, 2.0], atol=1e-3)


def drive(n=80, gap_s=0.0):
    """Return a log with a kink in the distance, and the same distance and incidence as functions of time, s."""
    time = 0.07 * np.arange(n) + np.where(np.arange(n) >= n // 2, gap_s, 0.0)
    distance, incidence = (lambda t: 6.0 - 0.4 * np.abs(t - 2.0)), (lambda t: 0.1 * np.sin(t))
    rate = np.gradient(distance(time), time)
    ping = Ping.of(distance=distance(time), incidence=incidence(time), time=time, range_rate_mps=rate)
    return ping, distance, incidence


@pytest.mark.parametrize("delay_s", [0.05, 0.12, 0.31, 0.9])
def test_a_late_reading_is_that_of_an_earlier_pose(delay_s):
    ping, distance, incidence = drive()
    late = PhysicalModel([CATALOGUE["latency"](delay_s=delay_s)]).state(Conditions.of(ping)).conditions
    then = ping.time - delay_s
    known, unknown = then > 0.05, then < -0.05  # a lag step beside the beginning of the log is neither
    # the log is linear between pings, and so is its interpolation between the lags
    np.testing.assert_allclose(late.distance.numpy()[known], distance(then)[known], atol=0.02)
    np.testing.assert_allclose(np.median(np.abs(late.distance.numpy() - distance(then))), 0.0, atol=1e-6)
    np.testing.assert_allclose(late.incidence.numpy()[known], incidence(then)[known], atol=2e-3)
    rate = ping.covariates["range_rate_mps"]
    np.testing.assert_allclose(late.distance.numpy()[unknown], (ping.distance - delay_s * rate)[unknown])


def test_what_a_log_does_not_tell_follows_from_the_rate():
    ping, *_ = drive(gap_s=5.0)
    rows = np.random.default_rng(0).permutation(len(ping))
    effect = CATALOGUE["latency"](delay_s=0.3)
    rate = ping.covariates["range_rate_mps"]
    after = slice(len(ping) // 2, len(ping) // 2 + 3)
    for each, some in ((ping, after), (ping[rows], slice(None))):  # after a gap; and not in the order of time
        late = PhysicalModel([effect]).state(Conditions.of(each)).conditions.distance.numpy()
        linear = np.maximum(each.distance - 0.3 * each.covariates["range_rate_mps"], 0.0)
        np.testing.assert_allclose(late[some], linear[some])
    early = PhysicalModel([CATALOGUE["latency"](delay_s=-0.2)]).state(Conditions.of(ping)).conditions
    np.testing.assert_allclose(early.distance.numpy(), np.maximum(ping.distance + 0.2 * rate, 0.0))


def test_a_delay_has_a_gradient():
    ping, *_ = drive()
    delay = torch.tensor(0.32, dtype=torch.float64, requires_grad=True)
    distance = (
        PhysicalModel([CATALOGUE["latency"].unchecked({"delay_s": delay})]).state(Conditions.of(ping)).direct.length
    )
    (slope,) = torch.autograd.grad(distance[40], delay)
    assert float(slope) == pytest.approx(-0.4 * np.sign(2.0 - (ping.time[40] - 0.32)), abs=1e-6)
