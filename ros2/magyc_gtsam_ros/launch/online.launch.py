"""ros2 launch magyc_gtsam_ros online.launch.py mag:=/sensors/mag imu:=/sensors/imu state:=/var/lib/compass.state"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "mag": ("imu/mag", "sensor_msgs/MagneticField, tesla"),
    "imu": ("imu/data_raw", "sensor_msgs/Imu"),
    "output": ("calibration.yaml", "file of the calibration"),
    "state": ("", "file to go on from after a restart; none if empty"),
    "method": ("smoother", "smoother or magyc-ifg"),
    "every": ("10.0", "s between two looks at the estimate"),
}


def generate_launch_description() -> LaunchDescription:
    """The node with its topics and files as arguments."""
    declared = [DeclareLaunchArgument(k, default_value=v, description=text) for k, (v, text) in ARGUMENTS.items()]
    node = Node(
        package="magyc_gtsam_ros",
        executable="online",
        output="screen",
        parameters=[{name: LaunchConfiguration(name) for name in ("output", "state", "method", "every")}],
        remappings=[("imu/mag", LaunchConfiguration("mag")), ("imu/data_raw", LaunchConfiguration("imu"))],
    )
    return LaunchDescription([*declared, node])
