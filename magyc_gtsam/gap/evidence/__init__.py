"""What is missing in a model, by evidence: the probability of every set of effects."""
