"""Maximum-likelihood fits of physical models to recordings.

batch          answered pings sorted by visit
empirical      physical law with smooth corrections and the scatter of placements, as a savable model
fit            local fits, their optimum and its covariance
learn_smooth   fit of a smooth correction, with strengths chosen on unseen conditions
likelihood     log-likelihood under many stacks at once
smooth         smooth corrections in the law's own coordinates
smooth_basis   readings, physics and basis of that fit
stack          a model and its nuisance parameters as plain numbers
starts         starting points
threads        one thread for torch
visit_effects  prequential likelihood of pings that share a visit
visits         assignment of pings to conditions and visits
"""
