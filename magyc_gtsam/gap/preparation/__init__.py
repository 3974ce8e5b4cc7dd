"""What is put in order before anything is estimated: channels, clocks, axes, and sensors that are cut off."""
