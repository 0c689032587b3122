"""The networks of Esmi (2016), "the thesis", trained again on recordings of this project.

data: recordings scaled as in the thesis; the results that it printed.
networks: its MLP and LSTM as functions of a flat parameter vector.
online: compiled training with one step per ping.
fit: optimisers and training, online or in mini-batches.
surfaces: credence surfaces and distances of silent pings.
experiment: comparison of optimisers: jobs, stored results, tests of claims.
rig: the simulated rig tuned to and compared with the thesis's sonar.
compare_optimizers: command `compare-optimizers`, its tables and figures.
compare_thesis: command `compare-thesis`, its tables and figure.
"""
