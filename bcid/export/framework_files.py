"""Files around an exported model for frameworks that run elsewhere: an AcadosModel and a node of ROS 2."""

from __future__ import annotations

from bcid.export.exported import Exported
from bcid.export.reference_drive import EXACT

_ACADOS = '''\
"""{about}

An AcadosModel of the discrete step, for optimal control with acados (acados_template) around {name}_casadi.py.
"""

import casadi as ca
from acados_template import AcadosModel

from {name}_casadi import COMMANDS, PERIOD_S, STATES, move, step

SEEN = ("seen_p_x", "seen_p_y", "seen_theta", "seen_v_x", "seen_v_y", "seen_yaw_rate")


def make_model(with_pose=False):
    """The model; give an AcadosOcp `solver_options.integrator_type = "DISCRETE"` and shooting intervals of PERIOD_S.

    If `with_pose`, pose and twist of the {point}, SEEN, stand in x behind the model's own state: for costs and
    constraints.  They begin with those that `init` of {name}_casadi.py is given.
    """
    x, u = ca.{symbol}.sym("x", len(STATES)), ca.{symbol}.sym("u", len(COMMANDS))
    x_next, twist_next = step(x, u)
    labels = list(STATES)
    if with_pose:
        pose, twist = ca.{symbol}.sym("pose", 3), ca.{symbol}.sym("twist", 3)
        x_next = ca.vertcat(x_next, move(pose, twist, twist_next), twist_next)
        x = ca.vertcat(x, pose, twist)
        labels += SEEN
    model = AcadosModel()
    model.name = "{name}"
    model.x, model.u = x, u
    model.disc_dyn_expr = x_next
    model.x_labels, model.u_labels = labels, list(COMMANDS)
    return model


def horizon_s(steps):
    """The time (s) of a horizon of so many shooting intervals."""
    return steps * PERIOD_S
'''

_ACADOS_TEST = '''\
"""Runs {name}_acados.py with a stand-in for acados_template, over the drive of {name}_casadi_test.py."""

import sys
import types

import casadi as ca

stand_in = types.ModuleType("acados_template")
stand_in.AcadosModel = type("AcadosModel", (), {{}})
sys.modules["acados_template"] = stand_in

import {name}_casadi_test as drive  # noqa: E402
from {name}_acados import make_model  # noqa: E402

models = [make_model(), make_model(with_pose=True)]
alone, dynamics = (ca.Function("dynamics", [model.x, model.u], [model.disc_dyn_expr]) for model in models)
own = models[0].x.size1()
pose, twist, _, x = drive.STARTS[0]
x = ca.vertcat(*x, *pose, *twist)
worst = unlike = 0.0
for k, (u, expected) in enumerate(zip(drive.COMMANDS, drive.TWISTS)):
    {restart}after = alone(x[:own], u)
    x = dynamics(x, u)
    unlike = max(unlike, drive.compare(drive.numbers(after), drive.numbers(x[:own]), drive.SCALES))
    worst = max(worst, drive.compare(drive.numbers(x[own + 3 :]), expected))
off = drive.compare(drive.numbers(x[own : own + 3]), drive.END_POSE)
print(f"{{worst:.3e}}")
failed = not (worst <= {tolerance!r} and off <= {pose_tolerance!r} and unlike == 0.0)
if failed:
    print(f"twists are off by {{worst:.3e}}, the pose by {{off:.3e}}, states by {{unlike:.3e}}", file=sys.stderr)
sys.exit(1 if failed else 0)
'''

_ROS = '''\
"""{about}

A node of ROS 2 (rclpy) that drives the model: it takes commands from the topic `command` (std_msgs/Float64MultiArray:
steering in rad, throttle, see {name}.py), and publishes pose and twist of the {point} as `odom`
(nav_msgs/Odometry) every {period:g} s.

    python3 {name}_node.py
"""

import math

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
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
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
'''


def write_acados_files(e: Exported) -> dict[str, str]:
    """NAME_acados.py, which needs NAME_casadi.py beside it, and NAME_acados_test.py."""
    symbol, v = "MX" if e.formulas.networks else "SX", e.vectors
    # errors of a network's poses are those of its twists, over the whole drive
    pose_tolerance = EXACT if v.states is None else v.tolerance * max(1.0, len(v.commands) * e.formulas.period_s) ** 2
    test = _ACADOS_TEST.format(
        name=e.name, tolerance=v.tolerance, pose_tolerance=pose_tolerance,
        restart="" if v.states is None else "x[:own] = drive.STATES[k]\n    ",
    )  # fmt: skip
    return {
        f"{e.name}_acados.py": _ACADOS.format(about=e.about, name=e.name, symbol=symbol, point=e.point),
        f"{e.name}_acados_test.py": test,
    }


def write_ros_node(e: Exported) -> dict[str, str]:
    """NAME_node.py, which needs NAME.py beside it."""
    text = _ROS.format(about=e.about, name=e.name, period=e.formulas.period_s, point=e.point)
    return {f"{e.name}_node.py": text}
