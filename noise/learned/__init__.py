"""Learned models of a sonar.

inputs: features of a ping and the learned ranges. mixture: the law that a network's outputs define. networks: the
perceptron. recurrent: the LSTM; recurrent_state: its state and history features; recurrent_file: its model.json.
recent: credence given the last readings. tensors: weights on disk. thesis: the published networks of the thesis.
"""
