"""Score tests of the candidate effects and the generic families, and their distribution without any effect."""
