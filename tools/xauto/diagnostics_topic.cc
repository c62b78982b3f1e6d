// SPDX-License-Identifier: Apache-2.0
#include "xauto/diagnostics_topic.h"

#include <ctime>

#include <diagnostic_msgs/msg/diagnostic_array.h>

#include "base/clock.h"

namespace xauto::cli {
namespace {

using diagnostic_msgs::msg::DiagnosticArray;
using diagnostic_msgs::msg::DiagnosticStatus;
static_assert(static_cast<std::uint8_t>(Level::kOk) == DiagnosticStatus::OK &&
              static_cast<std::uint8_t>(Level::kWarn) == DiagnosticStatus::WARN &&
              static_cast<std::uint8_t>(Level::kError) == DiagnosticStatus::ERROR &&
              static_cast<std::uint8_t>(Level::kStale) == DiagnosticStatus::STALE);

}  // namespace

Result<DiagnosticsTopic> DiagnosticsTopic::open() {
  const auto spec = detail::topic_spec(Topic<DiagnosticArray>("diagnostics"));
  DiagnosticsTopic topic;
  transport::BridgeOptions options;
  options.largest_bytes = spec->max_bytes;
  XAUTO_ASSIGN(options.domain, transport::ros_domain());
  XAUTO_ASSIGN(topic.bridge_, transport::open_bridge("cyclonedds", options));
  XAUTO_ASSIGN(topic.publisher_,
               topic.bridge_->publish(*spec, TopicQos{.profile = QosProfile::kDefault}));
  return topic;
}

void DiagnosticsTopic::publish(const std::vector<Diagnostic>& statuses) {
  thread_.check();
  const auto array = std::make_shared<DiagnosticArray>();
  timespec wall{};
  clock_gettime(CLOCK_REALTIME, &wall);
  array->header.stamp.sec = static_cast<std::int32_t>(wall.tv_sec);
  array->header.stamp.nanosec = static_cast<std::uint32_t>(wall.tv_nsec);
  for (const Diagnostic& d : statuses) {
    DiagnosticStatus& status = array->status.emplace_back();
    status.level = static_cast<std::uint8_t>(d.level);
    status.name = d.name;
    status.message = d.message;
    status.hardware_id = d.hardware_id;
    for (const auto& [key, value] : d.values) status.values.push_back({key, value});
  }
  publisher_->publish({array, now_ns(), number_++});
}

std::vector<std::string> DiagnosticsTopic::close() {
  thread_.check();
  bridge_->stop();
  return bridge_->notes();
}

}  // namespace xauto::cli
