// The learned step controller as a controller of ros2_control. NOT TESTED: no ROS 2 was available when it was written.
#pragma once

#include <string>
#include <vector>

#include "controller.h"
#include "controller_interface/controller_interface.hpp"

namespace stepgap_example {

// Reads the state at the last section from state interfaces, and writes the command of the next step to command
// interfaces, once per step: when the interface `step` has a new number. Parameters are the names of all interfaces and
// the target. What is between two sections, the control of legs and joints, is another controller's task.
class StepController : public controller_interface::ControllerInterface {
public:
    controller_interface::CallbackReturn on_init() override;
    controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State &previous) override;
    controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &previous) override;
    controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State &previous) override;
    controller_interface::InterfaceConfiguration command_interface_configuration() const override;
    controller_interface::InterfaceConfiguration state_interface_configuration() const override;
    controller_interface::return_type update(const rclcpp::Time &time, const rclcpp::Duration &period) override;

private:
    std::vector<std::string> state_names_, command_names_;
    std::vector<double> target_;
    controller_filter filter_{};
    double before_[controller_STATES]{}, command_[controller_COMMANDS]{}, phase_before_{};
    double step_ = 0.0;
    int steps_ = 0;
};

}  // namespace stepgap_example
