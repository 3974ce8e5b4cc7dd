"""Methods that estimate the hard iron alone, from the turning of the sensor."""
