"""The posterior probability of every set of effects, from its evidence."""
