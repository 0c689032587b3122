"""Methods of a diagnosis when the packages for figures are not installed."""

import pytest

from acquisition import MissingExtraError
from noise.discrepancy.presented import Presented


def test_figures_without_their_packages_name_the_extra(monkeypatch):
    monkeypatch.setattr("noise.discrepancy.presented.FIGURES", "no_such_package.")
    with pytest.raises(MissingExtraError, match=r"need no_such_package: pip install 'sonar-gym\[training\]'"):
        Presented().plot()
