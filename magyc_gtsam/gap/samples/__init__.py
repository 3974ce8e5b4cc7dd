"""Effects on single samples, found in the innovations sample by sample."""
