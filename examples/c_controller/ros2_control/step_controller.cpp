// NOT TESTED: no ROS 2 was available when it was written.
#include "step_controller.hpp"

#include <cmath>

#include "pluginlib/class_list_macros.hpp"

namespace stepgap_example {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

CallbackReturn StepController::on_init()
{
    auto_declare<std::vector<std::string>>("state_interfaces", {});    // the state, the phase, the number of the section
    auto_declare<std::vector<std::string>>("command_interfaces", {});  // the command
    auto_declare<std::vector<double>>("target", {});                   // of the next section
    return CallbackReturn::SUCCESS;
}

CallbackReturn StepController::on_configure(const rclcpp_lifecycle::State &)
{
    state_names_ = get_node()->get_parameter("state_interfaces").as_string_array();
    command_names_ = get_node()->get_parameter("command_interfaces").as_string_array();
    target_ = get_node()->get_parameter("target").as_double_array();
    const bool fits = state_names_.size() == controller_STATES + 2 && command_names_.size() == controller_COMMANDS &&
                      target_.size() == controller_STATES;
    if (!fits)
        RCLCPP_ERROR(get_node()->get_logger(), "%d state interfaces, %d command interfaces and %d targets are needed",
                     controller_STATES + 2, controller_COMMANDS, controller_STATES);
    return fits ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
}

InterfaceConfiguration StepController::command_interface_configuration() const
{
    return {interface_configuration_type::INDIVIDUAL, command_names_};
}

InterfaceConfiguration StepController::state_interface_configuration() const
{
    return {interface_configuration_type::INDIVIDUAL, state_names_};
}

CallbackReturn StepController::on_activate(const rclcpp_lifecycle::State &)
{
    controller_filter_init(&filter_);
    steps_ = 0;
    step_ = state_interfaces_[controller_STATES + 1].get_value();
    return CallbackReturn::SUCCESS;
}

CallbackReturn StepController::on_deactivate(const rclcpp_lifecycle::State &)
{
    return CallbackReturn::SUCCESS;
}

return_type StepController::update(const rclcpp::Time &, const rclcpp::Duration &)
{
    const double step = state_interfaces_[controller_STATES + 1].get_value();
    if (!(step > step_))  // also if it is not a number
        return return_type::OK;
    double state[controller_STATES], target[controller_STATES];
    for (int i = 0; i < controller_STATES; i++) {
        state[i] = state_interfaces_[i].get_value();
        target[i] = target_[i];
    }
    const auto phase = state_interfaces_[controller_STATES].get_value();
    if (steps_ > 0 && step == step_ + 1)  // a section that was missed teaches nothing
        controller_filter_update(&filter_, before_, command_, state, phase_before_);
    const int status = controller_plan(&filter_, state, target, steps_ > 0 ? command_ : nullptr, phase, command_, nullptr,
                                       nullptr);
    for (int i = 0; i < controller_STATES; i++)
        before_[i] = state[i];
    phase_before_ = phase;
    step_ = step;
    steps_++;
    for (int i = 0; i < controller_COMMANDS; i++)
        command_interfaces_[i].set_value(static_cast<double>(command_[i]));
    return status == controller_OK ? return_type::OK : return_type::ERROR;
}

}  // namespace stepgap_example

PLUGINLIB_EXPORT_CLASS(stepgap_example::StepController, controller_interface::ControllerInterface)
