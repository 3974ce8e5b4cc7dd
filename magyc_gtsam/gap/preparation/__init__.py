"""Corrections before the estimation: pauses of channels, clocks of held samples, the order of the axes."""
