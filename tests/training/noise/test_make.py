"""Corpus, shipped models and report, at a small scale."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import Recording
from noise import load_model
from noise.learned.gain import LOSS
from noise.store import WEIGHTS
from training.cli import main
from training.noise import corpus, experiments, make, make_front_ends, report
from training.noise.conditions import calibration
from training.noise.corpus import (
    EMPTY,
    STAND,
    WALL,
    Sessions,
    drive,
    first_pings,
    record,
    record_unit,
    survey,
    with_lead_in,
)

SMALL = Sessions((5, 6), surveys=2, drives=1, visits=8, pings=10)
QUICK_PLAN = replace(corpus.QUICK_PLAN, angles_deg=(0.0,), distances_mm=(400.0, 900.0, 1500.0), pings=8)
TINY = {
    "train": SMALL,
    "validation": replace(SMALL, units=(9,)),
    "faulty": replace(SMALL, faulty=True),
    "faulty-validation": replace(SMALL, units=(9,), faulty=True),
    "drives": replace(SMALL, surveys=0, drives=2, seed=6),
    "gains": replace(SMALL, gains=True, seed=5),
    "gains-validation": replace(SMALL, units=(9,), gains=True, seed=5),
    "known": (replace(QUICK_PLAN, pings=12), (5, 6), 1),
    "conditions": (QUICK_PLAN, (5, 6), 2),
    "sensors": (QUICK_PLAN, (7, 8), 3),
    "fresh-conditions": replace(SMALL, seed=4),
    "fresh-sensors": replace(SMALL, units=(7,), seed=4),
}


def test_recordings_do_not_depend_on_the_process():
    here, there = record_unit(SMALL, 6), record(replace(SMALL, units=(6,)), jobs=2)
    np.testing.assert_array_equal(here["reading_mm"].to_numpy(), there.table["reading_mm"].to_numpy())


def test_surveys_visit_stands_walls_and_empty_scenes():
    course = survey(4000, np.random.default_rng(0))
    first = np.flatnonzero(np.r_[True, np.diff(course.ping.time) > 1.0])
    assert len(first) == 4000
    share = np.bincount(course.scene[first]) / 4000
    np.testing.assert_allclose(share[[STAND, WALL, EMPTY]], (0.82, 0.10, 0.08), atol=0.02)
    assert np.diff(first).mean() == pytest.approx(np.dot(corpus.VISIT_PINGS, corpus.VISIT_PINGS_PROBABILITY), rel=0.05)
    ping, wall, nothing = course.ping, course.scene == WALL, course.scene == EMPTY
    assert np.all(ping.incidence[wall] == 0.0)
    assert np.all(ping.distance[nothing] > 6.0)
    assert np.all(ping.distance[~nothing] <= 6.0)
    within = np.diff(ping.time)
    assert np.all((np.abs(within - 0.1) < 1e-9) | (within >= 19.9))


def test_drives_change_the_condition_at_every_ping():
    course = drive(60, np.random.default_rng(1))
    assert len(np.unique(course.ping.distance)) == 60
    assert np.abs(np.diff(course.ping.distance)).max() < 1.2
    assert len(np.unique(course.scene)) == 1


def test_first_pings_of_each_visit():
    recorded = record(replace(SMALL, units=(5,)))
    keep = first_pings(recorded, 2)
    visits = len(np.unique(np.stack([recorded.run, recorded.condition]), axis=1).T)
    assert visits < keep.sum() < 2 * visits
    assert keep[0]


def test_empty_scenes_rarely_echo_and_loose_wires_lose_answers():
    recorded = record(replace(SMALL, units=(5,), surveys=6))
    nothing = recorded.ping.distance > 6.3
    assert nothing.any()
    assert recorded.reading.echo[nothing].mean() < 0.2
    assert recorded.reading.answered.all()
    faulty = record(replace(SMALL, units=(5,), surveys=6, faulty=True))
    assert not faulty.reading.answered.all()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        for module in (corpus, make, report):
            patch.setattr(module, "RECORDINGS", TINY)
        patch.setattr(make, "CONDITIONS", {"cold": (-5.0, {}), "gain 7": (20.0, {"gain": 7})})
        patch.setattr(make, "NEW_SENSORS", replace(SMALL, units=(8, 9)))
        patch.setattr(make, "TRAINING_SETTINGS", {law: {"epochs": 2} for law in make.TRAINING_SETTINGS})
        patch.setattr(make_front_ends, "N_SENSORS", {"hcsr04": (2, 1, 1), "maxbotix": (1, 1, 1)})
        patch.setattr(make_front_ends, "TEMPERATURES_C", {"hcsr04": (-10.0,), "maxbotix": (45.0,)})
        patch.setattr(make_front_ends, "NEW_SENSORS", replace(SMALL, units=(8,)))
        patch.setattr(make_front_ends, "SETTINGS", {"epochs": 2})
        patch.setattr(report, "SCENARIOS", {"independent": experiments.MemoryScenario()})
        plan = experiments.RecentCredencePlan
        patch.setattr(report, "RecentCredencePlan", lambda depth: plan(depth, epochs=1))
        main(["make-noise", "--out", str(folder / "weights"), "--data", str(folder / "corpus")])
        models = [str(folder / "weights" / f"srf08-{law}") for law in make.TRAINING_SETTINGS]
        command = ["noise-report", "--data", str(folder / "corpus"), "--out", str(folder / "docs"), "--sessions", "4"]
        main([*command, "--models", *models])
    return folder


def test_one_command_makes_all_three(made):
    for law in ("mlp", "lstm", "hybrid"):
        model = load_model(made / "weights" / f"srf08-{law}")
        assert "sonar-gym make-noise" in model.card
        assert model.about["seed"] == 0
        assert set(model.about["scores"]) == {"ideal", "Gaussian, fitted", "network"}
        assert model.inputs.covariates == ("temperature_c", LOSS)
    assert model.base is not None


@pytest.mark.parametrize(("sensor", "inputs"), [("hcsr04", ("temperature_c",)), ("maxbotix", ())])
def test_the_same_command_makes_a_perceptron_of_each_other_sensor(made, sensor, inputs):
    model = load_model(made / "weights" / f"{sensor}-mlp")
    assert (model.resolution, model.inputs.covariates) == (0.001, inputs)
    assert model.inputs.known >= {"temperature_c", "humidity_pct"}
    assert f"sonar-gym make-noise --sensors {sensor}" in model.card
    condition = {"hcsr04": "-10 degC", "maxbotix": "45 degC"}[sensor]
    sessions = replace(SMALL, units=(8,), seed=100, sensor=sensor, temperature_c=(float(condition[:-5]),) * 2)
    gap = calibration(model, record(sessions)).gap
    assert model.about["calibration"] == {condition: pytest.approx(gap.mean, abs=1e-4)}
    assert f"| {gap} |" in model.card


@pytest.mark.parametrize("law", ["mlp", "lstm", "hybrid"])
def test_a_card_states_what_the_code_computes(made, law):
    model, more = load_model(made / "weights" / f"srf08-{law}"), [] if law == "mlp" else ["faulty", "drives"]
    recorded = [Recording.load(made / "corpus" / f"{name}.csv") for name in ("train", "gains", *more)]
    answered = np.concatenate([r.reading.answered for r in recorded])
    assert (answered.mean() < 1.0) == (law != "mlp")  # loose wires lose answers
    text = " ".join(model.card.split())
    assert f"{len(answered)} pings" in text
    assert f"without an answer: {np.mean(~answered):.3g}." in text
    for name, low, high in zip(model.inputs.names, model.inputs.low, model.inputs.high, strict=True):
        assert f"| `{name}` | {low:.4g} | {high:.4g} |" in text
    assert "gain" not in model.inputs.fixed
    assert "one value only of `humidity_pct` 50, `range_mm` 6063" in text
    assert "A gain enters as the loss of the echo" in text
    scenes = {scene: replace(setup, gain=7) for scene, setup in corpus.SCENES.items()}
    sessions = replace(SMALL, units=(8, 9), seed=101, temperature_c=(20.0, 20.0), scenes=scenes)
    gap = calibration(model, record(sessions)).gap
    assert model.about["calibration"]["gain 7"] == pytest.approx(gap.mean, abs=1e-4)
    assert f"| {gap} |" in text
    assert "Licence" in text
    assert ("persist within a visit" in text) == (getattr(model, "persistence", None) is not None)


def test_cards_are_written_again_without_training(made):
    folder = made / "weights" / "srf08-mlp"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    (folder / "README.md").write_text("outdated")
    with pytest.MonkeyPatch.context() as patch:
        for module in (corpus, make):
            patch.setattr(module, "RECORDINGS", TINY)
        patch.setattr(make, "CONDITIONS", {"cold": (-5.0, {}), "gain 7": (20.0, {"gain": 7})})
        patch.setattr(make, "NEW_SENSORS", replace(SMALL, units=(8, 9)))
        places = ["--out", str(made / "weights"), "--data", str(made / "corpus")]
        main(["make-noise", "--laws", "mlp", "--cards-only", *places])
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_one_command_writes_the_page(made):
    page = (made / "docs" / "noise-models.md").read_text()
    for row in (
        "each condition as recorded",
        "physics, fitted",
        "beam model, by EM",
        "srf08-hybrid",
        "Bayes over",
        "independent",
        "closes 95 % of the gap",
    ):
        assert row in page
    assert "$" not in page
    assert (made / "docs" / "images" / "noise-credence.png").read_bytes()[:4] == b"\x89PNG"


def test_existing_recordings_are_not_recorded_again(made):
    before = (made / "corpus" / "sensors.csv").stat().st_mtime_ns
    corpus.ensure_recorded(made / "corpus", "sensors")
    assert (made / "corpus" / "sensors.csv").stat().st_mtime_ns == before
    assert set(Recording.load(made / "corpus" / "sensors.csv").table["sensor"]) == {"7", "8"}


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_the_shipped_models_are_made_again_to_within_0_03_nats(tmp_path):
    args = make.Args(tmp_path / "weights", tmp_path / "corpus")
    make.main(args)
    for name in (*(f"srf08-{law}" for law in args.laws), "hcsr04-mlp", "maxbotix-mlp"):
        again, shipped = (load_model(folder / name) for folder in (args.out, WEIGHTS))
        one, two = (model.about["scores"]["network"]["log_likelihood_per_ping"] for model in (again, shipped))
        assert one == pytest.approx(two, abs=0.03)


def test_shipped_weights_are_small_and_carry_their_cards():
    folders = [WEIGHTS / f"srf08-{law}" for law in make.TRAINING_SETTINGS]
    assert sum(path.stat().st_size for folder in folders for path in folder.iterdir()) < 5e6
    for folder in folders:
        card = (folder / "README.md").read_text()
        assert "sonar-gym make-noise" in card
        assert "Limits" in card


def test_pings_before_a_visit_fill_the_filter_of_a_sensor():
    course = survey(20, np.random.default_rng(2))
    longer, lead_in = with_lead_in(course, 4)
    assert lead_in.sum() == 4 * 20
    np.testing.assert_array_equal(longer.ping.time[~lead_in], course.ping.time)
    assert len(np.unique(longer.ping.run)) == 20
    first = np.flatnonzero(lead_in)[:4]
    np.testing.assert_allclose(np.diff(longer.ping.time[: first[-1] + 2]), corpus.STEP_S)
    np.testing.assert_array_equal(longer.ping.distance[first], course.ping.distance[0])


@pytest.mark.parametrize("sensor", ["hcsr04", "maxbotix"])
def test_other_sensors_have_rooms_of_their_own_and_no_gain(sensor):
    recorded = record(replace(SMALL, units=(5,), sensor=sensor))
    assert recorded.resolution == 0.001
    assert recorded.ping.covariates.keys() == {"temperature_c", "humidity_pct", "interval_s"}
    assert 0.2 < recorded.reading.echo.mean() < 1.0
