// SPDX-License-Identifier: Apache-2.0
// A program that knows nothing of XAuto, only ROS 2's type diagnostic_msgs/msg/DiagnosticArray, as
// Cyclone's own compiler makes it (tests/unit/messages/cyclone/ros_types.idl), for
// tests/integration/monitor_test.py. Prints each message of /diagnostics as a line of JSON, "ready" when it
// has found a publisher; ends when it is killed.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>

#include <dds/dds.h>

#include "ros_types.h"

namespace {

std::string quoted(const char* text) {
  std::string out = "\"";
  for (const char* c = text; *c != '\0'; ++c) {
    char code[8];
    std::snprintf(code, sizeof code, "\\u%04x", static_cast<unsigned char>(*c));
    const bool plain = static_cast<unsigned char>(*c) >= 0x20 && *c != '"' && *c != '\\';
    out += plain ? std::string(1, *c) : std::string(code);
  }
  return out + "\"";
}

std::string as_json(const diagnostic_msgs_msg_dds__DiagnosticArray_& array) {
  std::string out = "{\"stamp\": " + std::to_string(array.header_.stamp_.sec_) + ", \"status\": [";
  for (std::uint32_t i = 0; i < array.status_._length; ++i) {
    const diagnostic_msgs_msg_dds__DiagnosticStatus_& status = array.status_._buffer[i];
    out += std::string(i == 0 ? "" : ", ") + "{\"level\": " + std::to_string(status.level_) +
           ", \"name\": " + quoted(status.name_) + ", \"message\": " + quoted(status.message_) +
           ", \"hardware_id\": " + quoted(status.hardware_id_) + ", \"values\": {";
    for (std::uint32_t v = 0; v < status.values_._length; ++v)
      out += std::string(v == 0 ? "" : ", ") + quoted(status.values_._buffer[v].key_) + ": " +
             quoted(status.values_._buffer[v].value_);
    out += "}}";
  }
  return out + "]}";
}

}  // namespace

int main() {
  const char* domain = std::getenv("ROS_DOMAIN_ID");
  const dds_entity_t participant = dds_create_participant(
      domain == nullptr ? DDS_DOMAIN_DEFAULT : static_cast<dds_domainid_t>(std::atoi(domain)),
      nullptr, nullptr);
  const dds_entity_t topic =
      dds_create_topic(participant, &diagnostic_msgs_msg_dds__DiagnosticArray__desc,
                       "rt/diagnostics", nullptr, nullptr);
  dds_qos_t* qos = dds_create_qos();  // ROS 2's default: reliable, the last 10
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
  const dds_entity_t reader = dds_create_reader(participant, topic, qos, nullptr);
  dds_delete_qos(qos);
  if (reader < 0) {
    std::fprintf(stderr, "diagnostics_peer: %s\n", dds_strretcode(reader));
    return 1;
  }
  for (bool matched = false;; std::this_thread::sleep_for(std::chrono::milliseconds(2))) {
    dds_subscription_matched_status_t status{};
    dds_get_subscription_matched_status(reader, &status);
    if (!matched && status.current_count > 0) {
      matched = true;
      std::puts("\"ready\"");
    }
    void* samples[1] = {nullptr};
    dds_sample_info_t info;
    if (dds_take(reader, samples, &info, 1, 1) == 1) {
      if (info.valid_data)
        std::puts(
            as_json(*static_cast<diagnostic_msgs_msg_dds__DiagnosticArray_*>(samples[0])).c_str());
      dds_return_loan(reader, samples, 1);
    }
    std::fflush(stdout);
  }
}
