"""Starts the node: topics, every parameter and the Fast DDS profile are arguments (`--show-args` lists them)."""

from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node

from elevator_rectify.ros.documentation import parameter_descriptions
from launch import LaunchContext, LaunchDescription

TOPICS = {
    "image": ("/camera/image_raw", "topic of the image; with image_transport:=compressed, without /compressed"),
    "camera_info": ("/camera/camera_info", "topic of the camera's calibration"),
    "detections": ("/detections", "topic of the button detections"),
    "depth": ("/camera/aligned_depth_to_color/image_raw", "topic of the aligned depth image, with use_depth:=true"),
}


def node_of(context: LaunchContext) -> list[Node]:
    """Return the node with those parameters that were given as arguments, over those of the file."""
    given = {name: context.launch_configurations[name] for name in parameter_descriptions()}
    chosen = {name: yaml.safe_load(text) for name, text in given.items() if text != ""}
    topics = {name: context.launch_configurations[name] for name in TOPICS}
    return [
        Node(
            package="elevator_rectify",
            executable=context.launch_configurations["executable"],
            name="elevator_rectify",
            namespace=context.launch_configurations["namespace"],
            parameters=[context.launch_configurations["parameters"], chosen],
            remappings=[*topics.items(), ("image/compressed", topics["image"] + "/compressed")],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the description."""
    share = Path(get_package_share_directory("elevator_rectify"))
    files = {
        "executable": ("node", "node, or lifecycle_node for the managed node"),
        "namespace": ("", "namespace of the node, and of the panel's frame on /tf"),
        "parameters": (str(share / "config" / "elevator_rectify.yaml"), "file of the parameters"),
        "fastdds_profile": (str(share / "config" / "fastdds.xml"), "Fast DDS profile with room for whole images"),
        "rviz_frame": ("", "start RViz with this fixed frame: the camera's optical frame, as in the image's header"),
    }
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in {**files, **TOPICS}.items()
    ]
    declared += [
        DeclareLaunchArgument(name, default_value="", description=meaning)
        for name, meaning in parameter_descriptions().items()
    ]
    profile = SetEnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", LaunchConfiguration("fastdds_profile"))
    frame = LaunchConfiguration("rviz_frame")
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", str(share / "config" / "elevator_rectify.rviz"), "-f", frame],
        condition=IfCondition(PythonExpression(["'", frame, "' != ''"])),
    )
    return LaunchDescription([*declared, profile, OpaqueFunction(function=node_of), rviz])
