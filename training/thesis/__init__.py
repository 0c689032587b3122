"""The training experiment of the thesis (Esmi 2016), repeated on recordings of the rig.

- `data`: recordings as inputs and labels of the thesis; the results that it prints
- `networks`: MLP and LSTM on a flat weight vector
- `online`: compiled training with one step per ping
- `fit`: optimisers, settings and training of one network
- `surfaces`: credence surfaces of readings and of networks
- `experiment`: the networks of the comparison, their training, tests of the thesis's claims
- `compare_optimizers`: command, tables and figures of the comparison of optimisers
- `rig`: the rig compared with the sonar of the thesis
- `compare_thesis`: command, tables and figure of that comparison
"""
