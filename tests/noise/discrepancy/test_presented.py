"""Methods of a diagnosis when the packages for figures are not installed."""

import pytest

from acquisition import MissingExtraError
from noise.discrepancy.presented import Presented


def test_figures_without_their_packages_name_the_extra(monkeypatch):
    monkeypatch.setattr("noise.discrepancy.presented.FIGURES", "training.no_such_room.")
    with pytest.raises(
        MissingExtraError, match=r"needs the package 'training.no_such_room': pip install 'sonar-gym\[train\]'"
    ):
        Presented().plot()
