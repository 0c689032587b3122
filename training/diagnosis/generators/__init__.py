"""Generators of labelled trials: pairs of a simulation and a recording whose true difference is known.

Seven families produce readings by different means (waveforms, rays, a four-part beam model, a driving robot, a ruler,
a fixed target, fast bursts). None of them shares code with the laws and effects that a diagnosis fits.

ensemble: `make_trial`, `FAMILIES`, `ALL_KINDS`, `catalogue_of`.
trial: the trial, its true causes, and both as files.
world: a sonar with its register and link; causes planted in it; faults of the link.
surveys: conditions, order and times of a survey with visits.
grammar: unmodelled faults, composed at random.
rig, rig_causes, rays, beam, driving, ruler, fixed, bursts: the families.
hard: builders of the cases that are known to be hard.
command: writes N labelled pairs.
"""
