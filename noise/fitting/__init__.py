"""Maximum-likelihood fits of physical models to recordings.

batch          answered pings sorted by visit
empirical      physical law with a smooth correction that has no physical cause
fit            local fits, their optimum and its covariance
stack          a model and its nuisance parameters as plain numbers
starts         starting points
threads        one thread for torch
visit_effects  prequential likelihood of pings that share a visit
visits         assignment of pings to conditions and visits
"""
