"""magyc-gtsam as a ROS 2 node."""
