"""Extra effects on the readings of a sensor, as they enter a model, a correction of data and a graph."""
