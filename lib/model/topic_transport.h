// SPDX-License-Identifier: Apache-2.0
// Where else a topic goes, beside the app's own processes, and with which quality of service: the
// value of "transport" in deployment.json. The words are those of DDS and ROS 2.
#pragma once

#include <cstdint>
#include <optional>

namespace xauto {

enum class Reliability : std::uint8_t {
  kReliable,    ///< what is lost on the way is sent again
  kBestEffort,  ///< it is not
};
enum class Durability : std::uint8_t {
  kVolatile,        ///< who comes late hears what comes then
  kTransientLocal,  ///< ... and the last messages before
};
/// Of ROS 2: what holds where nothing else is said.
enum class QosProfile : std::uint8_t {
  kDefault,     ///< reliable, volatile, depth 10
  kSensorData,  ///< best effort, volatile, depth 5
};

struct TopicQos {
  std::optional<QosProfile> profile = {};
  std::optional<Reliability> reliability = {};
  std::optional<Durability> durability = {};
  std::optional<std::int64_t> depth = {};  ///< of what goes out
  std::optional<std::int64_t> deadline_us = {};
  bool operator==(const TopicQos&) const = default;

  /// With the profile's values where nothing else is said, and without the profile.
  [[nodiscard]] TopicQos resolved() const;
};

inline TopicQos TopicQos::resolved() const {
  TopicQos q = *this;
  q.profile.reset();
  if (!profile) return q;
  const bool sensor = profile == QosProfile::kSensorData;
  if (!q.reliability) q.reliability = sensor ? Reliability::kBestEffort : Reliability::kReliable;
  if (!q.durability) q.durability = Durability::kVolatile;
  if (!q.depth) q.depth = sensor ? 5 : 10;
  return q;
}

struct TopicTransport {
  bool feed = false;  ///< a source's topic: its messages come from there; else they go there, too
  TopicQos qos = {};
  bool operator==(const TopicTransport&) const = default;
};

inline constexpr std::int64_t kMaxQosDepth = 256;

}  // namespace xauto
