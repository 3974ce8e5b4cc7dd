"""Extra effects: what each adds to a reading, in a model, in data and in a graph."""
