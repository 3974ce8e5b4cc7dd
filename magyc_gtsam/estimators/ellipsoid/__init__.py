"""Methods that need the magnetometer alone: ellipsoid fits and the classic algorithms of the review."""
