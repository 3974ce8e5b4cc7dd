"""The leaderboard: every method calibrates on one public recording and is judged on others of the same unit."""
