"""What networks tell of silence, where the answer is known; tuning that finds what was planted; the whole command."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import ModelError, Ping, Reading, Recording, SettingError
from acquisition.bench import Rig, Setup, Unit
from acquisition.bench.laboratory.unit import RANGES
from acquisition.survey.plan import PLANS
from noise.learned.thesis import ThesisNetwork
from training.thesis import rig
from training.thesis.compare_thesis import Args, main
from training.thesis.data import Samples
from training.thesis.rig import published
from training.thesis.rig_page import cell_readings
from training.thesis.silence import ANGLES_DEG, Errors, Silence, kinds, middle, offset
from training.thesis.tuning import COARSE, survey, tuned

DEAF_M = np.stack([6.0 - 0.05 * ANGLES_DEG, 4.0 - 0.05 * ANGLES_DEG])  # mirror, rubber


def made(reading_of):
    """Return samples of the thesis's survey, 4 pings a condition, of what a function makes of place and ping number."""
    grid = np.meshgrid(np.arange(0.05, 6.001, 0.05), ANGLES_DEG, [0.9, 0.1], indexing="ij")
    distance, angle, reflectance = (np.repeat(one.ravel(), 4) for one in grid)
    row, column = (reflectance < 0.5).astype(int), np.abs(angle[:, None] - ANGLES_DEG).argmin(axis=1)
    heard = reading_of(distance, DEAF_M[row, column], np.arange(len(distance)) % 4)
    ping = Ping.of(distance, np.deg2rad(angle), 0.0, reflectance)
    return Samples.of(Recording.of(ping, Reading.of(heard)))


def test_silence_of_pings_tells_from_where_a_sonar_is_deaf():
    silence = Silence.of_samples(made(lambda d, deaf, k: np.where(d > deaf + 1e-9, 0.0, d)))
    shows = DEAF_M < 6.0
    assert silence.deaf_from[shows] == pytest.approx(DEAF_M[shows], abs=0.051)
    assert np.isnan(silence.never[0, 0])
    assert silence.deaf_from[0, 0] == 6.0
    assert np.isnan(silence.half).all()


def test_edge_is_where_every_other_ping_is_heard():
    def fading(d, deaf, k):
        return np.where(d > deaf + 0.15 + 1e-9, 0.0, np.where((d > deaf - 0.151) & (k % 2 == 0), 0.0, d))

    silence = Silence.of_samples(made(fading))
    assert silence.half == pytest.approx(np.minimum(DEAF_M, 6.0 - 0.075), abs=0.03)


def test_a_network_is_asked_at_the_thesis_s_angles_with_a_reading_of_zero():
    """A network that gives the angle back as label, less its credence; any reading or a wrong scale would show."""
    silence = Silence.of_network(lambda x: 0.9 * x[:, 0] + x[:, 2] - 0.1 * x[:, 3] - 0.01 * x[:, 1])
    expected = 5.97 * (0.9 * ANGLES_DEG / 45.0 - 0.01 * np.array([[0.9], [0.1]])) + 0.03
    np.testing.assert_allclose(silence.never, expected, atol=1e-6)
    np.testing.assert_allclose(silence.half, expected - 5.97 * 0.05, atol=1e-6)


def test_apart_and_middle():
    low, high = (Silence(np.full((2, 11), x), np.full((2, 11), x)) for x in (4.0, 5.0))
    assert low.apart(high) == pytest.approx(1.0)
    assert middle([low, high]).apart(low) == pytest.approx(0.5)
    nowhere = Silence(np.full((2, 11), np.nan), high.half)
    assert nowhere.apart(high) == pytest.approx(1.0)  # as if silent from 6 m


def test_errors_and_offsets_of_a_network_that_adds_a_tenth_of_a_metre():
    samples = made(lambda d, deaf, k: np.where(k == 0, 0.0, np.where(k == 1, 1.5 * d, d)))
    share = {name: which.mean() for name, which in kinds(samples).items()}
    assert share == pytest.approx({"silent": 0.25, "right": 0.5, "wrong": 0.25})

    def network(x):
        return (6.0 * x[:, 2] + 0.07) / 5.97

    errors = Errors.of(network, samples)
    silent = np.sqrt(np.mean((0.1 - samples.distance) ** 2))
    assert errors.by_kind["silent"] == pytest.approx(silent, rel=1e-3)
    assert errors.by_kind["right"] == pytest.approx(0.1, abs=1e-6)
    wrong = np.sqrt(np.mean((0.5 * samples.distance + 0.1) ** 2))
    assert errors.by_kind["wrong"] == pytest.approx(wrong, rel=1e-3)
    assert errors.loss == pytest.approx((0.5 * 0.1**2 + 0.25 * (wrong**2 + silent**2)) / 5.97**2, rel=1e-3)
    np.testing.assert_allclose(offset(network, samples, np.array([0.0, 2.0, 7.0, 8.0])), [0.1, 0.1, np.nan], atol=1e-6)


