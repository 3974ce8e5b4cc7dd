"""The report of a calibration as one self-contained HTML page."""
