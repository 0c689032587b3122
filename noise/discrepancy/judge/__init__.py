"""Judgement: shares of the misfit, probabilities of causes, and the verdict."""
