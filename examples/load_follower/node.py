"""The ROS 2 node around `follower.LoadFollower`: messages in, messages out, nothing computed here."""

from __future__ import annotations

import rclpy
from follower import LoadFollower, Odometry, quaternion_zw
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tf2_ros import TransformBroadcaster

from calib.runtime import Odometer

#: parameters of the node with their defaults
PARAMETERS = {
    "coefficients": "coefficients.json",
    "left_joint": "left_wheel_joint",
    "right_joint": "right_wheel_joint",
    "odom_frame_id": "odom",
    "base_frame_id": "base_link",
    "publish_tf": False,
    "settling_s": 1.0,
    "load_timeout_s": 2.0,
    "give_up_s": 1.0,
}
WARN_EVERY_S = 2.0
NANOSECONDS = 1e-9


class LoadFollowerNode(Node):
    """Subscribe ``wheel_loads`` and ``joint_states``; publish ``odom``, ``wheel_radii`` and the transform."""

    def __init__(self) -> None:
        super().__init__("load_follower")
        for name, default in PARAMETERS.items():
            self.declare_parameter(name, default)
        self._follower = LoadFollower(
            Odometer.from_file(self._value("coefficients")),
            settling_s=self._value("settling_s"),
            load_timeout_s=self._value("load_timeout_s"),
            give_up_s=self._value("give_up_s"),
        )
        self._joints = (self._value("left_joint"), self._value("right_joint"))
        self._odom = self.create_publisher(OdometryMessage, "odom", 10)
        self._radii = self.create_publisher(Float64MultiArray, "wheel_radii", 10)
        self._transforms = TransformBroadcaster(self) if self._value("publish_tf") else None
        self.create_subscription(Float64MultiArray, "wheel_loads", self._on_loads, 10)
        self.create_subscription(JointState, "joint_states", self._on_joints, 50)

    def _value(self, name: str):
        return self.get_parameter(name).value

    def _on_loads(self, message: Float64MultiArray) -> None:
        if len(message.data) != 2:
            self._warn(f"wheel_loads: found {len(message.data)} numbers; expected left and right in N")
            return
        left, right = message.data
        # the message has no stamp: the time of its arrival counts
        status = self._follower.feed_loads(left, right, self.get_clock().now().nanoseconds * NANOSECONDS)
        if status:
            self._warn(f"loads {left:.1f} N and {right:.1f} N refused: {status.name}")

    def _on_joints(self, message: JointState) -> None:
        t_s = message.header.stamp.sec + message.header.stamp.nanosec * NANOSECONDS
        odometry = self._follower.feed_joints(message.name, message.position, self._joints, t_s)
        if odometry is None:
            if self._follower.status:
                self._warn(f"no odometry: {self._follower.status.name}")
            return
        if odometry.loads_are_old:
            self._warn("no wheel loads for too long: the last ones hold on")
        self._publish(odometry, message.header.stamp)

    def _publish(self, odometry: Odometry, stamp) -> None:
        z, w = quaternion_zw(odometry.yaw_rad)
        message = OdometryMessage()
        message.header.stamp = stamp
        message.header.frame_id, message.child_frame_id = self._value("odom_frame_id"), self._value("base_frame_id")
        message.pose.pose.position.x, message.pose.pose.position.y = odometry.x_m, odometry.y_m
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = z, w
        message.pose.covariance = odometry.pose_covariance
        message.twist.twist.linear.x, message.twist.twist.angular.z = odometry.speed_mps, odometry.yaw_rate_radps
        message.twist.covariance = odometry.twist_covariance
        self._odom.publish(message)
        self._radii.publish(Float64MultiArray(data=odometry.radii_m))
        if self._transforms is not None:
            transform = TransformStamped()
            transform.header, transform.child_frame_id = message.header, message.child_frame_id
            transform.transform.translation.x, transform.transform.translation.y = odometry.x_m, odometry.y_m
            transform.transform.rotation.z, transform.transform.rotation.w = z, w
            self._transforms.sendTransform(transform)

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=WARN_EVERY_S)


def main() -> None:
    """Run the node until it is told to stop."""
    rclpy.init()
    node = LoadFollowerNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
