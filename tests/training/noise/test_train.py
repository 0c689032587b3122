"""Training on data whose law is known, and the command."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition import EchoStatus, Ping, Reading, Recording, SettingError
from acquisition.io.logs.foreign import ColumnMap, import_table, parse_constants
from noise import GaussianModel, follow, load_model, save_model, simulate
from noise.effects import CATALOGUE
from noise.learned.inputs import Inputs
from noise.learned.mixture import Head
from noise.metrics import evaluate
from noise.physical import PhysicalModel
from training.cli import main
from training.noise.networks import LstmNetwork, MixtureNetwork, TrainingBatch, recurrent_head
from training.noise.restarts import draw_restarts
from training.noise.train import Args, DataSplit, Rows, doubts, groups, run_segments, train

torch.set_num_threads(1)


def true_model():
    """A sonar with misses, bias, growing scatter and a second mode, which a Gaussian cannot represent."""
    stack = {
        "sensitivity": {"loss_db": 46.0},
        "beam_width": {"ka": 4.8},
        "travel_time_jitter": {"sigma_m": 0.004, "per_metre": 0.004},
        "time_walk": {"scale": 1.0},
        "background_reflector": {"presence": 1.0, "behind_m": 0.3, "loss_db": -6.0},
    }
    return PhysicalModel([CATALOGUE[name](**values) for name, values in stack.items()], resolution=0.01)


def recording(pings=12, distances=40):
    rng = np.random.default_rng(11)
    d, a = np.meshgrid(np.linspace(0.1, 5.5, distances), np.radians([0, 10, 20, 30, 40]), indexing="ij")
    ping = Ping.of(distance=np.repeat(d.ravel(), pings), angle=np.repeat(a.ravel(), pings))
    return Recording.of(ping, simulate(true_model(), ping, rng))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    settings = Args(tmp_path_factory.mktemp("x") / "rec.csv", tmp_path_factory.mktemp("y"), epochs=60, hidden=32)
    return train(recording(), settings)


def test_network_comes_close_to_the_truth_and_beats_a_gaussian(trained):
    # new conditions and readings
    rng = np.random.default_rng(5)
    condition = np.repeat(np.arange(200), 20)
    ping = Ping.of(distance=rng.uniform(0.1, 5.5, 200)[condition], angle=np.radians(rng.uniform(0, 40, 200))[condition])
    reading = simulate(true_model(), ping, rng)
    truth, network = (evaluate(m, ping, reading, condition) for m in (true_model(), trained.model))
    regret = truth.log_likelihood.mean - network.log_likelihood.mean
    assert 0.0 < regret < 0.25
    assert network.crps_mm.mean < 1.15 * truth.crps_mm.mean + 1.0
    assert network.credence_gap < 0.05
    scores = trained.scores
    assert scores["network"].log_likelihood.mean > scores["Gaussian, fitted"].log_likelihood.mean + 0.5
    assert scores["network"].crps_mm.mean < scores["Gaussian, fitted"].crps_mm.mean


def test_torch_and_numpy_forms_agree():
    """Equal likelihoods, including the first and last steps of the register."""
    ping = Ping.of(distance=np.linspace(0.0, 6.0, 60), angle=np.linspace(0.0, 0.7, 60), reflectance=0.5)
    reading = simulate(true_model(), ping, np.random.default_rng(1))
    reading.range[:3] = [0.01, 11.0, 0.02]
    reading.status[:3] = 1
    inputs, head = Inputs.of(ping, ("distance", "angle", "reflectance")), Head(4, 2, 0.01, 11.0, 0.01)
    torch.manual_seed(0)
    network = MixtureNetwork(inputs, head, hidden=16, depth=2)
    with torch.no_grad():
        here = network.log_prob(TrainingBatch.of(inputs, head, ping, reading)).numpy()
    there = network.to_model({}).law(ping).log_prob(reading)
    np.testing.assert_allclose(here, there, atol=2e-3)


@pytest.mark.parametrize("hybrid", [True, False])
def test_torch_and_numpy_forms_of_recurrent_networks_agree(hybrid):
    rng = np.random.default_rng(1)
    ping = Ping.of(
        rng.uniform(0.0, 6.0, 90), rng.uniform(0.0, 0.7, 90), reflectance=0.5, run=rng.integers(0, 3, 90),
        time=np.sort(rng.uniform(0.0, 30.0, 90)), temperature_c=rng.uniform(15, 25, 90),
    )  # fmt: skip
    reading = simulate(true_model(), ping, rng)
    reading.range[::7], reading.status[::7] = 0.0, 2
    inputs = Inputs.of(ping, ("distance", "angle", "reflectance", "temperature_c"))
    torch.manual_seed(0)
    base = MixtureNetwork(inputs, Head(4, 2, 0.01, 11.0), hidden=8, depth=1).to_model({}) if hybrid else None
    network = LstmNetwork(inputs, recurrent_head(Head(4, 2, 0.01, 11.0)), state=5, hidden=7, base=base).eval()
    batch = TrainingBatch.of(inputs, network.head, ping, reading).in_runs(ping.run)
    with torch.no_grad():
        here = network.log_prob(batch).numpy()
        begins = draw_restarts(batch.features, batch.valid, torch.Generator().manual_seed(2))
        cut = network.log_prob(batch, begins).numpy()
    order = np.argsort(ping.run, kind="stable")
    there = network.to_model({}).follow(ping, reading).log_prob(reading)
    np.testing.assert_allclose(here, there[order], atol=2e-3)
    ping, reading = ping[order], reading[order]
    ping = replace(ping, run=begins[batch.valid].cumsum(0).numpy())
    assert len(np.unique(ping.run)) > 4
    np.testing.assert_allclose(cut, network.to_model({}).follow(ping, reading).log_prob(reading), atol=2e-3)


def many_units(seed, sensors=60, pings=40):
    """Sensors with constant offsets of 40 mm standard deviation, one run each."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(sensors), pings)
    ping = Ping.of(rng.uniform(0.3, 3.0, len(run)), run=run, time=np.tile(np.arange(pings) * 0.1, sensors))
    offset, scatter = 0.04 * rng.normal(size=sensors)[run], 0.01 * rng.normal(size=len(run))
    return Recording.of(ping, Reading.of(np.rint((ping.distance + offset + scatter) / 0.01) * 0.01))


