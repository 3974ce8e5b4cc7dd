"""The leaderboard: calibrate by every method on a public recording, and judge it on others of the same unit."""
