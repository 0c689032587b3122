"""The command compare-optimizers on a small survey, and its statistics on data with known results."""

import numpy as np
import pytest
from scipy.stats import t

from acquisition import ModelError, Ping, Reading, Recording, SettingError
from training.thesis.compare_optimizers import Args, main
from training.thesis.data import A1_TRAIN, A1_VALIDATION, TABLES, Samples
from training.thesis.experiment import Comparison, Mean, ThesisFindings, digest, train_all
from training.thesis.fit import OPTIMISERS, Recipe, TrainingResult
from training.thesis.surfaces import MIRROR, READINGS, RUBBER, SUBSTITUTED

FIGURES = {f"figure-{name}.png" for name in ("4.3", "4.4", "4.5", "4.6", "5.1", "a.1")}


def survey():
    """Return a survey of 48 conditions; beyond 3 m there is no echo."""
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
    assert "Table 4.3" not in page  # no table of the thesis has 12 neurons
    assert "sonar-gym compare-optimizers survey.csv --out out --seeds 2 --sizes 10 12 --epochs 2" in page
    assert "nan" not in page
    assert all(f"]({name})" in page for name in FIGURES)


def test_one_seed_that_stops_early_gives_whole_tables(run, tmp_path):
    args = Args(run.recording, tmp_path, seeds=1, sizes=(10,), epochs=6, patience=1, l1=1e-3, l2=1e-3, dropout=0.0)
    main(args)
    page = (tmp_path / "tables.md").read_text()
    assert "nan" not in page
    assert "| agrees |" not in page.split("Claims of the thesis")[1].split("takes almost")[0]  # one seed is undecided
    assert len(list((tmp_path / "networks").iterdir())) == len(args.comparison.jobs)


def written(folder):
    """Return the time of the last change of each file."""
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_a_second_run_trains_nothing_and_writes_the_same_tables(run):
    before, networks = (run.out / "tables.md").read_text(), written(run.out / "networks")
    main(run)
    assert (run.out / "tables.md").read_text() == before
    assert written(run.out / "networks") == networks


def test_an_interrupted_run_loses_only_the_current_network(tmp_path):
    samples = Samples.of(survey())
    jobs = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs

    def interrupt(job, done, total):
        if job == jobs[3]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_all(jobs, samples, tmp_path, interrupt)
    first = written(tmp_path)
    assert len(first) == 3
    results = train_all(jobs, samples, tmp_path)
    assert len(written(tmp_path)) == len(jobs)
    assert first.items() <= written(tmp_path).items()
    again = train_all(jobs[:3], samples, tmp_path / "again")
    for job in jobs[:3]:
        np.testing.assert_array_equal(results[job].theta, again[job].theta)


def test_progress_counts_the_passes_of_all_networks(tmp_path):
    jobs, passes = Comparison(Recipe(epochs=2), seeds=1, sizes=(10,)).jobs[:2], []
    train_all(jobs, Samples.of(survey()), tmp_path, lambda job, done, total: passes.append((done, total)))
    assert sorted(set(passes)) == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_an_invalid_network_file_is_an_error(tmp_path):
    samples = Samples.of(survey())
    job = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs[0]
    path = tmp_path / f"{job.key(digest(samples))}.safetensors"
    path.write_bytes(b"half a file")
    with pytest.raises(ModelError, match=r"mlp-10-sgd-seed0-.*not a network of a comparison"):
        train_all([job], samples, tmp_path)


def test_data_and_settings_change_the_name_of_the_file():
    job = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs[0]
    other = Comparison(Recipe(epochs=1, dropout=0.1), seeds=1, sizes=(10,)).jobs[0]
    assert len({job.key("a"), job.key("b"), other.key("a")}) == 3


