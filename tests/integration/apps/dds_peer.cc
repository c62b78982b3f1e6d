// SPDX-License-Identifier: Apache-2.0
// A program that knows nothing of XAuto, only the DDS type (xauto_msgs.idl), for
// tests/integration/dds_test.py. Prints "ready" when it has found its counterpart.
//
//   dds_peer hear TOPIC FILE SECONDS     each message's number, age in us, size and bytes in hex;
//                                        ends two seconds after the last one
//   dds_peer feed TOPIC FILE PERIOD_US   the messages of such a file, in order, once there is a
//                                        reader
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include <dds/dds.h>

#include "xauto_msgs.h"

namespace {

using Message = xauto_msgs_msg_dds__Message_;
using Clock = std::chrono::steady_clock;

std::int64_t wall_us() {
  return std::chrono::duration_cast<std::chrono::microseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

int fail(const char* what, dds_return_t code) {
  std::fprintf(stderr, "dds_peer: %s: %s\n", what, dds_strretcode(code));
  return 1;
}

int hear(dds_entity_t reader, const std::string& path, double seconds) {
  std::ofstream file(path);
  bool matched = false;
  auto last = Clock::now() + std::chrono::milliseconds(static_cast<int>(seconds * 1000));
  while (Clock::now() < last) {
    dds_subscription_matched_status_t status{};
    dds_get_subscription_matched_status(reader, &status);
    if (!matched && status.current_count > 0) {
      matched = true;
      std::puts("ready");
      std::fflush(stdout);
    }
    void* samples[1] = {nullptr};
    dds_sample_info_t info;
    if (dds_take(reader, samples, &info, 1, 1) != 1) {
      std::this_thread::sleep_for(std::chrono::microseconds(500));
      continue;
    }
    if (info.valid_data) {
      const auto& m = *static_cast<const Message*>(samples[0]);
      const std::int64_t age = wall_us() - (std::int64_t{m.stamp_.sec_} * 1'000'000 +
                                            static_cast<std::int64_t>(m.stamp_.nanosec_ / 1000));
      file << m.number_ << ' ' << age << ' ' << m.data_._length << ' ';
      const char* digits = "0123456789abcdef";
      for (std::uint32_t i = 0; i < m.data_._length; ++i)
        file << digits[m.data_._buffer[i] >> 4] << digits[m.data_._buffer[i] & 15];
      file << std::endl;  // somebody waits for it
      last = Clock::now() + std::chrono::seconds(2);
    }
    dds_return_loan(reader, samples, 1);
  }
  return 0;
}

int feed(dds_entity_t writer, const std::string& path, long period_us) {
  for (dds_publication_matched_status_t status{}; status.current_count == 0;
       std::this_thread::sleep_for(std::chrono::milliseconds(2)))
    dds_get_publication_matched_status(writer, &status);
  std::puts("ready");
  std::fflush(stdout);
  std::ifstream file(path);
  unsigned long long number;
  long long age;
  std::size_t size;
  std::string hex;
  auto due = Clock::now();
  while (file >> number >> age >> size) {
    if (size > 0) file >> hex;
    std::vector<unsigned char> bytes(size);
    for (std::size_t i = 0; i < size; ++i)
      bytes[i] = static_cast<unsigned char>(std::stoi(hex.substr(2 * i, 2), nullptr, 16));
    Message m{};
    const std::int64_t now = wall_us();
    m.stamp_.sec_ = static_cast<std::int32_t>(now / 1'000'000);
    m.stamp_.nanosec_ = static_cast<std::uint32_t>(now % 1'000'000 * 1000);
    m.number_ = number;
    m.data_._buffer = bytes.data();
    m.data_._length = m.data_._maximum = static_cast<std::uint32_t>(size);
    if (const dds_return_t code = dds_write(writer, &m); code != 0) return fail("write", code);
    due += std::chrono::microseconds(period_us);
    std::this_thread::sleep_until(due);
  }
  dds_wait_for_acks(writer, DDS_SECS(1));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  const std::string verb = argv[1];
  const dds_entity_t participant = dds_create_participant(
      static_cast<dds_domainid_t>(std::atoi(std::getenv("ROS_DOMAIN_ID"))), nullptr, nullptr);
  if (participant < 0) return fail("participant", participant);
  const dds_entity_t topic =
      dds_create_topic(participant, &xauto_msgs_msg_dds__Message__desc, argv[2], nullptr, nullptr);
  if (topic < 0) return fail("topic", topic);
  dds_qos_t* qos = dds_create_qos();  // ROS 2's default: reliable, the last 10
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
  const dds_entity_t end = verb == "hear" ? dds_create_reader(participant, topic, qos, nullptr)
                                          : dds_create_writer(participant, topic, qos, nullptr);
  dds_delete_qos(qos);
  if (end < 0) return fail(argv[1], end);
  const int status = verb == "hear" ? hear(end, argv[3], std::atof(argv[4]))
                                    : feed(end, argv[3], std::atol(argv[4]));
  dds_delete(participant);
  return status;
}
