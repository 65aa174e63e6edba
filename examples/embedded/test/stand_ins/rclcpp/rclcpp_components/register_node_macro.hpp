// Stand-in for rclcpp_components/register_node_macro.hpp of ROS 2 Jazzy: the class takes node options.
#pragma once
#include <rclcpp/rclcpp.hpp>

#define RCLCPP_COMPONENTS_REGISTER_NODE(NodeClass) \
  rclcpp::Node * registered_node(const rclcpp::NodeOptions & options); \
  rclcpp::Node * registered_node(const rclcpp::NodeOptions & options) {return new NodeClass(options);}
