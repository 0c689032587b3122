"""An adjusted law is a law, does what its amounts say, and is the same in a file as in memory."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.ensemble import GradientBoostingRegressor

from acquisition import ModelError, Ping
from noise import GaussianModel, load_model, save_model
from noise.discrepancy.baseline.adjusted import (
    EARLY,
    GAINED,
    LATE,
    LOST,
    SHIFT,
    SPREAD,
    Adjusted,
    AdjustedLaw,
    Boosted,
    Outliers,
)
from noise.discrepancy.baseline.forest_law import N_LEVELS
from noise.discrepancy.baseline.trees import Trees

MODEL = GaussianModel(0.01, 0.02, 0.1)
PING = Ping.of(distance=np.linspace(0.5, 4.0, 30), time=np.arange(30.0))
amounts = st.fixed_dictionaries(
    {
        SHIFT: st.floats(-0.2, 0.2),
        SPREAD: st.floats(-2.0, 9.0),
        LOST: st.floats(-2.0, 2.0),
        GAINED: st.floats(-2.0, 2.0),
        EARLY: st.floats(-2.0, 2.0),
        LATE: st.floats(-2.0, 2.0),
    }
)


OUTLIERS = {
    EARLY: Outliers("range", np.linspace(0.3, 0.32, N_LEVELS)),
    LATE: Outliers("ratio", np.linspace(1.9, 2.1, N_LEVELS)),
}


def adjusted(**amount):
    parts = {name: np.full(len(PING), value) for name, value in amount.items()}
    return AdjustedLaw(MODEL.law(PING), parts, {name: each for name, each in OUTLIERS.items() if name in parts})


@given(amounts)
def test_an_adjusted_law_is_a_law(amount):
    law, z = adjusted(**amount), np.linspace(0.0, 12.0, 200)[:, None]
    arrival = law.arrival(z)
    assert (np.diff(arrival, axis=0) >= -1e-12).all()
    assert ((arrival >= 0.0) & (arrival <= 1.0 - law.no_answer + 1e-12)).all()
    assert law.echo + law.no_echo + law.no_answer == pytest.approx(1.0)


def test_nothing_added_is_the_law_itself():
    z = np.linspace(0.2, 4.5, 40)[:, None]
    np.testing.assert_allclose(adjusted().arrival(z), MODEL.law(PING).arrival(z), atol=1e-12)


def test_echoes_are_moved_and_spread_about_their_middle():
    own, law = MODEL.law(PING), adjusted(shift=0.03, spread=1.0)
    middle = [each.quantile(0.5) for each in (own, law)]
    np.testing.assert_allclose(middle[1] - middle[0], 0.03, atol=0.011)  # a step of the register
    widths = [each.quantile(0.9) - each.quantile(0.1) for each in (own, law)]
    assert np.mean(widths[1] / widths[0]) == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(("amount", "expected"), [({LOST: 0.25}, 0.75), ({LOST: -0.05}, 1.05)])
def test_a_share_of_echoes_is_lost(amount, expected):
    np.testing.assert_allclose(adjusted(**amount).echo, expected * MODEL.law(PING).echo)


def test_a_share_of_silence_becomes_an_echo():
    np.testing.assert_allclose(adjusted(gained=0.5).no_echo, 0.5 * MODEL.law(PING).no_echo)


def test_a_share_of_echoes_is_before_the_target_where_other_such_echoes_were():
    law, own = adjusted(early=0.25), MODEL.law(PING)
    np.testing.assert_allclose(law.arrival(0.35), own.arrival(0.35) + 0.25 * (own.echo - own.arrival(0.35)))
    np.testing.assert_allclose(law.echo, own.echo)


@pytest.mark.parametrize(
    ("form", "place"),
    [("range", lambda d: 0.7 + 0.0 * d), ("offset", lambda d: d - 0.3), ("ratio", lambda d: 0.6 * d)],
)
def test_what_echoes_of_other_reflectors_have_in_common_is_found(form, place):
    rng, distance = np.random.default_rng(0), np.linspace(1.0, 4.0, 50)
    found = Outliers.of(place(distance) + rng.normal(0.0, 0.005, 50), distance)
    assert found.form == form
    np.testing.assert_allclose(found.law(MODEL.law(PING)).quantile(0.5), place(PING.distance), atol=0.011)


def boosted(names=("log_distance",), times=(0.0, 29.0)):
    """Return trees that say 0.03 beyond 2 m, and 0 before."""
    x = np.linspace(0.3, 4.0, 200)
    inputs = np.log(x)[:, None] if names == ("log_distance",) else x[:, None]
    grown = GradientBoostingRegressor(n_estimators=60, init="zero", max_depth=1, learning_rate=0.2, random_state=0)
    trees = [each.tree_ for each in grown.fit(inputs, 0.03 * (x > 2.0)).estimators_[:, 0]]
    value = np.concatenate([np.where(each.children_left < 0, 0.2 * each.value[:, 0, 0], 0.0) for each in trees])
    return Boosted(names, times, np.zeros(1), Trees.of(trees), value)


def test_a_sum_of_trees_is_that_of_scikit_learn():
    law = Adjusted(MODEL, {SHIFT: boosted()}).law(PING)
    np.testing.assert_allclose(law.shift, 0.03 * (PING.distance > 2.0), atol=1e-6)


def test_at_a_time_that_was_not_recorded_it_is_the_mean_of_recorded_ones():
    part = boosted(("time",), times=(0.0, 4.0))
    ping = Ping.of(distance=np.ones(2), time=np.array([3.0, 8.0]))
    inside, outside = part(ping, None)
    assert inside == pytest.approx(0.03, abs=1e-6)
    assert 0.005 < outside < 0.025


def test_a_saved_model_is_the_same_law(tmp_path):
    model = Adjusted(MODEL, {SHIFT: boosted(), LOST: boosted(), LATE: boosted()}, {LATE: OUTLIERS[LATE]})
    again = load_model(save_model(model, tmp_path / "model"))
    z = np.linspace(0.1, 5.0, len(PING))
    np.testing.assert_allclose(again.law(PING).arrival(z), model.law(PING).arrival(z), atol=1e-12)


@pytest.mark.parametrize(
    "damage",
    [{"value": [0.0]}, {"names": []}, {"value": None}, {"times": [0.0, float("nan")]}, {"typical": [0.0, 1.0]}],
)
def test_a_damaged_file_is_a_clear_error(tmp_path, damage):
    folder = save_model(Adjusted(MODEL, {SHIFT: boosted()}), tmp_path / "model")
    data = json.loads((folder / "model.json").read_text())
    data["parts"][SHIFT] |= damage
    (folder / "model.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match=r"model\.json"):
        load_model(folder)


@pytest.mark.parametrize("damage", [{}, {EARLY: {"form": "range", "value": [1.0]}}, {EARLY: {"form": "colour"}}])
def test_early_echoes_without_a_place_are_a_clear_error(tmp_path, damage):
    folder = save_model(Adjusted(MODEL, {EARLY: boosted()}, {EARLY: OUTLIERS[EARLY]}), tmp_path / "model")
    data = json.loads((folder / "model.json").read_text())
    data["outliers"] = damage
    (folder / "model.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match=r"model\.json"):
        load_model(folder)


def test_an_unknown_part_is_a_clear_error(tmp_path):
    folder = save_model(Adjusted(MODEL, {SHIFT: boosted()}), tmp_path / "model")
    data = json.loads((folder / "model.json").read_text())
    data["parts"]["colour"] = data["parts"].pop(SHIFT)
    (folder / "model.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match="colour"):
        load_model(folder)
