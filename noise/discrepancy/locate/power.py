def could_have_seen(law, sample, tested, rng): return ()
