"""A curriculum for Stable-Baselines3: streets become harder as the cars succeed."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from acquisition import SettingError
from acquisition.arguments import checked
from acquisition.limits import Count, Rate, Share, check_value
from sonar_gym.checks import check_observation
from sonar_gym.street.street import StreetSettings, replaced, street_settings


def between(begin: StreetSettings, end: StreetSettings, share: float) -> StreetSettings:
    """Return settings between two others: every number and every limit is interpolated, and numbers of spaces rounded.

    The kinds of obstacles are those of `end` as soon as the share is above 0.

    Args:
        begin: settings at a share of 0.
        end: settings at a share of 1.
        share: 0..1.

    >>> between(StreetSettings(gap=(1.0, 1.2)), StreetSettings(gap=(0.8, 0.8)), 0.5).gap
    (0.9, 1.0)
    """

    def mixed(a: Any, b: Any) -> Any:
        return tuple(map(mixed, a, b)) if isinstance(a, tuple) else (1.0 - share) * a + share * b

    names = [one.name for one in fields(begin) if one.name != "obstacles"]
    values = {name: mixed(getattr(begin, name), getattr(end, name)) for name in names}
    values["decoys"] = tuple(map(round, values["decoys"]))
    return StreetSettings(**values, obstacles=end.obstacles if share > 0.0 else begin.obstacles)


class Curriculum(BaseCallback):
    """Moves the streets of a `SonarVecEnv` from one distribution towards another while the cars park in them.

    Whenever the success rate of the last `episodes` episodes reaches `success`, the share of the hard streets grows by
    `step`; episodes that run finish in their streets. `curriculum/share` is logged.

    Args:
        begin: first streets: settings, a level of difficulty, or a mapping of the fields that differ from the last.
        end: last streets: settings or a level of difficulty.
        success: success rate from which the streets become harder, 0..1.
        step: increase of the share.
        episodes: number of episodes in which success is counted.

    Attributes:
        share: 0 for the first streets, 1 for the last.
    """

    @checked
    def __init__(
        self,
        begin: StreetSettings | Mapping[str, object] | str = "easy",
        end: StreetSettings | str = "hard",
        success: Rate = 0.8,
        step: Rate = 0.1,
        episodes: Count = 200,
    ) -> None:
        super().__init__()
        self.end = street_settings(end) if isinstance(end, str) else end
        named = street_settings(begin) if isinstance(begin, str) else None
        self.begin = named or replaced(self.end, begin, "begin")
        self.success, self.step, self.share = success, step, 0.0
        self._ends: deque[bool] = deque(maxlen=episodes)

    def state_dict(self) -> dict[str, object]:
        """Return what a checkpoint of the training must hold, as plain data."""
        return {"share": self.share, "ends": list(self._ends)}

    def load_state_dict(self, state: Mapping[str, object]) -> None:
        """Continue from a state that `state_dict` returned.

        Raises:
            SettingError: it is no such state.
        """
        check_observation(state, {"share": (), "ends": None}, "state")
        given: Mapping[str, Any] = state
        check_value("state['share']", given["share"], Share)
        self.share = float(given["share"])
        self._ends.clear()
        self._ends.extend(bool(parked) for parked in given["ends"])

    def _on_training_start(self) -> None:
        if not self.training_env.has_attr("street_settings"):
            raise SettingError(
                "Curriculum: the training environment has no street_settings that can be changed: train on SonarVecEnv"
            )
        self._set_streets()

    def _on_step(self) -> bool:
        done = zip(self.locals["dones"], self.locals["infos"], strict=True)
        self._ends.extend(bool(info["is_success"]) for ended, info in done if ended)
        if self.share < 1.0 and len(self._ends) == self._ends.maxlen and self._rate >= self.success:
            self.share = min(1.0, self.share + self.step)
            self._ends.clear()
            self._set_streets()
        return True

    @property
    def _rate(self) -> float:
        return sum(self._ends) / len(self._ends)

    def _on_rollout_end(self) -> None:
        self.logger.record("curriculum/share", self.share)

    @property
    def streets(self) -> StreetSettings:
        """Present streets."""
        return between(self.begin, self.end, self.share)

    def _set_streets(self) -> None:
        self.training_env.set_attr("street_settings", self.streets)
