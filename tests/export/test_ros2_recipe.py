"""The ROS 2 recipe: its node compiles against stand-ins, and publishes what the exported model says."""

import ctypes
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from split_cli.learning.training_set import write_set
from split_cli.workflows.export import export_set
from tests.factories import make_training_set

ROOT = Path(__file__).resolve().parents[2]
RECIPE = ROOT / "docs" / "ros2"

# What the node uses of ROS 2, no more: nodes register callbacks, spin() delivers the lines of stdin.
RCLCPP = r"""
#pragma once
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <ackermann_msgs/msg/ackermann_drive_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <std_msgs/msg/bool.hpp>
#include <std_msgs/msg/float64.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
namespace rclcpp {
inline void init(int, char **) {}
inline void shutdown() {}
inline std::map<std::string, std::function<void(const double *)>> & inputs() {
  static std::map<std::string, std::function<void(const double *)>> made;
  return made;
}
inline void show(const std::string & topic, const std_msgs::msg::Float64MultiArray & m) {
  std::printf("%s", topic.c_str());
  for (double v : m.data) std::printf(" %.17g", v);
  std::printf("\n");
}
inline void show(const std::string & topic, const std_msgs::msg::Bool & m) {
  std::printf("%s %d\n", topic.c_str(), m.data ? 1 : 0);
}
inline void fill(ackermann_msgs::msg::AckermannDriveStamped & m, const double * v) {
  m.drive.steering_angle = v[0];
}
inline void fill(std_msgs::msg::Float64 & m, const double * v) { m.data = v[0]; }
inline void fill(nav_msgs::msg::Odometry & m, const double * v) {
  m.pose.pose.position.x = v[0];
  m.pose.pose.position.y = v[1];
  m.pose.pose.orientation.z = v[2];
  m.pose.pose.orientation.w = v[3];
  m.twist.twist.linear.x = v[4];
  m.twist.twist.linear.y = v[5];
  m.twist.twist.angular.z = v[6];
}
template <typename T> struct Publisher {
  using SharedPtr = std::shared_ptr<Publisher<T>>;
  std::string topic;
  void publish(const T & message) { show(topic, message); }
};
template <typename T> struct Subscription { using SharedPtr = std::shared_ptr<Subscription<T>>; };
class Node {
 public:
  explicit Node(const std::string &) {}
  template <typename T> typename Publisher<T>::SharedPtr create_publisher(const std::string & topic, int) {
    auto made = std::make_shared<Publisher<T>>();
    made->topic = topic;
    return made;
  }
  template <typename T, typename F>
  typename Subscription<T>::SharedPtr create_subscription(const std::string & topic, int, F callback) {
    inputs()[topic] = [callback](const double * v) { T m; fill(m, v); callback(m); };
    return std::make_shared<Subscription<T>>();
  }
};
inline void spin(const std::shared_ptr<Node> &) {
  char topic[32];
  double v[7];
  while (std::scanf("%31s %lf %lf %lf %lf %lf %lf %lf", topic, v, v + 1, v + 2, v + 3, v + 4, v + 5, v + 6) == 8)
    inputs().at(topic)(v);
}
}  // namespace rclcpp
"""
MESSAGES = {
    "std_msgs/msg/bool.hpp": "struct Bool { bool data = false; };",
    "std_msgs/msg/float64.hpp": "struct Float64 { double data = 0; };",
    "std_msgs/msg/float64_multi_array.hpp": "struct Float64MultiArray { std::vector<double> data; };",
    "ackermann_msgs/msg/ackermann_drive_stamped.hpp": (
        "struct AckermannDrive { double steering_angle = 0; };struct AckermannDriveStamped { AckermannDrive drive; };"
    ),
    "nav_msgs/msg/odometry.hpp": (
        "struct V { double x = 0, y = 0, z = 0; }; struct Q { double x = 0, y = 0, z = 0, w = 1; };"
        "struct Pose { V position; Q orientation; }; struct PoseC { Pose pose; };"
        "struct Twist { V linear, angular; }; struct TwistC { Twist twist; };"
        "struct Odometry { PoseC pose; TwistC twist; };"
    ),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """Export a set named as in the recipe, and build the node and a library of the same C."""
    if not shutil.which("g++") or not shutil.which("gcc"):
        pytest.skip("no C++ compiler: apt-get install g++")
    folder = tmp_path_factory.mktemp("ros2")
    write_set(make_training_set(points=400), folder / "my_car.split")
    export_set(folder / "my_car.split", folder / "model", ["c"], queries=200)
    (folder / "rclcpp").mkdir()
    (folder / "rclcpp" / "rclcpp.hpp").write_text(RCLCPP)
    for name, body in MESSAGES.items():
        package = name.split("/")[0]
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        text = f"#pragma once\n#include <vector>\nnamespace {package}::msg {{ {body} }}\n"
        (folder / name).write_text(text)
    warnings = ["-Wall", "-Wextra", "-Werror"]
    model = folder / "model"

    def compiled(*words: str) -> None:
        done = subprocess.run([str(w) for w in words], capture_output=True, text=True, cwd=folder, timeout=120)
        assert done.returncode == 0, done.stderr

    compiled("gcc", "-std=c99", "-O1", "-fPIC", *warnings, "-c", model / "my_car.c", "-o", "my_car.o")
    includes = ["-I.", f"-I{model}"]
    compiled(
        "g++",
        "-std=c++17",
        "-O1",
        *warnings,
        *includes,
        RECIPE / "model_node.cpp",
        "my_car.o",
        "-lm",
        "-o",
        "model_node",
    )
    compiled("gcc", "-shared", "my_car.o", "-lm", "-o", "libmy_car.so")
    return folder / "model_node", folder / "libmy_car.so"


def test_the_node_publishes_what_the_exported_model_says(built):
    node, library = built
    yaw, steer, torque = 0.4, 0.03, 150.0
    odometry = (1.0, 2.0, math.sin(yaw / 2), math.cos(yaw / 2), 15.0, -0.1, 0.2)
    lines = [
        f"drive {steer} 0 0 0 0 0 0",
        f"torque {torque} 0 0 0 0 0 0",
        "odom " + " ".join(f"{value!r}" for value in odometry),
        "odom 0 0 0 1 15 3.5 0",  # sideways at 13 degrees: no state that was learned
    ]
    done = subprocess.run([str(node)], input="\n".join(lines), capture_output=True, text=True, timeout=60)
    told = [line.split() for line in done.stdout.splitlines()]
    assert [line[0] for line in told] == ["model/prediction", "model/valid"] * 2

    model = ctypes.CDLL(str(library))
    array = ctypes.c_double * 8
    after = array()
    model.my_car_step.argtypes = [array, ctypes.c_double * 2, ctypes.c_double, array]
    model.my_car_step(
        array(1.0, 2.0, yaw, 15.0, -0.1, 0.2, torque, steer), (ctypes.c_double * 2)(0.0, 0.0), 0.05, after
    )
    # The yaw goes through sine and cosine of its half.
    np.testing.assert_allclose([float(v) for v in told[0][1:]], list(after), rtol=1e-12, atol=1e-12)
    assert told[1][1] == "1" and told[3][1] == "0"


def test_the_recipe_names_what_is_there():
    page = (ROOT / "docs" / "ros2.md").read_text(encoding="utf-8")
    make = (RECIPE / "CMakeLists.txt").read_text(encoding="utf-8")
    node = (RECIPE / "model_node.cpp").read_text(encoding="utf-8")
    for package in re.findall(r"#include <(\w+)/", node):
        assert f"find_package({package} REQUIRED)" in make
        assert f"<depend>{package}</depend>" in (RECIPE / "package.xml").read_text(encoding="utf-8")
    for topic in ("odom", "drive", "torque"):
        assert f'"{topic}"' in node and f"{topic}:=/{topic}" in page
