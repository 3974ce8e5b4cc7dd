"""The field smoother, the default method: from a recording to the lowest minimum of its field chain."""
