"""Training and testing of agents that park.

train            train an agent by imitation and PPO (`sonar-gym train-agent`)
imitation        the teacher, and imitation learning by dataset aggregation
vec_env          vector environment of Stable-Baselines3 over several kinds of environment
zoo              plain algorithms of Stable-Baselines3 and its contrib package with tuned settings (`sonar-gym zoo`)
leaderboard      drivers on fixed streets with worn wheels and damaged sonars (`sonar-gym leaderboard`)
sonars           sonars with faults, sonars that differ from the driver's assumption, sonars with a zero offset
evaluate         success and collision rates on given streets (`sonar-gym evaluate-agent`)
drivers          whatever drives, by name: scripted, agents, models of Stable-Baselines3, functions
dataset          episodes of drivers as datasets of Minari (`sonar-gym dataset`)
ship             save an agent with its card and scores (`sonar-gym ship-agent`)
compare_drivers  the scripted driver with and without credence (`sonar-gym compare-drivers`)
compare_observations  agents with and without credence and echo flags (`sonar-gym compare-observations`)
transfer         train with several sonars, test in the waveform rig (`sonar-gym transfer`)
sweep            several seeds and settings on Ray Tune (`sonar-gym sweep`)
rllib            the parking task for RLlib
"""
