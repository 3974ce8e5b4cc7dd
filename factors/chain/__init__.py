"""The numeric core: field chains, and the gyroscope that links their windows. Needs numpy and scipy only."""
