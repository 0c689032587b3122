"""Unmodelled faults: diverse, deterministic, and different from what the catalogue holds."""

import numpy as np
import pytest

from acquisition import Ping
from training.diagnosis.generators.grammar import AT_ONE, draw_fault, draw_function, inputs


def survey():
    rng = np.random.default_rng(0)
    visit = np.repeat(np.arange(40), 10)
    distance = rng.uniform(0.3, 3.0, 40)[visit]
    time = np.cumsum(np.where(np.arange(400) % 10, 0.1, 10.0))
    angle, reflectance = rng.choice([-0.3, 0.0, 0.3], 40)[visit], rng.choice([0.1, 0.9], 40)[visit]
    return Ping.of(distance, angle, reflectance=reflectance, time=time, temperature_c=20.0 + np.sin(time / 60.0))


def test_faults_are_diverse_and_change_readings():
    ping, words, changed = survey(), set(), []
    for seed in range(60):
        operators, description = draw_fault(ping, np.random.default_rng(seed), 1.0)
        value = ping.distance.copy()
        for operator in operators:
            value = operator(value, ping, np.random.default_rng(1))
        words |= {each.split(" of ")[0] for each in description.split("; ")}
        changed.append(np.mean(value != ping.distance))
        assert np.isfinite(value).all()
        assert (value >= 0.0).all()
    assert words == set(AT_ONE)
    assert np.mean(np.array(changed) > 0.02) > 0.9


def test_a_fault_does_not_depend_on_an_input_that_it_is_kept_from():
    ping = survey()
    words = [draw_fault(ping, np.random.default_rng(seed), 1.0, without=("time",))[1] for seed in range(60)]
    assert not any("of the time" in each for each in words)
    assert any("of the distance" in each for each in words)


def test_functions_use_every_input():
    ping = survey()
    given = inputs(ping, ping.distance)
    used = {name for seed in range(80) for name in draw_function(given, np.random.default_rng(seed)).names}
    assert used == {name for name, x in given.items() if np.ptp(x) > 1e-9}
    values = draw_function(given, np.random.default_rng(3))(given)
    assert values.min() >= 0.0
    assert values.max() <= 1.0


def test_a_fault_is_a_function_of_the_condition_and_not_of_the_recording():
    """Half of the pings get what they get within the whole recording."""
    ping = survey()
    for seed in range(40):
        operators, words = draw_fault(ping, np.random.default_rng(seed), 1.0)
        if words.startswith(("bias", "steps")) and len(operators) == 1:
            half = np.arange(200)
            whole = operators[0](ping.distance.copy(), ping, np.random.default_rng(1))
            part = operators[0](ping[half].distance.copy(), ping[half], np.random.default_rng(1))
            assert part == pytest.approx(whole[half])


def test_no_bias_is_an_offset_a_scale_or_a_drift():
    ping, found = survey(), 0
    for seed in range(60):
        operators, words = draw_fault(ping, np.random.default_rng(seed), 0.2)
        if words.startswith("bias") and len(operators) == 1 and "previous" not in words:
            error = operators[0](ping.distance.copy(), ping, np.random.default_rng(1)) - ping.distance
            fit = np.stack([np.ones(len(ping)), ping.distance, ping.time], axis=1)
            assert np.abs(fit.T @ error).max() < 1e-6 * np.abs(fit.T @ np.abs(error)).max() + 1e-9
            found += 1
    assert found


def test_a_bias_is_as_large_in_a_survey_of_another_order():
    """In order of distance, distance and time are one, and no great weights of both may cancel."""
    time, marks = np.arange(400) * 0.1, np.linspace(0.3, 3.0, 40)
    mixed = np.random.default_rng(0).permutation(marks)
    surveys = [Ping.of(np.repeat(each, 10), time=time) for each in (marks, mixed)]
    found = 0
    for seed in range(200):
        operators, words = draw_fault(surveys[0], np.random.default_rng(seed), 0.5)
        if words.startswith("bias") and len(operators) == 1 and "previous" not in words:
            there = operators[0](surveys[1].distance.copy(), surveys[1], np.random.default_rng(1))
            # half of a line that time stands for is at most as large as the fault, whose ends are twice its amount
            assert np.abs(there - surveys[1].distance).max() < 2.0 * 2.0 * 0.5 * AT_ONE["bias"]
            found += 1
    assert found > 5
