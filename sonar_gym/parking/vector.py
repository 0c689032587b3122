"""Many SonarParking-v0 environments: `gymnasium.make_vec("SonarParking-v0", num_envs=1024)`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from acquisition import SettingError
from acquisition.arrays import Bits, Floats, Ints, Singles
from acquisition.limits import SEEDS, Limit, as_numbers, check_choice, check_number, check_value, is_list, shown
from sonar_gym.checks import check_options, settings_of
from sonar_gym.parking.environment import SonarParkingEnv, check_render_mode
from sonar_gym.parking.fleet import MAX_STEPS, Fleet, Observation
from sonar_gym.parking.step_kernel import RewardWeights
from sonar_gym.sensing.mounts import Layout
from sonar_gym.sensing.odometry import OdometryChoice
from sonar_gym.sensing.sonar import SonarChoice
from sonar_gym.street.randomization import Randomization
from sonar_gym.street.street import StreetSettings, check_gap
from sonar_gym.street.vehicle import CarSettings

StepResult = tuple[Observation, Floats, Bits, Bits, dict[str, Any]]
MASK = "reset_mask"  # Gymnasium's reset option that selects environments


def cores() -> int:
    """Return the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class SonarParkingVectorEnv(VectorEnv[Observation, Singles, NDArray[Any]]):
    """n environments stepped together; each gives the same results as a `SonarParkingEnv` with its seed.

    Environment i is seeded with `seed + i`, or with item i of a list of seeds, and has its own random streams. Infos
    are arrays with a leading axis of n, each with a mask under its name preceded by "_", as in Gymnasium. Arguments
    that are not listed are those of `SonarParkingEnv`.

    Args:
        num_envs: number of environments.
        max_episode_steps: number of steps after which an episode is truncated; None for no limit.
        autoreset_mode: `AutoresetMode` or its value: "NextStep" (default), "SameStep" or "Disabled".
        threads: number of threads; default: one per processor.
        pictured: numbers of the environments that `render` draws.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as Gymnasium
        **SonarParkingEnv.metadata,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        sonar: SonarChoice = "ideal",
        sonar_layout: Layout = "eight",
        street: StreetSettings | Mapping[str, object] | None = None,
        car: CarSettings | Mapping[str, object] | None = None,
        reward: RewardWeights | Mapping[str, object] | None = None,
        odometry: OdometryChoice = "exact",
        render_mode: str | None = None,
        difficulty: str = "normal",
        credence_driver: str | None = "agent",
        crosstalk: bool = True,
        randomize: Randomization | Mapping[str, object] | None = None,
        max_episode_steps: int | None = MAX_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        pictured: Sequence[int] = (0,),
    ) -> None:
        check_value("num_envs", num_envs, Annotated[int, Limit(1, 1_000_000)])
        self.num_envs, self.render_mode, self.pictured = num_envs, render_mode, pictured
        check_choice("autoreset_mode", autoreset_mode, [*AutoresetMode, *(mode.value for mode in AutoresetMode)])
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
            credence_driver,
            crosstalk,
            cores() if threads is None else threads,
            randomize,
        )
        self.single_observation_space = self.fleet.observation_space
        self.single_action_space = self.fleet.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rows = np.arange(num_envs)
        self._streams: list[np.random.Generator | None] = [None] * num_envs
        self._seeds = [-1] * num_envs
        self._ended = np.zeros(num_envs, dtype=np.bool_)  # ended and not reset since
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
        """Names of the causes of readings, by number, as in `SonarParkingEnv`."""
        return self.fleet.causes

    @property
    def street_settings(self) -> StreetSettings:
        """Settings from which the streets of the next episodes are drawn; they can be replaced."""
        return self.fleet.street_settings

    @street_settings.setter
    def street_settings(self, settings: StreetSettings) -> None:
        settings = settings_of(StreetSettings, settings, "street_settings")
        check_gap(settings.gap[0], self.fleet.car_settings)
        self.fleet.street_settings = settings

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; raise SettingError for an invalid value of one that can be changed."""
        if name == "max_episode_steps":
            check_value(name, value, Annotated[int, Limit(1, 10**9)] | None)
        elif name == "render_mode":
            check_render_mode(value)
        elif name == "pictured":
            few = value[: self.num_envs + 1] if is_list(value) else value  # a range may be endless in practice
            check_value(name, few, tuple[int, ...])
            if len(few) > self.num_envs or not all(0 <= i < self.num_envs for i in few):
                raise SettingError(
                    f"pictured: expected at most {self.num_envs} numbers of environments below {self.num_envs}, "
                    f"got {shown(value)}"
                )
        super().__setattr__(name, value)

    def _stream(self, i: int, seed: int | None = None) -> np.random.Generator:
        """Return the generator of an environment; a new one if a seed is given or there is none yet."""
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
            seed: seed of the first environment, from which the others count up, or one seed per environment; None
                continues the random streams.
            options: options of `SonarParkingEnv.reset`, and `reset_mask`, bool, (n,).
        """
        check_options(options)
        options = dict(options or {})
        mask = self._mask(options.pop(MASK)) if MASK in options else np.ones(self.num_envs, dtype=np.bool_)
        self.fleet.checked(options)
        seeds = self._seed_each(seed)
        rows = self._rows[mask]
        for i in rows:
            self._stream(int(i), seeds[i])
        self._begin(rows, options)
        self._render_window()
        return self.fleet.observation(slice(None)), self._infos(mask)

    def _seed_each(self, seed: Any) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if not is_list(seed):
            check_number("seed", seed, SEEDS, whole=True)
            return [int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise SettingError(f"seed has {len(seed)} items, expected {self.num_envs}: one per environment")
        for i, each in enumerate(seed):
            if each is not None:
                check_number(f"seed of environment {i}", each, SEEDS, whole=True)
        return [each if each is None else int(each) for each in seed]

    def _mask(self, given: Any) -> Bits:
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise SettingError(
                f"reset option '{MASK}' must be {self.num_envs} booleans, one or more true; "
                f"got {mask.dtype} of shape {mask.shape}"
            )
        return mask

    def _begin(self, rows: Ints, options: Mapping[str, Any] | None = None) -> None:
        self.fleet.reset(rows, [self._stream(int(i)) for i in rows], options)
        self._ended[rows] = False

    def step(self, actions: ArrayLike) -> StepResult:
        """Drive all cars for 0.1 s; `autoreset_mode` determines what happens when an episode ends.

        Actions beyond -1..1 are clipped; NaN and infinity raise a `SettingError`, and no car moves. The action of an
        environment that is reset in this step is ignored.
        """
        if np.any(self.fleet.worlds.steps < 0):
            raise gymnasium.error.ResetNeeded("SonarParking-v0: step() before the first reset(); call reset() first")
        to_reset, running = self._rows[self._ended], self._rows[~self._ended]
        if len(to_reset) and self.autoreset_mode is AutoresetMode.DISABLED:
            raise gymnasium.error.ResetNeeded(
                f"SonarParking-v0: environment {to_reset[0]} has ended; reset it with options={{'{MASK}': ...}}"
            )
        if len(running):
            self.fleet.step(running, self._valid_actions(actions, running))
        if len(to_reset):
            self._begin(to_reset)
        return self._step_result()

    def _valid_actions(self, actions: ArrayLike, running: Ints) -> Floats:
        """Return the actions of the running environments, clipped to -1..1."""
        value = as_numbers("actions", actions)
        if value.shape != (self.num_envs, 2):
            raise SettingError(f"actions have shape {value.shape}, expected ({self.num_envs}, 2): steering and speed")
        value = value[running]
        if not np.isfinite(value.sum()):
            for i, action in zip(running, value, strict=True):
                if not np.all(np.isfinite(action)):
                    raise SettingError(f"action of environment {i} must be finite, got {action}: check the policy")
        return np.minimum(np.maximum(value, -1.0), 1.0)

    def _step_result(self) -> StepResult:
        """Return the result of a step, with resets if the next episode begins in the same step."""
        fleet, all_rows = self.fleet, np.ones(self.num_envs, dtype=np.bool_)
        rewards: Floats = fleet.worlds.terms.sum(axis=1)
        terminated: Bits = np.any(fleet.worlds.ended, axis=1)
        limit = self.max_episode_steps
        truncated: Bits = fleet.worlds.steps >= (np.inf if limit is None else limit)
        self._ended = terminated | truncated
        final = (
            self._final_infos(self._ended)
            if self.autoreset_mode is AutoresetMode.SAME_STEP and self._ended.any()
            else {}
        )
        if final:
            self._begin(self._rows[self._ended])
        self._render_window()
        return fleet.observation(slice(None)), rewards, terminated, truncated, {**self._infos(all_rows), **final}

    def _infos(self, mask: Bits) -> dict[str, Any]:
        return masked(self.fleet.truth(slice(None)), mask)

    def _final_infos(self, ended: Bits) -> dict[str, Any]:
        """Return final observations and infos of the environments whose episodes have ended."""
        observations: NDArray[Any] = np.full(self.num_envs, None, dtype=object)
        for i in self._rows[ended]:
            observations[i] = self.fleet.observation(i)
        return masked({"final_obs": observations, "final_info": self._infos(ended)}, ended)

    # ---- rendering ---------------------------------------------------------------------------------------------------

    def _render_window(self) -> None:
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
        pictures = [self._renderers[i].draw(self.fleet.world(i)) for i in shown]
        return tuple(pictures) if self.render_mode == "rgb_array" else None

    def close_extras(self, **_: Any) -> None:
        """Close windows and threads."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()
        self.fleet.close()


def masked(infos: Mapping[str, Any], mask: Bits) -> dict[str, Any]:
    """Return infos, also nested ones, each with a mask of the environments to which it applies."""
    out: dict[str, Any] = {}
    for name, value in infos.items():
        out[name] = masked(value, mask) if isinstance(value, dict) and not name.startswith("final") else value
        out[f"_{name}"] = mask.copy()
    return out
