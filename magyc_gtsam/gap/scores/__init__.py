"""Score tests: what each candidate and each family without a name would explain, and what chance would."""
