"""The method of the Autocal paper, for magnetometers and accelerometers."""
