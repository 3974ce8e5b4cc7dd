"""Files that the package writes and reads back: atomic writes, reads with size limits, and checksums."""
