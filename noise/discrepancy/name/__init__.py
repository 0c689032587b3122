"""Which effects explain the difference: cross-fitted selection, pairs, alternatives, intervals."""
