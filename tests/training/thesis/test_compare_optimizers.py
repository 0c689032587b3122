"""Command `compare-optimizers` on a small survey, and its statistics on known answers."""

import numpy as np
import pytest
from scipy.stats import t

from acquisition import ModelError, Ping, Reading, Recording, SettingError
from training.thesis.compare_optimizers import Args, main
from training.thesis.data import A1_TRAIN, A1_VALIDATION, TABLES, Samples
from training.thesis.experiment import THESIS_ORDER, Comparison, SeedMean, ThesisFindings, digest, train_all
from training.thesis.fit import OPTIMISERS, Fitted, Recipe
from training.thesis.surfaces import MIRROR, READINGS, RUBBER, SILENCE_AS_MEAN

FIGURES = {f"figure-{name}.png" for name in ("4.3", "4.4", "4.5", "4.6", "5.1", "a.1")}


def survey():
    """Return a survey of 48 conditions without echoes beyond 3 m."""
    distance, angle, reflectance = np.meshgrid(
        [0.3, 1.0, 2.0, 4.0, 5.0, 6.0], np.radians([0, 10, 22.5, 45]), [0.1, 0.9]
    )
    ping = Ping.of(*(np.repeat(a.ravel(), 6) for a in (distance, angle, np.zeros(distance.shape), reflectance)))
    noise = np.random.default_rng(0).normal(0, 0.01, len(ping))
    far = ping.distance > 3.0
    reading = Reading.of(np.where(far, 0.0, np.round(ping.distance + noise, 2)), np.where(far, 0, 1))
    return Recording.of(ping, reading)