def test_memory_learns_a_constant_offset_of_a_sensor(tmp_path):
    settings = Args(tmp_path, tmp_path, epochs=40, hidden=16, state=12, components=2, fixed=0, validation=0.2)
    gaussian = train(many_units(0), settings).scores["network"].log_likelihood
    memory = train(many_units(0), replace(settings, law="lstm")).scores["network"].log_likelihood
    # entropy of a Gaussian in steps of 10 mm, with and without the scatter between sensors
    before, after = (-0.5 * np.log(2 * np.pi * np.e * var / 0.01**2) for var in (0.04**2 + 0.01**2, 0.01**2))
    assert gaussian.mean == pytest.approx(before, abs=0.25)
    assert memory.mean > before + 0.5 * (after - before)


def test_memory_has_no_gain_on_independent_pings(tmp_path):
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(60), 40)
    ping = Ping.of(rng.uniform(0.3, 3.0, len(run)), run=run, time=np.tile(np.arange(40) * 0.1, 60))
    independent = Recording.of(ping, simulate(GaussianModel(0.03, 0.0, 0.05, 0.01), ping, rng))
    settings = Args(tmp_path, tmp_path, epochs=30, hidden=16, state=12, components=2, fixed=0, test=0.3)
    without = train(independent, settings)
    base = save_model(without.model, tmp_path / "base")
    rows = run_segments(independent)[0]
    test = DataSplit.by_group(rows, 0.15, 0.3, np.random.default_rng(0)).test
    hybrid = train(independent, replace(settings, law="hybrid", base=str(base))).model
    gain = (follow(hybrid, ping, independent.reading).log_prob(independent.reading)
            - without.model.law(ping).log_prob(independent.reading))[test]  # fmt: skip
    assert abs(gain.mean()) < 0.03


def test_split_assigns_whole_conditions():
    rec = recording(pings=5)
    split = DataSplit.by_group(rec.condition, 0.15, 0.2, np.random.default_rng(0))
    parts = [split.train, split.validation, split.test]
    assert np.all(np.sum(parts, axis=0) == 1)
    conditions = [set(rec.condition[mask]) for mask in parts]
    assert sum(map(len, conditions)) == len(set.union(*conditions))
    assert [len(c) for c in conditions] == [130, 30, 40]


def test_moving_robot_is_split_by_visits():
    ping = Ping.of(distance=np.linspace(0.5, 3.0, 1000))
    moving = Recording.of(ping, simulate(true_model(), ping, np.random.default_rng(0)))
    condition, unit = groups(moving)
    assert unit == "visits"
    assert np.all(np.diff(condition) >= 0), "groups are contiguous"
    assert 20 <= np.bincount(condition).mean() <= 30
    condition, unit = groups(recording(pings=5))
    assert unit == "conditions"
    assert len(np.unique(condition)) == 200


