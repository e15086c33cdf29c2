"""Starts the node: camera and detector topics, parameters and the Fast DDS profile by argument."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the description."""
    share = Path(get_package_share_directory("elevator_rectify"))
    arguments = {
        "namespace": "",
        "image": "/camera/image",
        "camera_info": "/camera/camera_info",
        "detections": "/detections",
        "parameters": str(share / "config" / "elevator_rectify.yaml"),
        "fastdds_profile": str(share / "config" / "fastdds.xml"),
    }
    node = Node(
        package="elevator_rectify",
        executable="node",
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("parameters")],
        remappings=[
            ("image", LaunchConfiguration("image")),
            ("image/compressed", [LaunchConfiguration("image"), "/compressed"]),
            ("camera_info", LaunchConfiguration("camera_info")),
            ("detections", LaunchConfiguration("detections")),
        ],
        output="screen",
    )
    declared = [DeclareLaunchArgument(name, default_value=default) for name, default in arguments.items()]
    profile = SetEnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", LaunchConfiguration("fastdds_profile"))
    return LaunchDescription([*declared, profile, node])
