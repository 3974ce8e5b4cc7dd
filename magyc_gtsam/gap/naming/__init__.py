"""The effects that are named, by the posterior."""
