"""Samples that are still coming: growing files, pipes, sockets, ports, MAVLink and ROS 2 behind one interface."""
