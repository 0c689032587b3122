"""Plain algorithms of Stable-Baselines3 and its contrib package with tuned settings.

command   train one, test it on unseen streets, and write it with its card (`sonar-gym zoo`)
settings  the tuned settings, in the format of RL Baselines3 Zoo
ppo.yml, ...  the settings of each environment, a file per algorithm
"""