@pytest.mark.parametrize("law", ["mlp", "lstm"])
def test_scores_are_of_answered_pings_with_errors_over_the_groups_of_the_split(law, tmp_path):
    run = np.repeat(np.arange(20), 50)
    ping = Ping.of(distance=np.linspace(0.5, 3.0, 1000), run=run, time=np.arange(1000) * 0.1)
    reading = simulate(true_model(), ping, np.random.default_rng(0))
    reading.range[::10], reading.status[::10] = 0.0, EchoStatus.NO_ANSWER
    moving = Recording.of(ping, reading)
    args = Args(tmp_path / "rec.csv", tmp_path / "out", law=law, epochs=1, hidden=4, state=4)
    rows = Rows.of(moving, args)
    for score in (done := train(moving, args)).scores.values():
        assert score.log_likelihood.clusters == len(np.unique(rows.group[rows.split.test])) < 15
        assert score.log_likelihood.pings == (rows.split.test & reading.answered).sum()
    assert np.isfinite(done.scores["Gaussian, fitted"].log_likelihood.mean)


def test_same_seed_same_weights(tmp_path):
    settings = Args(tmp_path / "rec.csv", tmp_path / "out", epochs=2, hidden=8)
    one, other = (train(recording(pings=3), settings).model for _ in range(2))
    for (w1, b1), (w2, b2) in zip(one.layers, other.layers, strict=True):
        np.testing.assert_array_equal(w1, w2)
        np.testing.assert_array_equal(b1, b2)


def test_the_command_writes_a_model_that_loads(tmp_path, capsys):
    path = recording(pings=3).save(tmp_path / "rec.csv")
    main(["train-noise", str(path), "--out", str(tmp_path / "net"), "--epochs", "3", "--hidden", "8"])
    output = capsys.readouterr().out
    assert "Gaussian, fitted" in output
    assert "noise.load_model" in output
    model = load_model(tmp_path / "net")
    assert model.resolution == pytest.approx(0.01)
    assert 0 <= model.law(Ping.of(distance=1.0)).credence()[0] <= 1
    card = (tmp_path / "net" / "README.md").read_text()
    assert "sonar-gym train-noise rec.csv --out net --hidden 8 --epochs 3 --seed 0" in card
    assert str(tmp_path) not in card


def test_readings_in_metres_are_doubted(tmp_path, capsys):
    table = recording(pings=3).table
    path = Recording(table.assign(reading_mm=table.reading_mm / 1000)).save(tmp_path / "rec.csv")
    main(["train-noise", str(path), "--out", str(tmp_path / "net"), "--epochs", "1", "--hidden", "2"])
    assert "warning: " in (output := capsys.readouterr().out)
    assert "reading_mm exceeds 20 mm, so the column may be in metres" in output


def test_too_few_conditions_are_an_error_of_one_line(tmp_path, capsys):
    path = recording(pings=3, distances=1).save(tmp_path / "rec.csv")
    with pytest.raises(SystemExit) as stop:
        main(["train-noise", str(path), "--out", str(tmp_path / "net")])
    assert stop.value.code == 2
    assert "holds 5 conditions, training needs 10" in capsys.readouterr().err


def test_covariate_that_was_not_logged_is_an_error(tmp_path):
    with pytest.raises(SettingError, match="covariate 'humidity_pct' is not logged in every row"):
        train(recording(pings=3), Args(tmp_path, tmp_path, covariates=("humidity_pct",)))


def test_network_beats_a_gaussian_on_a_real_sensor(real_recordings, tmp_path):
    columns = ["distance_mm=true_cm:cm", "reading_mm=measured_cm:cm", "session=source_file:text"]
    maps = [ColumnMap.parse(text) for text in columns]
    table = real_recordings / "hcsr04-calibration" / "readings.csv"
    real = import_table(table, maps, parse_constants(("angle_deg=0",)))
    scores = train(real, Args(tmp_path / "rec.csv", tmp_path / "net", epochs=120, hidden=32)).scores
    network, normal = scores["network"].log_likelihood, scores["Gaussian, fitted"].log_likelihood
    assert network.mean - normal.mean > 2 * np.hypot(network.error, normal.error)
    assert scores["network"].crps_mm.mean < 0.7 * scores["Gaussian, fitted"].crps_mm.mean


