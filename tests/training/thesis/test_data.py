"""Scaling, split and loss floor of the thesis's samples."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import Recording, SettingError
from training.thesis.data import Samples, credence_of


def recording(**columns):
    table = {"distance_mm": 3900.0, "angle_deg": 30.0, "reflectance": 0.9, **columns}
    n = max(np.size(v) for v in table.values())
    return Recording(pd.DataFrame({k: np.broadcast_to(v, n).astype(float) for k, v in table.items()}))


def of_readings(reading_mm, **columns):
    return recording(reading_mm=np.resize(np.array(reading_mm, dtype=float), 200), **columns)


def test_scaling_is_that_of_table_4_1():
    """30 degrees, 0.9, 3900 mm: angle 0.6667, readings 0.6583 and 0.66 or 0, credence 0.88, label 0.6482."""
    reading_mm = [*[3950.0] * 11, *[3960.0] * 11, *[0.0] * 3]
    samples = Samples.of(of_readings(reading_mm))
    assert samples.feature[0] == pytest.approx([0.6667, 0.9, 0.6583, 0.88], abs=5e-5)
    assert samples.feature[11] == pytest.approx([0.6667, 0.9, 0.66, 0.88], abs=5e-5)
    assert samples.feature[24] == pytest.approx([0.6667, 0.9, 0.0, 0.88], abs=5e-5)
    assert samples.label == pytest.approx(0.6482, abs=5e-5)
    assert samples.distance == pytest.approx(3.9, abs=1e-6)


def test_a_ping_without_echo_reads_zero_and_one_without_answer_is_omitted():
    samples = Samples.of(of_readings([3900.0, 0.0, np.nan, 0.0]))
    assert len(samples) == 150
    assert sorted(set(samples.feature[:, 2].tolist())) == pytest.approx([0.0, 0.65])
    assert samples.feature[:, 3] == pytest.approx(1 / 3)


def test_credence_is_per_condition_and_includes_its_limits():
    distance = np.array([1.0, 1.0, 1.0, 2.0, 2.0])
    reading = np.array([1.1, 0.9, 1.11, 2.2, 0.0])
    assert credence_of(reading, distance, np.array([0, 0, 0, 1, 1])) == pytest.approx([2 / 3, 1 / 2])


def test_split_is_the_thesis_s():
    n = 133_100
    samples = Samples(np.arange(4 * n, dtype=np.float32).reshape(n, 4), np.zeros(n, np.float32), np.arange(n))
    train, validation = samples.split(np.random.default_rng(3))
    assert (len(train), len(validation)) == (123_100, 10_000)
    assert sorted([*train.condition, *validation.condition]) == list(range(n))
    assert not np.array_equal(np.sort(validation.condition), validation.condition)


def test_a_split_by_condition_divides_no_condition():
    samples = Samples.of(of_readings([950.0, 1000.0, 0.0], distance_mm=np.repeat(np.arange(900.0, 940.0), 5)))
    train, validation = samples.split(np.random.default_rng(3), by_condition=True)
    assert not set(train.condition) & set(validation.condition)
    assert (len(train), len(validation)) == (185, 15)


@given(st.lists(st.tuples(st.integers(0, 3), st.floats(0, 1, width=32)), min_size=1, max_size=40), st.integers(0, 99))
def test_no_function_of_the_inputs_has_a_loss_below_the_floor(pings, seed):
    group, label = np.array([g for g, _ in pings]), np.array([y for _, y in pings], np.float32)
    feature = np.repeat(group[:, None], 4, axis=1).astype(np.float32)
    samples = Samples(feature, label, group)
    output = np.random.default_rng(seed).random(4)[group]
    assert samples.loss_floor() <= np.mean((output - label) ** 2) + 1e-9
    best = np.array([label[group == g].mean(dtype=np.float64) for g in group])
    assert samples.loss_floor() == pytest.approx(np.mean((best - label) ** 2), abs=1e-9)


def test_recordings_without_reflectance_or_with_too_few_answers_are_errors():
    bare = of_readings([1000.0])
    with pytest.raises(SettingError, match="column reflectance is missing"):
        Samples.of(Recording(bare.table.drop(columns="reflectance"), "log.csv"))
    with pytest.raises(SettingError, match=r"log\.csv: 50 pings were answered, training needs 100: record more"):
        Samples.of(Recording(of_readings([1000.0, np.nan, np.nan, np.nan]).table, "log.csv"))
