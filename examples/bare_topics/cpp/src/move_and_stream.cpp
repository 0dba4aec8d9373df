// Enable a CRTK arm, move one joint a little, then stream to it: rclcpp and topics alone.
//
// Start a device in one terminal, and this program in another one:
//
//   crtk-driver ur --ns /ur5 --sim --set space.speed=0.1
//   ros2 run crtk_bare_topics move_and_stream /ur5

#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <crtk_msgs/msg/operating_state.hpp>
#include <crtk_msgs/msg/string_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/empty.hpp>
#include <std_msgs/msg/string.hpp>

using crtk_msgs::msg::OperatingState;
using crtk_msgs::msg::StringStamped;
using sensor_msgs::msg::JointState;
using namespace std::chrono_literals;

constexpr double step = 0.05;    // how far the last joint moves, in rad
constexpr double period = 0.01;  // between two setpoints; the device holds when 0.1 s pass without one

class Arm : public rclcpp::Node {
 public:
  explicit Arm(const std::string& name_space) : Node("bare_topics", name_space) {
    const rclcpp::QoS absolute(1);  // reliable and volatile, as rclcpp has it: the newest one counts
    const rclcpp::QoS events(10);
    const rclcpp::QoS latched = rclcpp::QoS(10).transient_local();
    state_subscription_ = create_subscription<OperatingState>(
        "operating_state", latched, [this](const OperatingState& message) {
          state_ = message.state;
          is_busy_ = message.is_busy;
          was_busy_ = was_busy_ || message.is_busy;
        });
    measured_subscription_ = create_subscription<JointState>(
        "measured_js", events, [this](const JointState& message) { keep(message, measured_); });
    setpoint_subscription_ = create_subscription<JointState>(
        "setpoint_js", events, [this](const JointState& message) { keep(message, setpoint_); });
    // The topic is latched. This subscription is volatile, so older refusals stay out.
    refusal_subscription_ = create_subscription<std_msgs::msg::String>(
        "refusals", events,
        [](const std_msgs::msg::String& message) {
          throw std::runtime_error("refused: " + message.data);
        });
    state_command_ = create_publisher<StringStamped>("state_command", events);
    move_jp_ = create_publisher<JointState>("move_jp", absolute);
    servo_jp_ = create_publisher<JointState>("servo_jp", absolute);
    hold_ = create_publisher<std_msgs::msg::Empty>("hold", events);
  }

  // A message to nobody is lost: wait until both directions are connected.
  void find() {
    wait("finding a CRTK device", [this] {
      return !state_.empty() && !measured_.empty() &&
             state_command_->get_subscription_count() > 0 &&
             move_jp_->get_subscription_count() > 0 &&
             servo_jp_->get_subscription_count() > 0 && hold_->get_subscription_count() > 0;
    });
  }

  void reach(const std::string& command, const std::string& state) {
    StringStamped message;
    message.string = command;
    state_command_->publish(message);
    wait(state, [&] { return state_ == state; });
  }

  double last_joint() {
    measured_.clear();
    wait("a sample", [this] { return !measured_.empty(); });
    return measured_.back();
  }

  // The device is busy once for every move, even for one that is there already.
  void move_last_joint(double way) {
    wait("a valid setpoint", [this] { return !setpoint_.empty(); });
    JointState goal;
    goal.position = setpoint_;
    goal.position.back() += way;
    was_busy_ = false;
    move_jp_->publish(goal);
    wait("the end of the move", [this] { return was_busy_ && !is_busy_; }, 30s);
  }

  void stream(double amplitude, double seconds) {
    const std::vector<double> start = setpoint_;
    const auto begin = std::chrono::steady_clock::now();
    const int steps = static_cast<int>(std::lround(seconds / period));
    for (int i = 1; i <= steps && rclcpp::ok(); ++i) {
      const double share = (1.0 - std::cos(2.0 * M_PI * i * period / seconds)) / 2.0;
      JointState setpoint;
      setpoint.position = start;
      setpoint.position.back() += amplitude * share;
      servo_jp_->publish(setpoint);
      rclcpp::spin_some(shared_from_this());
      std::this_thread::sleep_until(begin + i * std::chrono::duration<double>(period));
    }
    hold();
  }

  void hold() { hold_->publish(std_msgs::msg::Empty()); }

 private:
  // Stamp 0 means that the value is not valid now.
  static void keep(const JointState& message, std::vector<double>& value) {
    if (message.header.stamp.sec != 0) {
      value = message.position;
    }
  }

  void wait(const std::string& what, const std::function<bool()>& condition,
            std::chrono::seconds longest = 10s) {
    const auto end = std::chrono::steady_clock::now() + longest;
    while (!condition()) {
      if (!rclcpp::ok() || std::chrono::steady_clock::now() > end) {
        throw std::runtime_error(what + " did not happen in time");
      }
      rclcpp::spin_some(shared_from_this());
      std::this_thread::sleep_for(1ms);
    }
  }

  std::string state_;
  bool is_busy_ = false;
  bool was_busy_ = false;
  std::vector<double> measured_;
  std::vector<double> setpoint_;
  rclcpp::Subscription<OperatingState>::SharedPtr state_subscription_;
  rclcpp::Subscription<JointState>::SharedPtr measured_subscription_;
  rclcpp::Subscription<JointState>::SharedPtr setpoint_subscription_;
  rclcpp::Subscription<std_msgs::msg::String>::SharedPtr refusal_subscription_;
  rclcpp::Publisher<StringStamped>::SharedPtr state_command_;
  rclcpp::Publisher<JointState>::SharedPtr move_jp_;
  rclcpp::Publisher<JointState>::SharedPtr servo_jp_;
  rclcpp::Publisher<std_msgs::msg::Empty>::SharedPtr hold_;
};

int main(int argc, char** argv) {
  const std::vector<std::string> arguments = rclcpp::init_and_remove_ros_arguments(argc, argv);
  if (arguments.size() != 2) {
    std::fprintf(stderr, "say the namespace of the device: /ur5\n");
    return 2;
  }
  const auto arm = std::make_shared<Arm>(arguments[1]);
  int code = 0;
  try {
    arm->find();
    arm->reach("enable", "ENABLED");
    const double before = arm->last_joint();
    arm->move_last_joint(step);
    std::printf("the last joint moved by %.3f rad\n", arm->last_joint() - before);
    arm->stream(step, 2.0);
    arm->reach("disable", "DISABLED");
    std::printf("it is DISABLED again\n");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s: %s\n", arguments[1].c_str(), error.what());
    if (rclcpp::ok()) {
      arm->hold();
    }
    code = 1;
  }
  rclcpp::shutdown();
  return code;
}
