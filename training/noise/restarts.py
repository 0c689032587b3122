"""Restarts of a recurrent law's memory during training, and the sequences that it cuts.

A sonar that is driven about meets faces that it has never faced before, so that its law begins anew with each of them;
in a recording only the first ping of a run has no past. Half of the runs are therefore cut in each pass, mostly where a
pause shows that another reflector was placed, and at random pings elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from acquisition import EchoStatus
from noise.learned.recurrent_state import N_HISTORY_FEATURES

RUN_SHARE = 0.5  # of the runs that are cut
RATE, RATE_AFTER_PAUSE = 1.0 / 16.0, 0.8  # probability that a ping of such a run begins a sequence
PAUSE = math.log1p(5.0) / 4.0  # s, as a feature of the history
_INTERVAL, _WAS_ECHO, _ERRORS = 1, 6 + EchoStatus.ECHO, (9, 10, 11)  # features of the history that depend on a restart


def whole_runs(valid: Tensor) -> Tensor:
    """Return where sequences begin if no run is cut, (runs, pings)."""
    begins = torch.zeros_like(valid)
    begins[:, 0] = True
    return begins


def draw_restarts(features: Tensor, valid: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Draw where sequences begin, (runs, pings) bool.

    Args:
        features: inputs of the network, the history last, (runs, pings, in).
        valid: False for padding, (runs, pings).
        generator: source of the numbers.
    """
    interval = features[..., _INTERVAL - N_HISTORY_FEATURES]
    rate = torch.where(interval > PAUSE, RATE_AFTER_PAUSE, RATE)
    rate *= torch.rand((len(valid), 1), generator=generator) < RUN_SHARE
    return whole_runs(valid) | (torch.rand(valid.shape, generator=generator) < rate)


def echo_known(features: Tensor, begins: Tensor) -> Tensor:
    """Return whether a sequence had an echo before each ping, (runs, pings)."""
    place = torch.arange(begins.shape[1]).expand(begins.shape)
    was_echo = features[..., _WAS_ECHO - N_HISTORY_FEATURES] > 0.0
    last_echo = torch.where(was_echo, place - 1, -1).cummax(dim=1).values
    return last_echo >= torch.where(begins, place, 0).cummax(dim=1).values


def without_past(features: Tensor, begins: Tensor) -> Tensor:
    """Return features whose history holds no ping before the beginning of its sequence."""
    history = features[..., -N_HISTORY_FEATURES:] * ~begins[..., None]
    history[..., _ERRORS] *= echo_known(features, begins)[..., None]
    return torch.cat([features[..., :-N_HISTORY_FEATURES], history], dim=-1)


def padded_sequences(begins: Tensor, valid: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield the sequences of similar lengths, up to twice the shortest: indices of valid pings, and which are padding.

    The indices are among the valid pings, run by run, (sequences, pings).
    """
    length = torch.bincount(begins[valid].cumsum(0) - 1)
    start = length.cumsum(0) - length
    octave = torch.log2(length).ceil()
    for each in octave.unique():
        rows = octave == each
        place = torch.arange(int(length[rows].max()))
        padding = place >= length[rows, None]
        yield torch.where(padding, 0, start[rows, None] + place), padding
