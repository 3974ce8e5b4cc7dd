"""Methods that estimate the hard iron alone, from the rotation of the sensor."""
