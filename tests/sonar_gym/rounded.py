"""An environment whose rewards the checkers can compare."""

import gymnasium
import numpy as np


class Rounded(gymnasium.Wrapper):
    """highway-env's rewards for one goal and for several may differ in their last bit, which the checker forbids."""

    def compute_reward(self, *goals):
        return np.round(self.unwrapped.compute_reward(*goals), 9)

    def step(self, action):
        observation, reward, *rest = self.env.step(action)
        return observation, float(np.round(reward, 9)), *rest
