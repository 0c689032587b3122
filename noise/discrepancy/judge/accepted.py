"""What a hypothesis predicts, compared with the recording so that errors of the law do not count as differences.

No law describes a sonar exactly. What it gets wrong of both files cancels only where both are scored alike, and a
hypothesis is rejected only where each of these comparisons rejects it:

- both files under the law of the recording, after the causes have acted on the readings of the simulation, with sizes
  near the likelihood's at which they agree best (the test of overidentifying restrictions of Hansen 1982);
- the law of the recording beside that of the simulation, as both were fitted;
- the same with the nuisances of the simulation, since nuisances are no differences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linprog

from acquisition.arrays import Floats
from noise.composed import ComposedModel, with_differences
from noise.discrepancy.locate.directed import directed_test, sampled_in_order
from noise.discrepancy.locate.orthogonal import Tested
from noise.discrepancy.locate.stability import size_between, sizes
from noise.discrepancy.moments.bootstrap import signs_of
from noise.discrepancy.moments.sample import Sample
from noise.discrepancy.name.search import Search
from noise.discrepancy.thresholds import LEFT_LEVEL, MOVED_SHARE
from noise.fitting.batch import Batch
from noise.fitting.stack import Stack
from noise.model import SonarModel
from noise.replay import Replay, with_simulated

EXACT = 1e-6  # step of given readings, m: those that are equal remain so
STEP = 0.1  # of a size, for the slopes of the statistics
MOVES = 4  # towards the sizes at which both files agree, each so short that the statistics are linear; chosen here


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two files and the law of each.

    Attributes:
        recorded, simulated: laws of the recording and of the simulation.
        sample: readings of both.
    """

    recorded: Stack
    simulated: Stack
    sample: Sample


Test = Callable[[Comparison], Tested]


@dataclass(frozen=True, eq=False)
class Comparing:
    """Compares hypotheses with a recording.

    Attributes:
        search: readings and candidates.
        sample: readings of both files.
        emulator: law that describes the simulation.
        test: whether the files of a comparison differ.
        seed: of the draws in which causes act on readings.
    """

    search: Search
    sample: Sample
    emulator: SonarModel
    test: Test
    seed: int

    def least_rejected(self, effects: Sequence[str], law: Stack, moves: int = MOVES) -> tuple[Tested, Comparison]:
        """Return the test of the comparison that rejects a law of the recording least, and the comparison.

        Args:
            effects: in which the recording differs.
            law: of the recording.
            moves: of the sizes of causes towards those at which both files agree.
        """
        best: tuple[Tested, Comparison] | None = None
        for tested, each in self.comparisons(effects, law, moves):
            if best is None or tested.p_value.value > best[0].p_value.value:
                best = tested, each
            if not best[0].is_below(LEFT_LEVEL):
                break
        assert best is not None
        return best

    def p_of_rest(self, effects: Sequence[str], law: Stack, rng: np.random.Generator) -> float:
        """Return the least p-value of the tests of regions and of directions, of the comparison that rejects least.

        Args:
            effects: in which the recording differs.
            law: of the recording.
            rng: draws signs and folds.
        """
        # one move: sizes that go farther to agree would hide what a further effect explains, and cost a test each
        tested, each = self.least_rejected(effects, law, 1)
        if tested.is_below(LEFT_LEVEL):
            return tested.p_value.value
        signs = signs_of(each.sample.cluster, rng)
        directed = directed_test(each.simulated, each.sample, signs, rng, tested, each.recorded)
        return min(tested.p_value.value, directed.p_value.value)

    def comparisons(self, effects: Sequence[str], law: Stack, moves: int) -> Iterator[tuple[Tested, Comparison]]:
        """Yield the comparisons in which a hypothesis may agree with the recording, each tested, the fairest first."""
        common, acted = self.search.common, self.acted(effects, law)
        if acted is not None:
            tested, agreed = self.test(acted), acted
            yield tested, acted
            for _ in range(moves):
                matched = self.matched(effects, agreed.recorded, tested)
                if matched is None:
                    break
                tested, agreed = self.test(matched), matched
                yield tested, matched
        keys = self.search.differing(effects)
        shared = common.put(keys, [law.get(key) for key in keys])
        for compared in (Comparison(law, common, self.sample), Comparison(shared, common, self.sample)):
            yield self.test(compared), compared

    def matched(self, effects: Sequence[str], law: Stack, tested: Tested) -> Comparison | None:
        """Return the comparison with the sizes of the causes at which its greatest statistic is least.

        The statistics are linear in the sizes, nearly. A likelihood that is wrong for both files misses the size of
        their difference by more than its own errors.

        Args:
            effects: the causes.
            law: of the recording.
            tested: of both files under the law, after the causes have acted.
        """
        common = self.search.common
        keys = [key for name in effects for key in sizes(law, name) if not law.parameter(key).jumps]
        steps = {key: STEP * size_between(law, common, key) for key in keys}
        moved = {key: self.acted(effects, law.at({key: law.get(key) + step})) for key, step in steps.items() if step}
        if not moved or None in moved.values():
            return None
        z = tested.z
        slope = np.stack([self.test(each).z - z for each in moved.values() if each is not None], axis=-1)
        known = np.isfinite(slope).all(axis=-1) & np.isfinite(z)
        if not known.any():
            return None
        best = least_greatest(z[known], slope[known], MOVED_SHARE / STEP)
        return self.acted(
            effects, law.at({key: law.get(key) + x * steps[key] for key, x in zip(moved, best, strict=True)})
        )

    def acted(self, effects: Sequence[str], law: Stack) -> Comparison | None:
        """Return both files under a law, after the causes have acted on the simulation; None where one cannot."""
        simulated = self.sample.simulated
        if simulated is None:
            return None
        replay = Replay(self.emulator, EXACT, self.search.folds.both.resolution)
        model, left_out = acting_on(replay, self.search.common, law, tuple(effects))
        if model is None or left_out:
            return None
        drawn = applied(model, simulated, np.random.default_rng(self.seed))
        return Comparison(law, law, replace(self.sample, simulated=drawn, scored=[]))


def least_greatest(value: Floats, slope: Floats, most: float) -> Floats:
    """Return the steps x, (k,), from -most to most, for which the greatest of |value + slope x| is least.

    Args:
        value: (n,).
        slope: (n, k).
        most: limit of each step.
    """
    n, k = slope.shape
    above = np.concatenate([slope, -slope])
    limits = np.concatenate([-value, value])
    bounds = [*[(-most, most)] * k, (0.0, None)]
    found = linprog(np.r_[np.zeros(k), 1.0], np.c_[above, -np.ones(2 * n)], limits, bounds=bounds)
    return np.zeros(k) if found.x is None else np.asarray(found.x[:k])


def applied(model: SonarModel, readings: Batch, rng: np.random.Generator) -> Batch:
    """Return readings with a model applied to them, each given what it made of the reading before."""
    given, uniform = with_simulated(readings.ping, readings.reading, readings.past), rng.random(len(readings))
    return sampled_in_order(readings, lambda each: model.law(given, each.past), uniform, model.remembers)


def acting_on(
    model: SonarModel, common: Stack, recorded: Stack, effects: tuple[str, ...]
) -> tuple[ComposedModel | None, dict[str, str]]:
    """Return the differences between two stacks, acting on another model, None where none can; and what cannot."""
    # the readings of the simulator have its early and late echoes already
    shared = [term.without_tails() for term in common.terms]
    causes = {name: recorded.effects[name] for name in effects}
    composed, left_out = with_differences(model, common.effects, causes, shared)
    return composed if len(left_out) < len(causes) else None, left_out
