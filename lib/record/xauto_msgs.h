// SPDX-License-Identifier: Apache-2.0
// The ROS 2 types of what is recorded, in CDR, with their definitions beside them: so a program that
// knows nothing of XAuto shows and plays it. A message of an app is a xauto_msgs/msg/Message
// (docs/interop.md), the account of a release a xauto_msgs/msg/Release (docs/formats.md).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <xauto/result.h>

#include "record/recording.h"

namespace xauto::record {

inline constexpr std::string_view kMessageType = "xauto_msgs/msg/Message";

/// The topic of a recording that an app's topic `name` becomes: "/name", as ROS 2 has it. `ros_type`,
/// `schema`: of a type that ROS 2 knows (TopicSpec); its messages are recorded as they are. Else empty.
[[nodiscard]] Topic app_topic(const std::string& name, const std::string& ros_type = {},
                              std::string_view schema = {});
/// Whether messages of `recorded` are those of the app's topic `name`.
[[nodiscard]] bool is_app_topic(const Topic& recorded, const std::string& name);

/// `data`: xauto::Codec's bytes. `stamp_ns`: since the epoch, of the wall clock.
[[nodiscard]] std::vector<std::byte> enclose(std::int64_t stamp_ns, std::uint64_t number,
                                             std::span<const std::byte> data);
/// What the app decodes: of our type the enclosed bytes, of any other the message as it is.
/// kInvalid: it is no such message.
[[nodiscard]] Result<std::span<const std::byte>> enclosed(const Topic& topic,
                                                          std::span<const std::byte> message);

/// The topic of the accounts: "/xauto/releases".
[[nodiscard]] Topic releases_topic();
/// `latency_us`: -1: lost.
[[nodiscard]] std::vector<std::byte> encode_release(std::int64_t stamp_ns, std::uint64_t number,
                                                    std::int64_t latency_us);

}  // namespace xauto::record
