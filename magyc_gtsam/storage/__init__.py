"""Files that the package writes and reads back: in one step, within limits, known again by their checksum."""
