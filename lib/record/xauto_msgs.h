// SPDX-License-Identifier: Apache-2.0
// The ROS 2 type that a recorded message of an app has: xauto_msgs/msg/Message (docs/interop.md) in CDR,
// with its definition beside it. So a program that knows nothing of XAuto shows and plays it.
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

/// The topic of a recording that an app's topic `name` becomes: "/name", as ROS 2 has it.
[[nodiscard]] Topic app_topic(const std::string& name);
/// Whether messages of `recorded` are those of the app's topic `name`.
[[nodiscard]] bool is_app_topic(const Topic& recorded, const std::string& name);

/// `data`: xauto::Codec's bytes. `stamp_ns`: since the epoch, of the wall clock.
[[nodiscard]] std::vector<std::byte> enclose(std::int64_t stamp_ns, std::uint64_t number,
                                             std::span<const std::byte> data);
/// What the app decodes: of our type the enclosed bytes, of any other the message as it is.
/// kInvalid: it is no such message.
[[nodiscard]] Result<std::span<const std::byte>> enclosed(const Topic& topic,
                                                          std::span<const std::byte> message);

}  // namespace xauto::record
