"""Files around an exported model for frameworks that run elsewhere: an AcadosModel and a node of ROS 2."""

from __future__ import annotations

from bcid.export.exported import Exported

_ACADOS = '''\
"""{about}

An AcadosModel of the discrete step, for optimal control with acados (acados_template) around {name}_casadi.py.
"""

import casadi as ca
from acados_template import AcadosModel

from {name}_casadi import COMMANDS, PERIOD_S, STATES, step


def make_model():
    """The model; give an AcadosOcp `solver_options.integrator_type = "DISCRETE"` and shooting intervals of PERIOD_S."""
    x, u = ca.{symbol}.sym("x", len(STATES)), ca.{symbol}.sym("u", len(COMMANDS))
    model = AcadosModel()
    model.name = "{name}"
    model.x, model.u = x, u
    model.disc_dyn_expr = step(x, u)[0]
    model.x_labels, model.u_labels = list(STATES), list(COMMANDS)
    return model


def horizon_s(steps):
    """The time (s) of a horizon of so many shooting intervals."""
    return steps * PERIOD_S
'''

_ACADOS_TEST = '''\
"""Runs {name}_acados.py with a stand-in for acados_template, and compares its step with that of {name}_casadi.py."""

import sys
import types

import casadi as ca

stand_in = types.ModuleType("acados_template")
stand_in.AcadosModel = type("AcadosModel", (), {{}})
sys.modules["acados_template"] = stand_in

from {name}_acados import make_model  # noqa: E402
from {name}_casadi import step  # noqa: E402

model = make_model()
dynamics = ca.Function("dynamics", [model.x, model.u], [model.disc_dyn_expr])
worst = 0.0
for k in range(20):
    x, u = ca.DM([0.1 + 0.01 * (k + i) for i in range(model.x.size1())]), ca.DM([0.02 * k - 0.2, 0.05 * k])
    worst = max(worst, float(ca.mmax(ca.fabs(dynamics(x, u) - step(x, u)[0]))))
print(f"{{worst:.3e}}")
sys.exit(0 if worst <= {tolerance!r} else 1)
'''

_ROS = '''\
"""{about}

A node of ROS 2 (rclpy) that drives the model: it takes commands from the topic `command` (std_msgs/Float64MultiArray:
steering in rad, throttle), and publishes pose and twist as `odom` (nav_msgs/Odometry) every {period:g} s.

    python3 {name}_node.py
"""

import math

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from {name} import PERIOD_S, init, move, step


class VehicleNode(Node):
    """The vehicle at rest where the parameters say, then driven by the latest command."""

    def __init__(self):
        super().__init__("{name}")
        start = [self.declare_parameter(key, 0.0).value for key in ("x", "y", "yaw")]
        self.frame = self.declare_parameter("frame", "map").value
        self.child = self.declare_parameter("child_frame", "base_link").value
        self.pose, self.twist, self.command = start, [0.0, 0.0, 0.0], [0.0, 0.0]
        self.state = init(self.pose, self.twist, 0.0)
        self.publisher = self.create_publisher(Odometry, "odom", 10)
        self.create_subscription(Float64MultiArray, "command", self.take_command, 10)
        self.create_timer(PERIOD_S, self.advance)

    def take_command(self, message):
        """Hold a command until the next; one that is not two finite numbers is left."""
        numbers = list(message.data)
        if len(numbers) == 2 and all(map(math.isfinite, numbers)):
            self.command = numbers

    def advance(self):
        """One period, and its end published."""
        before = self.twist
        self.state, self.twist = step(self.state, self.command)
        self.pose = move(self.pose, before, self.twist)
        self.publisher.publish(self.odometry())

    def odometry(self):
        """Pose and twist as a message."""
        message = Odometry()
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = self.frame, self.child
        position, orientation = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y = self.pose[0], self.pose[1]
        orientation.z, orientation.w = math.sin(0.5 * self.pose[2]), math.cos(0.5 * self.pose[2])
        message.twist.twist.linear.x, message.twist.twist.linear.y = self.twist[0], self.twist[1]
        message.twist.twist.angular.z = self.twist[2]
        return message


def main():
    """Run until it is told to end."""
    rclpy.init()
    node = VehicleNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()


if __name__ == "__main__":
    main()
'''


def write_acados_files(e: Exported) -> dict[str, str]:
    """NAME_acados.py, which needs NAME_casadi.py beside it, and NAME_acados_test.py."""
    symbol = "MX" if e.formulas.networks else "SX"
    return {
        f"{e.name}_acados.py": _ACADOS.format(about=e.about, name=e.name, symbol=symbol),
        f"{e.name}_acados_test.py": _ACADOS_TEST.format(name=e.name, tolerance=e.vectors.tolerance),
    }


def write_ros_node(e: Exported) -> dict[str, str]:
    """NAME_node.py, which needs NAME.py beside it."""
    return {f"{e.name}_node.py": _ROS.format(about=e.about, name=e.name, period=e.formulas.period_s)}
