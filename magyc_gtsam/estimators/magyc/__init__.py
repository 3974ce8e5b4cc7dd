"""The methods of the MAGYC paper, batch and incremental."""
