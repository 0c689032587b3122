"""Paired comparisons, and `sonar-gym compare-drivers`: arms, table, file."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from noise import Faulty
from training.agents.compare_drivers import Args, compare, sonar_of
from training.cli import main
from training.common.statistics import PairedComparison

bits = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60)


@settings(deadline=None)
@given(bits)
def test_the_difference_is_that_of_the_shares_and_changes_sign_with_the_order(pairs):
    first, second = np.array(pairs).T
    paired = PairedComparison.of(first, second)
    assert paired.difference == pytest.approx(second.mean() - first.mean())
    low, high = paired.interval
    assert -1.0 <= low < high <= 1.0
    again = PairedComparison.of(second, first)
    assert (again.p, again.difference) == pytest.approx((paired.p, -paired.difference))
    assert again.interval == pytest.approx((-high, -low))


def test_the_interval_covers_the_truth_in_95_percent():
    rng = np.random.default_rng(0)
    first, second = rng.random((2000, 150)) < 0.9, rng.random((2000, 150)) < 0.8
    intervals = np.array([PairedComparison.of(a, b).interval for a, b in zip(first, second, strict=True)])
    covered = (intervals[:, 0] <= -0.1) & (intervals[:, 1] >= -0.1)
    assert covered.mean() == pytest.approx(0.95, abs=0.015)


def test_mcnemar_s_test_has_known_p_values():
    assert PairedComparison(gained=1, lost=9, scenes=50).p == pytest.approx(22 / 1024)  # 2 (1 + 10) / 2^10
    assert PairedComparison(gained=0, lost=0, scenes=50).p == 1.0


def test_the_ideal_sonar_has_no_faults():
    assert isinstance(sonar_of("gaussian", 0.1), Faulty)
    assert not isinstance(sonar_of("ideal", 0.1), Faulty)
    assert not isinstance(sonar_of("gaussian", 0.0), Faulty)


def test_each_sonar_drives_with_and_without_credence():
    arms = compare(Args(sonars=("gaussian",), episodes=2))
    assert [(arm.sonar, arm.perception) for arm in arms] == [
        ("ideal", "survey"),
        ("ideal", "fusion"),
        ("gaussian", "survey"),
        ("gaussian", "fusion"),
    ]
    assert all(arm.outcomes.success.all() for arm in arms)


def test_the_command_prints_a_table_and_writes_episodes(tmp_path, capsys):
    path = tmp_path / "episodes.csv"
    main(["compare-drivers", "--sonars", "gaussian", "--episodes", "1", "--seed", "3", "--out", str(path)])
    out = capsys.readouterr().out
    assert "streets of seeds 3 to 3" in out
    assert "| gaussian | fusion | 1 of 1 | 0 |" in out
    rows = pd.read_csv(path)
    assert list(rows.seed) == [3] * 4
    assert rows.success.all()
    assert [p.name for p in tmp_path.iterdir()] == ["episodes.csv"]


def test_invalid_settings_are_refused(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["compare-drivers", "--episodes", "0"])
    assert stopped.value.code == 2
    assert "--episodes: expected a whole number from 1 to 1000000, got 0" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["compare-drivers", "--faults", "0.6"])
    assert "--faults: expected a number from 0 to 0.5, got 0.6" in capsys.readouterr().err
