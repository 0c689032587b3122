"""The comparison as a command, on a small survey, and its statistics where the answer is known."""

import numpy as np
import pytest
from scipy.stats import t

from acquisition import ModelError, Ping, Reading, Recording, SettingError
from training.thesis import runs
from training.thesis.compare_optimizers import Args, main
from training.thesis.credence import MIRROR, READINGS, RUBBER, SILENCE_READ
from training.thesis.data import Samples
from training.thesis.findings import Findings, Mean
from training.thesis.fit import Fitted, Recipe
from training.thesis.numbers import A1_TRAIN, A1_VALIDATION, TABLES
from training.thesis.optimisers import OPTIMISERS
from training.thesis.runs import Comparison, digest, train_all

FIGURES = {f"figure-{name}.png" for name in ("4.3", "4.4", "4.5", "4.6", "5.1", "a.1")}


def survey():
    """Return a survey of 48 conditions; beyond 3 m nothing answers."""
    distance, angle, reflectance = np.meshgrid(
        [0.3, 1.0, 2.0, 4.0, 5.0, 6.0], np.radians([0, 10, 22.5, 45]), [0.1, 0.9]
    )
    ping = Ping.of(*(np.repeat(a.ravel(), 6) for a in (distance, angle, np.zeros(distance.shape), reflectance)))
    noise = np.random.default_rng(0).normal(0, 0.01, len(ping))
    far = ping.distance > 3.0
    reading = Reading.of(np.where(far, 0.0, np.round(ping.distance + noise, 2)), np.where(far, 0, 1))
    return Recording.of(ping, reading)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("thesis")
    args = Args(survey().save(folder / "survey.csv"), folder / "out", seeds=2, sizes=(10, 12), epochs=2)
    main(args)
    return args


def test_the_command_writes_every_figure_and_the_tables(run):
    assert {path.name for path in run.out.iterdir()} == FIGURES | {"tables.md", "networks"}
    assert all((run.out / name).read_bytes()[1:4] == b"PNG" for name in FIGURES)
    page = (run.out / "tables.md").read_text()
    for row in TABLES[10].values():
        assert f"| {row.train:.4f} |" in page
    assert "Table 4.2: 10 neurons" in page
    assert "Table 4.3" not in page  # 12 neurons are in none of the thesis's tables
    assert "sonar-gym compare-optimizers survey.csv --out out --seeds 2 --sizes 10 12 --epochs 2" in page
    assert "nan" not in page
    assert all(f"]({name})" in page for name in FIGURES)


def test_one_seed_that_stops_early_gives_whole_tables(run, tmp_path):
    args = Args(run.recording, tmp_path, seeds=1, sizes=(10,), epochs=6, patience=1, l1=1e-3, l2=1e-3, dropout=0.0)
    main(args)
    page = (tmp_path / "tables.md").read_text()
    assert "nan" not in page
    assert (
        "| agrees |" not in page.split("What the thesis says")[1].split("takes almost")[0]
    )  # one seed decides nothing
    assert len(list((tmp_path / "networks").iterdir())) == len(args.comparison.jobs)


def test_a_second_run_trains_nothing_and_says_the_same(run, monkeypatch, capsys):
    before = (run.out / "tables.md").read_text()

    def forbidden(*args, **kwargs):
        raise AssertionError("a network was trained anew")

    monkeypatch.setattr(runs, "fit", forbidden)
    main(run)
    assert (run.out / "tables.md").read_text() == before


def test_a_killed_run_loses_the_current_network_only(tmp_path, monkeypatch):
    samples = Samples.of(survey())
    jobs = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs
    real, count = runs.fit, []

    def killed(*args, **kwargs):
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt
        return real(*args, **kwargs)

    monkeypatch.setattr(runs, "fit", killed)
    with pytest.raises(KeyboardInterrupt):
        train_all(jobs, samples, tmp_path)
    assert len(list(tmp_path.iterdir())) == 3
    fitted = train_all(jobs, samples, tmp_path)
    assert len(count) == len(jobs) + 1
    monkeypatch.setattr(runs, "fit", real)
    anew = train_all(jobs[:3], samples, tmp_path / "anew")
    for job in jobs[:3]:
        np.testing.assert_array_equal(fitted[job].theta, anew[job].theta)


def test_a_foreign_file_among_the_networks_is_named(tmp_path):
    samples = Samples.of(survey())
    job = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs[0]
    path = tmp_path / f"{job.key(digest(samples))}.safetensors"
    path.write_bytes(b"half a file")
    with pytest.raises(ModelError, match=r"mlp-10-sgd-seed0-.*is no network of a comparison"):
        train_all([job], samples, tmp_path)


