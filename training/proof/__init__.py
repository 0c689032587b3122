"""The proof: blind trials of the diagnosis on concealed effects, in a ledger that anybody can verify.

chain: the ledger, an append-only hash chain of JSON lines.
sealing: authenticated encryption of answers, with a commitment to the key.
secret: what fixes family, kind, seed and key of each trial once a deck is announced.
deck: what is planned, and the hashes of the code that does it.
run: `sonar-gym prove`.
work: what worker processes do: diagnose two files in an empty folder, score a disclosed trial.
diagnosing: the program that sees two files and nothing else.
ledger: from the lines of a ledger to records that `training.diagnosis.judging` scores.
verify: `sonar-gym verify-proof`.
baselines: other methods on the same trials.
real: real recordings with one fact hidden.
page: the page with its table and figures.
"""