def times_written(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("thesis")
    args = Args(survey().save(folder / "survey.csv"), folder / "out", seeds=2, sizes=(10, 12), epochs=2)
    main(args)
    return args


def test_the_command_writes_all_figures_and_tables(run):
    assert {path.name for path in run.out.iterdir()} == FIGURES | {"tables.md", "networks"}
    assert all((run.out / name).read_bytes()[1:4] == b"PNG" for name in FIGURES)
    page = (run.out / "tables.md").read_text()
    for row in TABLES[10].values():
        assert f"| {row.train:.4f} |" in page
    assert "Table 4.2: 10 neurons" in page
    assert "Table 4.3" not in page  # the thesis has no table of 12 neurons
    assert "sonar-gym compare-optimizers survey.csv --out out --seeds 2 --sizes 10 12 --epochs 2" in page
    assert "nan" not in page
    assert all(f"]({name})" in page for name in FIGURES)


def test_tables_are_complete_with_one_seed_and_early_stopping(run, tmp_path):
    args = Args(run.recording, tmp_path, seeds=1, sizes=(10,), epochs=6, patience=1, l1=1e-3, l2=1e-3, dropout=0.0)
    main(args)
    page = (tmp_path / "tables.md").read_text()
    assert "nan" not in page
    claims = page.split("Statements of the thesis")[1].split("takes almost")[0]
    assert "| undecided |" in claims
    assert "| agrees |" not in claims  # a single seed has no interval
    assert len(list((tmp_path / "networks").iterdir())) == len(args.comparison.jobs)


def test_a_second_run_loads_the_networks_and_writes_the_same_page(run):
    page, written = (run.out / "tables.md").read_text(), times_written(run.out / "networks")
    main(run)
    assert (run.out / "tables.md").read_text() == page
    assert times_written(run.out / "networks") == written


def test_an_interrupted_run_loses_only_the_current_network(tmp_path):
    samples = Samples.of(survey())
    jobs = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs

    def interrupt(job, done, total):
        if job == jobs[3]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_all(jobs, samples, tmp_path, interrupt)
    written = times_written(tmp_path)
    assert len(written) == 3
    resumed = train_all(jobs, samples, tmp_path)
    assert times_written(tmp_path).items() > written.items()
    retrained = train_all(jobs[:3], samples, tmp_path / "again")
    for job in jobs[:3]:
        np.testing.assert_array_equal(resumed[job].theta, retrained[job].theta)


def test_progress_counts_the_epochs_of_all_networks(tmp_path):
    samples, reports = Samples.of(survey()), []
    jobs = Comparison(Recipe(epochs=2), seeds=1, sizes=(10,)).jobs[:2]
    for _ in range(2):
        train_all(jobs, samples, tmp_path, lambda job, done, total: reports.append((done, total)))
    assert reports == [(1, 4), (2, 4), (2, 4), (3, 4), (4, 4), (4, 4), (2, 4), (4, 4)]


def test_a_damaged_network_file_is_named(tmp_path):
    samples = Samples.of(survey())
    job = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs[0]
    path = tmp_path / f"{job.key(digest(samples))}.safetensors"
    path.write_bytes(b"half a file")
    with pytest.raises(ModelError, match=r"mlp-10-sgd-seed0-.*not a network of a comparison"):
        train_all([job], samples, tmp_path)


def test_file_names_differ_between_data_and_settings():
    job = Comparison(Recipe(epochs=1), seeds=1, sizes=(10,)).jobs[0]
    other = Comparison(Recipe(epochs=1, dropout=0.1), seeds=1, sizes=(10,)).jobs[0]
    assert len({job.key("a"), job.key("b"), other.key("a")}) == 3


def findings_with(loss):
    """Return findings with given final losses by optimiser, equal for all sizes and seeds but for a little noise."""
    comparison = Comparison(seeds=5)
    rng = np.random.default_rng(0)

    def fitted(job):
        value = loss[job.recipe.optimiser] + rng.normal(0, 1e-5)
        curve = np.linspace(value + 0.01, value, job.recipe.epochs)
        return Fitted(job.network.initial(rng), curve, curve, np.arange(1.0, job.recipe.epochs + 1))

    return ThesisFindings(comparison, {job: fitted(job) for job in comparison.jobs}, Samples.of(survey()))


def test_agreement_with_the_thesis_of_equal_and_reversed_rankings():
    printed = {name: TABLES[20][name].validation for name in OPTIMISERS}
    same, reversed_ = findings_with(printed), findings_with({name: 0.1 - loss for name, loss in printed.items()})
    assert same.agreement(20)[:2] == pytest.approx((1.0, 1.0))
    assert reversed_.agreement(20)[:2] == pytest.approx((-1.0, -1.0))
    assert same.ranks(20) == {"nadam": 1, "adam": 2, "rmsprop": 3, "adadelta": 4, "sgd": 5, "adagrad": 6}
    verdicts = [[claim.verdict for claim in findings.claims()[:5]] for findings in (same, reversed_)]
    assert verdicts == [["agrees"] * 5, ["contrary"] * 5]


def test_intervals_are_student_s():
    values = np.array([1.0, 2.0, 4.0, 7.0, 3.0])
    low, high = t.interval(0.95, 4, values.mean(), values.std(ddof=1) / np.sqrt(5))
    mean = SeedMean.of(values)
    assert (mean.value, mean.half_width) == pytest.approx((values.mean(), (high - low) / 2))
    assert SeedMean.of([1.0, 1.1, 0.9, 1.0, 1.2]).verdict() == "agrees"
    assert SeedMean.of([-1.0, -1.1, -0.9, -1.0, -0.8]).verdict() == "contrary"
    assert SeedMean.of([-1.0, 1.1, 0.9, -1.0, 0.1]).verdict() == "undecided"


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_seeds_have_neither_a_spread_nor_a_verdict(n):
    mean = SeedMean.of(np.linspace(1.0, 1.001, n))
    assert str(mean) == f"{mean.value:.4f}"
    assert mean.verdict() == "undecided"
    assert "±" in str(SeedMean.of([1.0, 1.1, 1.2, 1.3, 1.4]))


def test_credence_of_readings_and_of_silence_replaced_by_its_mean():
    surfaces = findings_with(dict.fromkeys(OPTIMISERS, 0.01)).surfaces
    near = surfaces.distance < 3.0
    assert surfaces.mean(READINGS, near) == pytest.approx(1.0, abs=0.02)
    assert surfaces.mean(READINGS, ~near) == 0.0
    # the mean distance of silent pings, 5 m, is correct at 5 m only
    assert surfaces.silent.tolist() == (~near).tolist()
    correct = surfaces.credence[SILENCE_AS_MEAN][0, ~near]
    np.testing.assert_array_equal(correct == 1.0, np.isclose(surfaces.distance[~near], 5.0))
    assert surfaces.of(MIRROR).sum() == surfaces.of(RUBBER).sum() == 24


def test_printed_results_are_consistent_with_the_thesis_s_text():
    """All tables have the same order of optimisers; listing A.1 has 20 epochs, the last with the least loss."""
    assert {tuple(sorted(table, key=lambda name: table[name].validation)) for table in TABLES.values()} == {
        THESIS_ORDER
    }
    assert len(A1_TRAIN) == len(A1_VALIDATION) == 20
    assert min(A1_VALIDATION) == A1_VALIDATION[-1] == 0.0134


def test_zero_seeds_are_an_error(tmp_path):
    with pytest.raises(SettingError, match="seeds 0 and sizes"):
        main(Args(tmp_path / "rec.csv", tmp_path, seeds=0))


@pytest.mark.slow
def test_the_rig_ranks_the_optimisers_as_the_thesis_does(tmp_path):
    """The missing recording is made by the rig; two epochs suffice to rank the optimisers."""
    args = Args(tmp_path / "survey.csv", tmp_path / "out", seeds=1, sizes=(20,), epochs=2)
    main(args)
    samples = Samples.of(Recording.load(args.recording))
    comparison = args.comparison
    findings = ThesisFindings(comparison, train_all(comparison.jobs, samples, args.out / "networks"), samples)
    assert (len(samples), samples.condition.max() + 1) == (133_100, 2662)
    assert findings.agreement(20)[0] > 0.9
    assert samples.loss_floor() < findings.losses(20).min() < 0.5 * np.var(samples.label)
