"""Train PPO of Stable-Baselines3 to park with sonars, and count the unseen streets in which it parks."""

import time

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor

from sonar_gym import SonarExtractor, SonarVecEnv

UNSEEN = 1_000_000  # seed of the first street of the test; those of training follow from the seed of PPO


def main(steps: int = 1_500_000, seed: int = 0, sonar: str = "ideal", streets: int = 200) -> float:
    torch.set_num_threads(1)  # a small network is slower with more
    begin = time.perf_counter()
    envs = VecMonitor(SonarVecEnv(64, sonar=sonar))
    settings = {"n_steps": 128, "batch_size": 1024, "n_epochs": 5, "learning_rate": 5e-4}
    features = {"features_extractor_class": SonarExtractor}
    model = PPO("MultiInputPolicy", envs, seed=seed, device="cpu", policy_kwargs=features, **settings)
    model.learn(steps)
    seconds = time.perf_counter() - begin

    parked: list[bool] = []
    test = VecMonitor(SonarVecEnv(streets, sonar=sonar))
    test.seed(UNSEEN)
    note_end = lambda now, _: now["done"] and parked.append(now["info"]["is_success"])  # noqa: E731
    evaluate_policy(model, test, streets, callback=note_end)
    share = sum(parked) / len(parked)
    print(f"seed {seed}: parked in {share:.1%} of {len(parked)} unseen streets after {seconds:.0f} s of training")
    return share


if __name__ == "__main__":
    main()
