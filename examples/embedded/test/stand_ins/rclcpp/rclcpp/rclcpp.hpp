// Stand-in for rclcpp/rclcpp.hpp of ROS 2 Jazzy: signatures of what the example uses.
#pragma once
#include <functional>
#include <memory>
#include <string>

namespace rclcpp
{
class NodeOptions {};

class QoS {};
class SensorDataQoS : public QoS {};

template<typename MessageT>
class Publisher
{
public:
  using SharedPtr = std::shared_ptr<Publisher<MessageT>>;
  void publish(const MessageT & msg);
};

template<typename MessageT>
class Subscription
{
public:
  using SharedPtr = std::shared_ptr<Subscription<MessageT>>;
};

class Node
{
public:
  explicit Node(const std::string & node_name, const NodeOptions & options = NodeOptions());

  template<typename MessageT>
  std::shared_ptr<Publisher<MessageT>> create_publisher(const std::string & topic_name, const QoS & qos)
  {
    (void)topic_name, (void)qos;
    return std::make_shared<Publisher<MessageT>>();
  }

  template<typename MessageT, typename CallbackT>
  std::shared_ptr<Subscription<MessageT>> create_subscription(
    const std::string & topic_name, const QoS & qos, CallbackT && callback)
  {
    const std::function<void(const MessageT &)> called = callback;  // it takes such messages
    (void)topic_name, (void)qos;
    return std::make_shared<Subscription<MessageT>>();
  }
};
}  // namespace rclcpp
