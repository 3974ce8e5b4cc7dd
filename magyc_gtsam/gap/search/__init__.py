"""The search: the next effect to add, its rivals, objections to it, and corrections by the posterior."""
