"""What was found in one pair of recordings corrects the simulator under conditions that neither had."""

from dataclasses import replace

import numpy as np
import pytest

import noise
from acquisition import Recording, SettingError
from tests.noise.discrepancy.pairs import TRUTH, model, survey
from training.cli import main

OFFSET_M = 0.03


def read(law, ping, rng):
    return Recording.of(ping, law.law(ping).sample(rng))


@pytest.fixture(scope="module")
def diagnosis():
    rng = np.random.default_rng(4)
    changed = model({**TRUTH, "zero_offset": {"offset_m": OFFSET_M}})
    recorded, simulated = read(changed, survey(rng, visits=60), rng), read(model(TRUTH), survey(rng, visits=60), rng)
    return noise.diagnose("ideal", recorded, simulated=simulated)


def test_the_difference_itself_hides_little_of_what_else_could_have_been_seen(diagnosis):
    least = {each.effect: each.least for each in diagnosis.verdict.could_have_seen}
    assert least["bias"] < 0.1 * OFFSET_M
    assert least["zero_offset"] < 0.1 * OFFSET_M


def test_an_offset_is_applied_to_readings_at_other_conditions(diagnosis):
    rng = np.random.default_rng(5)
    fresh = read(model(TRUTH), survey(rng, visits=40, distances=(0.4, 3.0)), rng)
    corrected = diagnosis.correct(fresh)
    both = fresh.reading.echo & corrected.reading.echo
    change = (corrected.reading.range - fresh.reading.range)[both]
    assert np.median(change) == pytest.approx(OFFSET_M, abs=0.003)
    assert np.mean(np.abs(change - OFFSET_M) < 0.005) > 0.95
    assert corrected.reading.echo.mean() == pytest.approx(fresh.reading.echo.mean(), abs=0.02)


def test_the_command_writes_the_same(diagnosis, tmp_path, capsys):
    rng = np.random.default_rng(6)
    diagnosis.save(tmp_path / "result")
    fresh = read(model(TRUTH), survey(rng), rng)
    fresh.save(tmp_path / "fresh.csv")
    main(["correct", str(tmp_path / "result"), str(tmp_path / "fresh.csv"), "--out", str(tmp_path / "out.csv")])
    np.testing.assert_array_equal(
        Recording.load(tmp_path / "out.csv").reading.range, diagnosis.correct(tmp_path / "fresh.csv").reading.range
    )
    assert "400 pings" in capsys.readouterr().out


def test_a_folder_without_a_difference_is_named(tmp_path, capsys):
    rng = np.random.default_rng(7)
    read(model(TRUTH), survey(rng), rng).save(tmp_path / "fresh.csv")
    with pytest.raises(SystemExit) as stopped:
        main(["correct", str(tmp_path), str(tmp_path / "fresh.csv"), "--out", str(tmp_path / "out.csv")])
    assert stopped.value.code == 2
    assert "holds no difference/" in capsys.readouterr().err


def test_where_nothing_was_found_nothing_is_applied(diagnosis):
    with pytest.raises(SettingError, match="nothing was found that can be applied"):
        replace(diagnosis, difference=None).correct(Recording.of(diagnosis.recorded.ping, diagnosis.recorded.reading))
