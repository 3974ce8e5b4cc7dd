"""Which effect is added next, what it cannot be told from, what speaks against it, and what the posterior changes."""
