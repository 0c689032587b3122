"""Valid files from which bad ones are made."""

import numpy as np
import pytest

from acquisition import Ping, Reading, Recording
from noise import IdealModel, save_model


@pytest.fixture(scope="session")
def valid(tmp_path_factory):
    """Folder with a small recording, a model, and a plan."""
    folder = tmp_path_factory.mktemp("valid")
    recording().save(folder / "recording.csv")
    save_model(IdealModel(), folder / "model")
    (folder / "plan.toml").write_text("angles_deg = [0]\ndistances_mm = [500, 900]\npings = 2\n")
    return folder


def recording(n=240):
    """Return a small recording with two angles, twelve distances and noise."""
    rng = np.random.default_rng(0)
    distance = np.repeat(np.linspace(0.3, 2.5, 12), n // 12)
    ping = Ping.of(distance, np.tile([0.0, 0.1], n // 2), time=0.1 * np.arange(n))
    return Recording.of(ping, Reading.of(np.round(distance + 0.005 * rng.standard_normal(n), 2)))