def test_training_begins_with_the_weights_of_a_start(trained, tmp_path):
    """Without a step, the law is the start's; after a few, it is better than from nothing."""
    start, few = str(save_model(trained.model, tmp_path / "start")), recording(pings=2, distances=6)
    settings = Args(tmp_path / "rec.csv", tmp_path / "out", start=start, epochs=1, learning_rate=1e-12)
    same = train(few, settings).model.law(few.ping).log_prob(few.reading)
    np.testing.assert_allclose(same, trained.model.law(few.ping).log_prob(few.reading), atol=1e-3)
    of_start, of_nothing = (
        train(few, replace(settings, start=given, learning_rate=4e-3)).scores["network"].log_likelihood.mean
        for given in (start, None)
    )
    assert of_start > of_nothing + 0.5


def turned(angles_deg, **covariates):
    """Return a recording in which every ping has an echo, at some angles."""
    distance, angle = np.meshgrid(np.linspace(0.3, 3.0, 30), np.radians(angles_deg), indexing="ij")
    ping = Ping.of(distance=np.repeat(distance.ravel(), 2), angle=np.repeat(angle.ravel(), 2), **covariates)
    return Recording.of(ping, Reading.of(np.round(ping.distance, 3)))


def test_a_start_is_trained_on_what_it_can_tell_apart_and_what_it_knows_is_inside(tmp_path, capsys, monkeypatch):
    few = turned([0.0, 30.0, 60.0], humidity_pct=40.0)
    args = Args(tmp_path / "rec.csv", tmp_path / "net", start="hcsr04-mlp", epochs=1)
    model = train(few, args).model
    assert model.inputs.fixed == {}
    assert "humidity_pct" in model.inputs.averaged
    assert model.law(few.ping).extrapolates.tolist() == (few.ping.angle > 1.0).tolist()
    start = load_model("hcsr04-mlp").inputs
    assert (model.inputs.low, model.inputs.high) == (start.low, start.high)
    splits = []
    monkeypatch.setattr("training.noise.train.groups", lambda each: splits.append(groups(each)) or splits[-1])
    main(["train-noise", str(few.save(tmp_path / "rec.csv")), "--out", str(args.out), "--start", "hcsr04-mlp",
          "--epochs", "1"])  # fmt: skip
    assert len(splits) == 1
    assert "warning: 60 pings lie outside the ranges of hcsr04-mlp (distance" in " ".join(
        capsys.readouterr().out.split()
    )
    with pytest.raises(SettingError, match="too few echoes or answers in the ranges of hcsr04-mlp"):
        train(turned([60.0]), args)


def test_test_rows_that_the_base_has_seen_are_warned_of(tmp_path):
    path = recording(pings=13).save(tmp_path / "rec.csv")
    here = Recording.load(path)
    args = Args(path, tmp_path / "own", epochs=1, hidden=2)
    own = str(save_model(train(here, args).model, args.out))

    def doubts_of(made, other):
        return doubts(made, other, Rows.of(made, other))

    assert not doubts_of(here, replace(args, start=own)), "the same split"
    for other in (replace(args, start=own, seed=1), replace(args, law="hybrid", base=own)):
        (line,) = doubts_of(here, other)
        assert "trained on test rows of this recording" in line
    assert not doubts_of(recording(pings=2), replace(args, start=own, seed=1))


def test_ranges_and_lost_answers_are_those_of_the_rows_that_are_trained_on(tmp_path):
    args = Args(tmp_path / "rec.csv", tmp_path / "out", epochs=1, hidden=2)
    here = recording(pings=3)
    reading = here.reading
    reading.range[::4], reading.status[::4] = 0.0, EchoStatus.NO_ANSWER
    here = Recording.of(here.ping, reading)
    rows = Rows.of(here, args).split.train
    distance, model = here.ping.distance[rows], train(here, args).model
    assert (model.inputs.low[0], model.inputs.high[0]) == (distance.min(), distance.max())
    assert model.head.no_answer == pytest.approx(np.mean(~reading.answered[rows])) != 0.0


def test_a_start_must_be_a_perceptron_for_a_perceptron(tmp_path):
    settings = Args(tmp_path / "rec.csv", tmp_path / "out", start="gaussian", epochs=1)
    for wrong in (settings, replace(settings, start="srf08-mlp", law="lstm")):
        with pytest.raises(SettingError, match="expected a perceptron, for --law mlp"):
            train(recording(), wrong)
