"""Vector form of SonarParking-v0: `gymnasium.make_vec("SonarParking-v0", num_envs=1024)`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from acquisition import SettingError
from sonar_gym.parking.environment import SonarParkingEnv, check_render_mode
from sonar_gym.parking.fleet import MAX_STEPS, Fleet, Observation, RewardWeights
from sonar_gym.parking.street import StreetSettings
from sonar_gym.parking.vehicle import CarSettings
from sonar_gym.sensing.mounts import Layout
from sonar_gym.sensing.odometry import OdometryChoice
from sonar_gym.sensing.sonar import SonarChoice

Bits = NDArray[np.bool_]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Outcome = tuple[Observation, Floats, Bits, Bits, dict[str, Any]]
MASK = "reset_mask"  # option of `reset` in Gymnasium that selects environments


def cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class SonarParkingVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """n environments that are stepped together. Each is identical to a `SonarParkingEnv` with its seed.

    Environment i is seeded with `seed + i`, or with item i of a list of seeds, and has its own random streams. Infos
    are arrays with a leading axis of n. Each has a mask under the same name with the prefix "_", as in Gymnasium.

    Args:
        num_envs: number of environments n.
        sonar, sonar_layout, street, car, reward, odometry, difficulty, render_mode: see `SonarParkingEnv`.
        max_episode_steps: time limit of an episode; None for no limit.
        autoreset_mode: `AutoresetMode` or its value: "NextStep" (default), "SameStep" or "Disabled".
        threads: number of threads; by default one per processor if there are many environments.
        pictured: indices of the environments that `render` draws.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as in Gymnasium
        **SonarParkingEnv.metadata,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        sonar: SonarChoice = "ideal",
        sonar_layout: Layout = "eight",
        street: StreetSettings | Mapping[str, Any] | None = None,
        car: CarSettings | Mapping[str, Any] | None = None,
        reward: RewardWeights | Mapping[str, Any] | None = None,
        odometry: OdometryChoice = "exact",
        render_mode: str | None = None,
        difficulty: str = "normal",
        max_episode_steps: int | None = MAX_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        pictured: Sequence[int] = (0,),
    ) -> None:
        if num_envs < 1:
            raise SettingError(f"num_envs must be >= 1, got {num_envs}")
        check_render_mode(render_mode)
        if not all(0 <= i < num_envs for i in pictured):
            raise SettingError(f"pictured must hold numbers of environments below {num_envs}, got {list(pictured)}")
        self.num_envs, self.render_mode, self.pictured = num_envs, render_mode, tuple(pictured)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.max_episode_steps = max_episode_steps
        self.fleet = Fleet(
            num_envs,
            sonar,
            sonar_layout,
            difficulty,
            street,
            car,
            reward,
            odometry,
            cores() if threads is None else threads,
        )
        self.single_observation_space = self.fleet.observation_space
        self.single_action_space = self.fleet.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rows = np.arange(num_envs)
        self._streams: list[np.random.Generator | None] = [None] * num_envs
        self._seeds = [-1] * num_envs
        self._over = np.zeros(num_envs, dtype=np.bool_)  # ended and not yet reset
        self._renderers: dict[int, Any] = {}

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each environment; -1 before the first reset."""
        return tuple(self._seeds)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Generator of the streets of each environment."""
        return tuple(self._stream(i) for i in range(self.num_envs))

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes of readings, by number; see `SonarParkingEnv`."""
        return self.fleet.causes

    def _stream(self, i: int, seed: int | None = None) -> np.random.Generator:
        """Return the generator of an environment, newly seeded if a seed is given or none exists yet."""
        stream = self._streams[i]
        if stream is None or seed is not None:
            stream, self._seeds[i] = seeding.np_random(seed)
            self._streams[i] = stream
            self.fleet.seed(self._seeds[i], i)
        return stream

    # ---- reset and step ----------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin new episodes in all environments, or in those of `options["reset_mask"]`.

        Args:
            seed: seed of the first environment, increasing by one; or one seed per environment; None keeps the streams.
            options: see `SonarParkingEnv.reset`; and `reset_mask`, bool, (n,).
        """
        seeds = self._seed_each(seed)
        options = dict(options or {})
        mask = self._mask(options.pop(MASK)) if MASK in options else np.ones(self.num_envs, dtype=np.bool_)
        rows = self._rows[mask]
        for i in rows:
            self._stream(int(i), seeds[i])
        self._begin(rows, options)
        self._show()
        return self.fleet.observation(slice(None)), self._infos(mask)

    def _seed_each(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (int, np.integer)):
            return [int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise SettingError(f"seed holds {len(seed)} seeds, expected {self.num_envs}: one per environment")
        return seed

    def _mask(self, given: Any) -> Bits:
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise SettingError(
                f"reset option '{MASK}' must be {self.num_envs} booleans with at least one True; "
                f"got {mask.dtype} of shape {mask.shape}"
            )
        return mask

    def _begin(self, rows: Ints, options: Mapping[str, Any] | None = None) -> None:
        self.fleet.reset(rows, [self._stream(int(i)) for i in rows], options)
        self._over[rows] = False

    def step(self, actions: ArrayLike) -> Outcome:
        """Drive all cars for 0.1 s. `autoreset_mode` determines how ended episodes are reset.

        Actions beyond -1..1 are clipped. NaN and infinity raise `SettingError` before any environment is stepped. The
        action of an environment that is reset is ignored.
        """
        if np.any(self.fleet.worlds.steps < 0):
            raise gymnasium.error.ResetNeeded("SonarParking-v0: step() before the first reset(); call reset() first")
        again, going = self._rows[self._over], self._rows[~self._over]
        if len(again) and self.autoreset_mode is AutoresetMode.DISABLED:
            raise gymnasium.error.ResetNeeded(
                f"SonarParking-v0: environment {again[0]} has ended; reset it with options={{'{MASK}': ...}}"
            )
        if len(going):
            self.fleet.step(going, self._checked(actions, going))
        if len(again):
            self._begin(again)
        return self._outcome()

    def _checked(self, actions: ArrayLike, going: Ints) -> Floats:
        """Return the actions of the running environments, clipped to -1..1."""
        value = np.asarray(actions, dtype=np.float64)
        if value.shape != (self.num_envs, 2):
            raise SettingError(f"actions have shape {value.shape}, expected ({self.num_envs}, 2): steering and speed")
        value = value[going]
        if not np.isfinite(value.sum()):
            for i, action in zip(going, value, strict=True):
                if not np.all(np.isfinite(action)):
                    raise SettingError(f"action of environment {i} must be finite, got {action}: check the policy")
        return np.minimum(np.maximum(value, -1.0), 1.0)

    def _outcome(self) -> Outcome:
        """Return the results of a step, and reset ended episodes in the mode "SameStep"."""
        fleet, everyone = self.fleet, np.ones(self.num_envs, dtype=np.bool_)
        rewards: Floats = fleet.worlds.terms.sum(axis=1)
        terminated: Bits = np.any(fleet.worlds.ended, axis=1)
        limit = self.max_episode_steps
        truncated: Bits = fleet.worlds.steps >= (np.inf if limit is None else limit)
        self._over = terminated | truncated
        final = self._finals(self._over) if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any() else {}
        if final:
            self._begin(self._rows[self._over])
        self._show()
        return fleet.observation(slice(None)), rewards, terminated, truncated, {**self._infos(everyone), **final}

    def _infos(self, mask: Bits) -> dict[str, Any]:
        return masked(self.fleet.truth(slice(None)), mask)

    def _finals(self, over: Bits) -> dict[str, Any]:
        """Return the final observations and infos of ended episodes."""
        observations: NDArray[Any] = np.full(self.num_envs, None, dtype=object)
        for i in self._rows[over]:
            observations[i] = self.fleet.observation(i)
        return masked({"final_obs": observations, "final_info": self._infos(over)}, over)

    # ---- rendering ---------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Draw the environments of `pictured`: arrays (height, width, 3) of uint8, or a window for "human"."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() needs a render_mode: gymnasium.make_vec(..., render_mode='rgb_array')")
            return None
        if np.any(self.fleet.worlds.steps < 0):
            raise gymnasium.error.ResetNeeded("SonarParking-v0: render() before the first reset(); call reset() first")
        from sonar_gym.parking.rendering import Renderer  # imports pygame

        shown = self.pictured if self.render_mode == "rgb_array" else self.pictured[:1]
        for i in shown:
            if i not in self._renderers:
                self._renderers[i] = Renderer(self.render_mode, self.metadata["render_fps"])
        pictures = [self._renderers[i].draw(self.fleet.view(i)) for i in shown]
        return tuple(pictures) if self.render_mode == "rgb_array" else None

    def close_extras(self, **_: Any) -> None:
        """Close windows and shut threads down."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        self.fleet.close()


def masked(infos: Mapping[str, Any], mask: Bits) -> dict[str, Any]:
    """Return infos, including nested ones, each with its mask of environments."""
    out: dict[str, Any] = {}
    for name, value in infos.items():
        out[name] = masked(value, mask) if isinstance(value, dict) and not name.startswith("final") else value
        out[f"_{name}"] = mask.copy()
    return out
