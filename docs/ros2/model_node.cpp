// A node that predicts the car 50 ms ahead with an exported model, and says where the model is not to be trusted.
#include <array>
#include <cmath>
#include <memory>

#include <ackermann_msgs/msg/ackermann_drive_stamped.hpp>
#include <nav_msgs/msg/odometry.hpp>
#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/bool.hpp>
#include <std_msgs/msg/float64.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>

#include "my_car.h"  // split export my_car.split --target c

class ModelNode : public rclcpp::Node {
 public:
  ModelNode() : rclcpp::Node("split_model") {
    prediction_ = create_publisher<std_msgs::msg::Float64MultiArray>("model/prediction", 10);
    valid_ = create_publisher<std_msgs::msg::Bool>("model/valid", 10);
    steering_ = create_subscription<ackermann_msgs::msg::AckermannDriveStamped>(
        "drive", 10, [this](const ackermann_msgs::msg::AckermannDriveStamped & message) {
          delta_ = message.drive.steering_angle;
        });
    torque_ = create_subscription<std_msgs::msg::Float64>(
        "torque", 10, [this](const std_msgs::msg::Float64 & message) { total_torque_ = message.data; });
    odometry_ = create_subscription<nav_msgs::msg::Odometry>(
        "odom", 10, [this](const nav_msgs::msg::Odometry & message) { predict(message); });
  }

 private:
  // The twist of nav_msgs is in the child frame: base_link must be at the centre of gravity, x forward, y left.
  void predict(const nav_msgs::msg::Odometry & odometry) {
    const auto & position = odometry.pose.pose.position;
    const auto & q = odometry.pose.pose.orientation;
    const double yaw = std::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
    const auto & twist = odometry.twist.twist;
    std::array<double, MY_CAR_STATES> state = {
        position.x, position.y, yaw, twist.linear.x, twist.linear.y, twist.angular.z, total_torque_, delta_};
    my_car_start(state.data());  // states of lags, where the model has any: settled
    const std::array<double, MY_CAR_INPUTS> input = {0.0, 0.0};  // commands held, until the next ones come
    std::array<double, MY_CAR_STATES> next{};
    my_car_step(state.data(), input.data(), kAhead, next.data());

    std_msgs::msg::Float64MultiArray prediction;
    prediction.data.assign(next.begin(), next.end());
    prediction_->publish(prediction);

    std_msgs::msg::Bool valid;
    valid.data = my_car_valid_state(state.data(), input.data()) == 1;
    valid_->publish(valid);
  }

  static constexpr double kAhead = 0.05;  // [s]
  double total_torque_ = 0.0;             // [N m] at the wheels, driving positive
  double delta_ = 0.0;                    // [rad] at the road wheels, left positive
  rclcpp::Publisher<std_msgs::msg::Float64MultiArray>::SharedPtr prediction_;
  rclcpp::Publisher<std_msgs::msg::Bool>::SharedPtr valid_;
  rclcpp::Subscription<ackermann_msgs::msg::AckermannDriveStamped>::SharedPtr steering_;
  rclcpp::Subscription<std_msgs::msg::Float64>::SharedPtr torque_;
  rclcpp::Subscription<nav_msgs::msg::Odometry>::SharedPtr odometry_;
};

int main(int argc, char ** argv) {
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<ModelNode>());
  rclcpp::shutdown();
  return 0;
}
