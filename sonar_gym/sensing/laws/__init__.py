"""Compiled sampling of sonar models: the readings of many paths in a few calls, without an object for each law.

numbers: counter-based random numbers and the normal distribution. dense: layers of networks, many pings at once.
mixture: the outputs of a network as a law. perceptron, recurrent: the learned models. normal: ideal and Gaussian
sonars. choose: which of these a model has; any other model is sampled by its `EchoLaw`.
"""
