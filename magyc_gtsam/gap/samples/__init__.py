"""Effects on single samples, detected in the innovations sample by sample."""