def test_tuning_finds_the_unit_that_was_concealed():
    plan = replace(COARSE, angles_deg=(0.0, 30.0), distances_mm=tuple(float(d) for d in range(400, 6001, 400)), pings=2)
    setup, hidden = Setup(gain=20), replace(Unit.nominal(), sensitivity_db=9.0)
    target = Silence.of_samples(Samples.of(survey(Rig(hidden, setup), plan, seed=1)))
    nominal = Silence.of_samples(Samples.of(survey(Rig(Unit.nominal(), setup), plan, seed=2)))
    told = []
    found = tuned(setup, target, 15, 2, lambda done, of: told.append(done), plan)
    assert found.misfit < 0.4 * nominal.apart(target)
    assert found.unit.sensitivity_db == pytest.approx(9.0, abs=3.0)
    assert all(low <= getattr(found.unit, name) <= high for name, (low, high) in RANGES.items())
    assert told[-1] == found.trials <= 15


def random_network(kind, rng):
    """Return a network of the thesis's shape with weights of chance."""
    if kind == "mlp":
        shapes = {"dense_1_W": (4, 3), "dense_1_b": (3,), "dense_2_W": (3, 1), "dense_2_b": (1,)}
    else:
        gates = {f"lstm_1_{p}_{g}": s for g in "ifco" for p, s in (("W", (1, 3)), ("U", (3, 3)), ("b", (3,)))}
        shapes = {**gates, "dense_1_W": (3, 1), "dense_1_b": (1,)}
    return ThesisNetwork(kind, {name: 0.3 * rng.standard_normal(shape) for name, shape in shapes.items()})


def test_the_command_writes_tables_and_a_figure(tmp_path, monkeypatch, capsys):
    small = replace(PLANS["thesis"], distances_mm=(300.0, 1500.0, 3900.0, 6000.0))
    rng = np.random.default_rng(0)
    monkeypatch.setattr(rig, "PLANS", {"thesis": small})
    monkeypatch.setattr("training.thesis.tuning.COARSE", replace(small, pings=1))
    author = {"MLP": random_network("mlp", rng), "LSTM": random_network("lstm", rng)}
    monkeypatch.setattr("training.thesis.compare_thesis.published", lambda folder: author)
    main(Args(tmp_path / "networks", tmp_path / "out", trials=0, pings=4, seeds=1, epochs=1))
    text = (tmp_path / "out" / "tables.md").read_text()
    assert text.strip() in capsys.readouterr().out
    assert "nan" not in text
    assert "compare-thesis --networks networks --out out --trials 0 --pings 4 --seeds 1 --epochs 1" in text
    assert (
        text.count("| gain 31, nominal") == 9
    )  # two edges, each with its networks; misfit, errors, two of offsets, the printed cell
    assert (tmp_path / "out" / "rig-versus-thesis.png").read_bytes()[1:4] == b"PNG"


def test_what_cannot_be_compared_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"holds no \*\.h5 or \*\.hdf5; get the networks of github\.com"):
        published(tmp_path)
    with pytest.raises(SettingError, match="--seeds must be at least 1, got 0"):
        main(Args(tmp_path, tmp_path, seeds=0))


def test_author_s_networks_know_where_his_sonar_was_silent(thesis_files):
    """Published: all four agree that the mirror was heard to about the end ahead, and less and less far aside."""
    answers = [Silence.of_network(network.output) for network in published(thesis_files).values()]
    assert len(answers) == 4
    told = middle(answers)
    assert (np.diff(told.never[:, 2:], axis=1) < 0.0).all()
    assert (told.deaf_from[0, :3] > 5.0).all()
    assert max(one.apart(told) for one in answers) < 0.5


@pytest.mark.slow
def test_where_his_sonar_heard_tells_of_full_gain_and_of_reflectors_that_faced_it(thesis_files):
    """At the gain that the thesis states silent pings lie a metre too near; at full gain they agree to 0.6 m.

    With reflectors parallel to the sensor's face they do not, however sensitive the unit.
    """
    target = middle([Silence.of_network(network.output) for network in published(thesis_files).values()])

    def apart(gain, facing=True, sensitivity_db=3.0):
        rig = Rig(replace(Unit.nominal(), sensitivity_db=sensitivity_db), Setup(gain=gain))
        return Silence.of_samples(Samples.of(survey(rig, replace(COARSE, facing=facing), 1))).apart(target)

    assert apart(14) > 0.9
    assert apart(31) < 0.6
    assert apart(31, facing=False) > 1.1
    assert apart(31, facing=False, sensitivity_db=12.0) > 0.8


def test_printed_condition_is_found_among_samples():
    samples = made(lambda d, deaf, k: np.where(k == 0, 0.0, d + 0.06))
    case = rig.Case("any", Rig(), samples, {}, 0)
    credence, heard = cell_readings(case)
    assert credence == pytest.approx(0.75)
    assert heard == pytest.approx([3960.0, 3960.0], abs=0.1)
