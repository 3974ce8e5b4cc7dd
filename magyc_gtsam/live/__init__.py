"""Live sources of samples behind one interface: growing files, pipes, sockets, serial ports, MAVLink and ROS 2."""
