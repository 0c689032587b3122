"""The estimate of the persisting shares against samples with known ones."""

import numpy as np
import pytest
from scipy.special import ndtr

from acquisition import ModelError, Ping, Reading, SettingError
from noise import GaussianModel, load_model, save_model
from noise.learned.persistence import Persistence, share_of_detection, share_of_range, survey_persistence

N = 20_000


def normals(share, rng):
    """Return two standard normal numbers per visit with a correlation."""
    common = rng.standard_normal(N)
    return [np.sqrt(share) * common + np.sqrt(1 - share) * rng.standard_normal(N) for _ in range(2)]


@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_share_of_detection_is_recovered(share):
    rng = np.random.default_rng(0)
    probability = rng.uniform(0.05, 0.95, N)
    echoes = [ndtr(z) < probability for z in normals(share, rng)]
    assert share_of_detection(probability, *echoes) == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_share_of_range_is_recovered(share):
    rng = np.random.default_rng(1)
    law = GaussianModel(sigma=0.05, sigma_per_metre=0.0).law(Ping.of(np.full(N, 2.0)))
    first, second = (2.0 + 0.05 * z for z in normals(share, rng))
    assert share_of_range(law, first, second) == pytest.approx(share, abs=0.03)


def test_a_survey_needs_visits_of_two_pings():
    ping = Ping.of(np.linspace(1.0, 2.0, 40))
    assert survey_persistence(GaussianModel(), ping, Reading.of(np.full(40, 1.0))) is None


def test_the_shipped_law_has_its_split_and_keeps_it_on_disk(tmp_path):
    model = load_model("srf08-mlp")
    assert model.persistence.detection > 0.9
    assert model.persistence.range > 0.9
    assert load_model(save_model(model, tmp_path / "copy")).persistence == model.persistence
    text = (tmp_path / "copy" / "model.json").read_text()
    (tmp_path / "copy" / "model.json").write_text(text.replace(f'"range": {model.persistence.range}', '"range": 2.0'))
    with pytest.raises(ModelError, match=r"persistence\.range: input should be less than or equal to 1, got 2"):
        load_model(tmp_path / "copy")


def test_invalid_values_raise():
    with pytest.raises(SettingError, match=r"Persistence.range: expected a number from 0 to 1, got 1.5"):
        Persistence(0.5, 1.5)
    with pytest.raises(SettingError, match=r"Persistence.length_m: expected a number above 0 .* m, got 0 m"):
        Persistence(0.5, 0.5, length_m=0.0)