def test_networks_of_other_data_or_settings_are_never_taken_for_these():
    job = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs[0]
    other = Comparison(Recipe(epochs=1, dropout=0.1), seeds=1, sizes=(10,)).jobs[0]
    assert len({job.key("a"), job.key("b"), other.key("a")}) == 3


def made_up(loss):
    """Return findings whose last losses are given by optimiser, in every size and seed, with a little scatter."""
    comparison = Comparison(seeds=3)
    rng = np.random.default_rng(0)

    def fitted(job):
        value = loss[job.recipe.optimiser] + rng.normal(0, 1e-5)
        curve = np.linspace(value + 0.01, value, job.recipe.epochs)
        return Fitted(job.network.first(rng), curve, curve, np.arange(1.0, job.recipe.epochs + 1))

    return Findings(comparison, {job: fitted(job) for job in comparison.jobs}, Samples.of(survey()))


def test_the_ranking_agrees_with_the_thesis_where_it_should():
    printed = {name: TABLES[20][name].validation for name in OPTIMISERS}
    same, upside_down = made_up(printed), made_up({name: 0.1 - loss for name, loss in printed.items()})
    assert same.agreement(20)[:2] == pytest.approx((1.0, 1.0))
    assert upside_down.agreement(20)[:2] == pytest.approx((-1.0, -1.0))
    assert same.ranks(20) == {"nadam": 1, "adam": 2, "rmsprop": 3, "adadelta": 4, "sgd": 5, "adagrad": 6}
    verdicts = [[claim.verdict for claim in findings.claims()[:5]] for findings in (same, upside_down)]
    assert verdicts == [["agrees"] * 5, ["contrary"] * 5]


def test_intervals_are_student_s():
    values = np.array([1.0, 2.0, 4.0, 7.0])
    low, high = t.interval(0.95, 3, values.mean(), values.std(ddof=1) / 2)
    assert (Mean.of(values).value, Mean.of(values).half) == pytest.approx((values.mean(), (high - low) / 2))
    assert Mean.of([1.0, 1.1, 0.9]).verdict() == "agrees"
    assert Mean.of([-1.0, -1.1, -0.9]).verdict() == "contrary"
    assert Mean.of([-1.0, 1.1, 0.9]).verdict() == Mean.of([1.0]).verdict() == "undecided"


def test_credence_surfaces_of_readings_are_the_survey_s():
    surfaces = made_up(dict.fromkeys(OPTIMISERS, 0.01)).surfaces
    near = surfaces.distance < 3.0
    assert surfaces.mean(READINGS, near) == pytest.approx(1.0, abs=0.02)
    assert surfaces.mean(READINGS, ~near) == 0.0
    # silence taken for its mean distance, 5 m, is right at 5 m and nowhere else
    assert surfaces.silent.tolist() == (~near).tolist()
    right = surfaces.credence[SILENCE_READ][0, ~near]
    np.testing.assert_array_equal(right == 1.0, np.isclose(surfaces.distance[~near], 5.0))
    assert surfaces.of(MIRROR).sum() == surfaces.of(RUBBER).sum() == 24


def test_the_thesis_s_numbers_hold_together():
    """Each table's order is the same, listing A.1 ends where the text says, twenty passes long."""
    orders = {tuple(sorted(table, key=lambda name: table[name].validation)) for table in TABLES.values()}
    assert orders == {("nadam", "adam", "rmsprop", "adadelta", "sgd", "adagrad")}
    assert len(A1_TRAIN) == len(A1_VALIDATION) == 20
    assert min(A1_VALIDATION) == A1_VALIDATION[-1] == 0.0134


def test_settings_that_compare_nothing_are_refused(tmp_path):
    with pytest.raises(SettingError, match="seeds 0 and sizes"):
        main(Args(tmp_path / "rec.csv", tmp_path, seeds=0))


@pytest.mark.slow
def test_the_rig_ranks_the_optimisers_as_the_thesis_does(tmp_path, monkeypatch):
    """The recording is made where it is missing; two passes are enough to tell the optimisers apart."""
    kept = []
    monkeypatch.setattr(
        "training.thesis.compare_optimizers.Findings", lambda *args: kept.append(Findings(*args)) or kept[0]
    )
    main(Args(tmp_path / "survey.csv", tmp_path / "out", seeds=1, sizes=(20,), epochs=2))
    samples = kept[0].samples
    assert (len(samples), samples.condition.max() + 1) == (133_100, 2662)
    assert kept[0].agreement(20)[0] > 0.9
    assert samples.floor() < kept[0].losses(20).min() < 0.5 * np.var(samples.label)
