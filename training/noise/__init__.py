"""Training and assessment of learned noise models.

- corpus: recordings of many sensors on the rig to train and test on.
- networks: the networks in torch and their likelihood.
- train: train one network on a recording (`sonar-gym train-noise`).
- make: make the shipped models (`sonar-gym make-noise`).
- card: scores and model card of a trained model.
- baselines: Gaussian, empirical and physical models to compare with.
- compare: scores of models on other recordings (`sonar-gym compare-noise`).
- experiments: gain of memory; credence learned from recent readings.
- findings: results of the report, checked against targets.
- report: the report on all noise models (`sonar-gym noise-report`).
"""
