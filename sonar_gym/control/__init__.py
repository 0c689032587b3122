"""The scripted parking controller, its perception, and the observation memory of trained agents.

`driver`: the scripted controller `ParkingDriver`, and `run_episode`.
`perception`: perception that takes odometry and readings at face value.
`fusion`: perception by an extended Kalman filter that weights each reading by its credence.
`street_inference`: measurement model and inference of the filter, compiled.
`memory`: features of the recent observations and of the surroundings along the lane, for feed-forward policies.
"""
