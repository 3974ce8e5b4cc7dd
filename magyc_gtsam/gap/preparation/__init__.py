"""Checks and corrections before the estimation: channels, clocks, axes and clipped sensors."""
