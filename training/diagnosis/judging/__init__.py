"""How well the diagnosis does on labelled trials, and the fit of its decision model.

command: `sonar-gym judge`, trials and hard cases to a page with targets.
fit_command: `sonar-gym fit-decision`, trials to the weights of the decision model with their card.
tasks, record: what is diagnosed, and what is written down of it.
real: real recordings whose halves must agree, and changes planted in one half.
scoring, rows, page: from records to the table of targets.
decision_fit: the logistic regression and its reliability on families that were left out.
"""
