// A component of ROS 2: the observer `isolating` on imu/data, without Python.
//
// Subscribes imu/data and torque/command, publishes imu/corrected and fault/estimate, as the node
// fault_observer of quadftc_fdi does.
#include <cstdint>

#include <geometry_msgs/msg/vector3_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_components/register_node_macro.hpp>
#include <sensor_msgs/msg/imu.hpp>

#include "isolating/isolating.h"
#include "isolating/isolating_numbers.h"

namespace quadftc
{

class Observer : public rclcpp::Node
{
public:
  explicit Observer(const rclcpp::NodeOptions & options)
  : Node("fault_observer", options)
  {
    corrected_ = create_publisher<sensor_msgs::msg::Imu>("imu/corrected", rclcpp::SensorDataQoS());
    estimate_ = create_publisher<geometry_msgs::msg::Vector3Stamped>("fault/estimate", rclcpp::SensorDataQoS());
    torque_ = create_subscription<geometry_msgs::msg::Vector3Stamped>(
      "torque/command", rclcpp::SensorDataQoS(),
      [this](const geometry_msgs::msg::Vector3Stamped & torque) {note_torque(torque);});
    imu_ = create_subscription<sensor_msgs::msg::Imu>(
      "imu/data", rclcpp::SensorDataQoS(), [this](const sensor_msgs::msg::Imu & imu) {diagnose(imu);});
  }

private:
  static constexpr std::int64_t LONGEST_GAP = 1'000'000'000;  // ns; after a longer one it begins anew
  static constexpr double ABSENT = -1.0;  // element 0 of a covariance (REP-145)

  void note_torque(const geometry_msgs::msg::Vector3Stamped & torque)
  {
    in_.torque[0] = torque.vector.x;
    in_.torque[1] = torque.vector.y;
    in_.torque[2] = torque.vector.z;
    in_.driven = true;
  }

  void diagnose(const sensor_msgs::msg::Imu & imu)
  {
    const std::int64_t stamp = imu.header.stamp.sec * INT64_C(1000000000) + imu.header.stamp.nanosec;
    const std::int64_t elapsed = stamp - last_;
    const bool begins = last_ == 0 || elapsed > LONGEST_GAP || elapsed < -LONGEST_GAP;
    if (!begins && elapsed <= 0) {  // the stamp repeats or went back
      return;
    }
    take_sample(imu);
    const double dt = begins ? 0.0 : 1e-9 * static_cast<double>(elapsed);
    if (begins) {
      isolating_init(&isolating_default, &in_, &states_[before_]);
    }
    isolating_step(&isolating_default, &states_[before_], &in_, &dt, &states_[!before_], &out_);
    before_ = !before_;
    last_ = stamp;
    publish(imu);
  }

  void take_sample(const sensor_msgs::msg::Imu & imu)
  {
    in_.sample = {
      {imu.orientation.x, imu.orientation.y, imu.orientation.z, imu.orientation.w},
      {imu.angular_velocity.x, imu.angular_velocity.y, imu.angular_velocity.z},
      {imu.linear_acceleration.x, imu.linear_acceleration.y, imu.linear_acceleration.z},
      imu.orientation_covariance[0] != ABSENT,
      imu.angular_velocity_covariance[0] != ABSENT,
      imu.linear_acceleration_covariance[0] != ABSENT};
  }

  void publish(const sensor_msgs::msg::Imu & imu)
  {
    const auto & said = out_.said;
    sensor_msgs::msg::Imu corrected = imu;
    corrected.orientation.x = said.corrected.q_xyzw[0];
    corrected.orientation.y = said.corrected.q_xyzw[1];
    corrected.orientation.z = said.corrected.q_xyzw[2];
    corrected.orientation.w = said.corrected.q_xyzw[3];
    corrected.angular_velocity.x = said.corrected.body_rate[0];
    corrected.angular_velocity.y = said.corrected.body_rate[1];
    corrected.angular_velocity.z = said.corrected.body_rate[2];
    corrected.orientation_covariance[0] = said.corrected.attitude_valid ? 0.0 : ABSENT;
    corrected.angular_velocity_covariance[0] = said.corrected.rate_valid ? 0.0 : ABSENT;
    corrected_->publish(corrected);
    geometry_msgs::msg::Vector3Stamped estimate;
    estimate.header = imu.header;
    estimate.vector.x = said.fault[0];
    estimate.vector.y = said.fault[1];
    estimate.vector.z = said.fault[2];
    estimate_->publish(estimate);
  }

  rclcpp::Publisher<sensor_msgs::msg::Imu>::SharedPtr corrected_;
  rclcpp::Publisher<geometry_msgs::msg::Vector3Stamped>::SharedPtr estimate_;
  rclcpp::Subscription<geometry_msgs::msg::Vector3Stamped>::SharedPtr torque_;
  rclcpp::Subscription<sensor_msgs::msg::Imu>::SharedPtr imu_;
  isolating_guarded_state states_[2]{};  // before and after a step, in turn
  isolating_observation_inputs in_{};
  isolating_guarded_output out_{};
  int before_{0};
  std::int64_t last_{0};  // stamp of the last sample [ns]; 0: there was none
};

}  // namespace quadftc

RCLCPP_COMPONENTS_REGISTER_NODE(quadftc::Observer)