def artificial(loss):
    """Return findings with given final losses by optimiser, in every size and seed, with small noise."""
    comparison = Comparison(seeds=3)
    rng = np.random.default_rng(0)

    def result(job):
        value = loss[job.recipe.optimiser] + rng.normal(0, 1e-5)
        curve = np.linspace(value + 0.01, value, job.recipe.epochs)
        return TrainingResult(job.network.initial(rng), curve, curve, np.arange(1.0, job.recipe.epochs + 1))

    return ThesisFindings(comparison, {job: result(job) for job in comparison.jobs}, Samples.of(survey()))


def test_agreement_with_the_printed_ranking():
    printed = {name: TABLES[20][name].validation for name in OPTIMISERS}
    same, reversed_ = artificial(printed), artificial({name: 0.1 - loss for name, loss in printed.items()})
    assert same.agreement(20)[:2] == pytest.approx((1.0, 1.0))
    assert reversed_.agreement(20)[:2] == pytest.approx((-1.0, -1.0))
    assert same.ranks(20) == {"nadam": 1, "adam": 2, "rmsprop": 3, "adadelta": 4, "sgd": 5, "adagrad": 6}
    verdicts = [[claim.verdict for claim in findings.claims()[:5]] for findings in (same, reversed_)]
    assert verdicts == [["agrees"] * 5, ["contrary"] * 5]


def test_intervals_use_student_s_t():
    values = np.array([1.0, 2.0, 4.0, 7.0])
    low, high = t.interval(0.95, 3, values.mean(), values.std(ddof=1) / 2)
    assert (Mean.of(values).value, Mean.of(values).half) == pytest.approx((values.mean(), (high - low) / 2))
    assert Mean.of([1.0, 1.1, 0.9]).verdict() == "agrees"
    assert Mean.of([-1.0, -1.1, -0.9]).verdict() == "contrary"
    assert Mean.of([-1.0, 1.1, 0.9]).verdict() == Mean.of([1.0]).verdict() == "undecided"


def test_credence_surfaces_of_readings():
    surfaces = artificial(dict.fromkeys(OPTIMISERS, 0.01)).surfaces
    near = surfaces.distance < 3.0
    assert surfaces.mean(READINGS, near) == pytest.approx(1.0, abs=0.02)
    assert surfaces.mean(READINGS, ~near) == 0.0
    # the substituted distance, 5 m, is right only at 5 m
    assert surfaces.silent.tolist() == (~near).tolist()
    right = surfaces.credence[SUBSTITUTED][0, ~near]
    np.testing.assert_array_equal(right == 1.0, np.isclose(surfaces.distance[~near], 5.0))
    assert surfaces.of(MIRROR).sum() == surfaces.of(RUBBER).sum() == 24


def test_printed_numbers_are_consistent():
    """The tables have one order; listing A.1 has twenty passes and ends at the stated loss."""
    orders = {tuple(sorted(table, key=lambda name: table[name].validation)) for table in TABLES.values()}
    assert orders == {("nadam", "adam", "rmsprop", "adadelta", "sgd", "adagrad")}
    assert len(A1_TRAIN) == len(A1_VALIDATION) == 20
    assert min(A1_VALIDATION) == A1_VALIDATION[-1] == 0.0134


def test_settings_without_any_network_are_an_error(tmp_path):
    with pytest.raises(SettingError, match="seeds 0 and sizes"):
        main(Args(tmp_path / "rec.csv", tmp_path, seeds=0))


@pytest.mark.slow
def test_optimisers_rank_on_the_rig_as_in_the_thesis(tmp_path, monkeypatch):
    """The recording is made if it is missing; two passes are enough to rank the optimisers."""
    found = []
    monkeypatch.setattr(
        "training.thesis.compare_optimizers.ThesisFindings",
        lambda *args: found.append(ThesisFindings(*args)) or found[0],
    )
    main(Args(tmp_path / "survey.csv", tmp_path / "out", seeds=1, sizes=(20,), epochs=2))
    samples = found[0].samples
    assert (len(samples), samples.condition.max() + 1) == (133_100, 2662)
    assert found[0].agreement(20)[0] > 0.9
    assert samples.loss_floor() < found[0].losses(20).min() < 0.5 * np.var(samples.label)
