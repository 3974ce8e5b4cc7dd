"""The leaderboard: calibration by every method on a public recording, judged on other recordings of the same unit."""
