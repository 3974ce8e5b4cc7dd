"""The numeric core: field chains, and the gyroscope that links their windows; needs only numpy and scipy."""
