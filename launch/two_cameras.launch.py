"""Two cameras, two nodes with a namespace each: an example to copy, with the topics of two RealSense cameras."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchDescription

# Namespace of a node, and of its outputs (/left/elevator_rectify/panel_pose, ...): that of the camera's topics.
CAMERAS = {"left": "/left/camera", "right": "/right/camera"}


def generate_launch_description() -> LaunchDescription:
    """Return the description."""
    one = str(Path(get_package_share_directory("elevator_rectify")) / "launch" / "elevator_rectify.launch.py")
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(one),
                launch_arguments={
                    "namespace": namespace,
                    "image": f"{camera}/color/image_raw",
                    "camera_info": f"{camera}/color/camera_info",
                    "depth": f"{camera}/aligned_depth_to_color/image_raw",
                    "detections": f"/{namespace}/detections",
                }.items(),
            )
            for namespace, camera in CAMERAS.items()
        ]
    )
