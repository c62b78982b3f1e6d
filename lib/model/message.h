// SPDX-License-Identifier: Apache-2.0
// What include/xauto/topic.h hides: a topic as the library knows it, a message on its way, and what
// an exec is given. An app never sees their layout, so a new field here is no new soname.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <typeindex>
#include <vector>

#include <xauto/buffer.h>
#include <xauto/topic.h>

#include "model/parameter.h"

namespace xauto::detail {

/// Where a message is made so that other processes can read it without a copy. Implemented by the
/// transport.
class MessageMemory {
 public:
  virtual ~MessageMemory() = default;
  /// Room for `bytes`, given back when nobody holds it any more; null: make it on the heap.
  virtual std::shared_ptr<void> loan(std::size_t bytes) = 0;
};

/// Release times by source, of an app whose sources have several periods; 0: not involved.
inline constexpr std::size_t kMaxOrigins = 24;  ///< further sources are known by the oldest only
using Origins = std::array<std::int64_t, kMaxOrigins>;

/// Origin of an envelope without a message: nothing was lost, the module is off in its release's table.
inline constexpr std::int64_t kOffNs = -1;
/// ... nothing was lost: a module skipped it, which was told to while it is not free.
inline constexpr std::int64_t kSkippedNs = -2;

/// A message on its way: shared, never written again once published.
struct Envelope {
  std::shared_ptr<const void> message;  ///< null: dropped upstream, see `Input` and docs/runtime.md
  std::int64_t origin_ns = 0;           ///< CLOCK_MONOTONIC time at which the sensor released it
  std::uint64_t sequence = 0;           ///< number of that release
  std::shared_ptr<const Origins> origins = {};  ///< null where all origins are the same, see Graph
  bool urgent = false;  ///< its sensor marked that release, see docs/runtime.md
};

/// What carries a Buffered from process to process.
struct BufferedType {
  std::size_t info_bytes = 0;
  InfoOf info = nullptr;
  BufferOf buffer = nullptr;
  MakeBuffered make = nullptr;  ///< null: it is no Buffered
};

struct TopicSpec {
  std::string name;
  std::string called = {};  ///< by the program, where a deployment names it otherwise; else empty
  std::type_index type = typeid(void);  ///< void: its name alone was said
  std::string type_name;
  /// Null where the type has no Codec.
  Encode encode = nullptr;
  Decode decode = nullptr;
  DecodeInto decode_into = nullptr;  ///< into a message that there is; null: the type cannot
  /// sizeof(T) of plain data, which other processes read where it lies; 0: it is encoded.
  std::size_t plain_bytes = 0;
  /// Largest encoded message between processes: Codec<T>::kMaxBytes, if it says so.
  std::size_t max_bytes = std::size_t{8} << 20;
  /// Of a Buffered, whose buffer passes by its descriptor.
  BufferedType buffered = {};
  /// Of a type of a .msg or .idl file, whose Codec then writes and reads CDR.
  std::string ros_type = {};     ///< "sensor_msgs/msg/Image"; empty: it is none
  std::string_view schema = {};  ///< its definition as MCAP's "ros2msg"
  /// `encode` without a vector in between; null unless `ros_type` is set.
  EncodedBytes encoded_bytes = nullptr;
  EncodeInto encode_into = nullptr;
  StampNs stamp_ns = nullptr;  ///< of its header, ns since 1970; null: it has none
};

[[nodiscard]] inline bool is_name_alone(const TopicSpec& topic) {
  return topic.type == typeid(void);
}

struct InputData {
  const std::vector<TopicSpec>* topics = nullptr;  ///< inputs, then what is sampled
  std::size_t inputs = 0;                          ///< how many of them are inputs
  std::vector<Envelope> messages;                  ///< by topic
  std::int64_t began_ns = 0;  ///< when the activation began to run; 0: not looked at
  std::int64_t origin_ns = 0;
  std::int64_t due_ns = 0;                 ///< of the XNode that runs; 0: nothing says
  std::int64_t result_due_ns = 0;          ///< of the module's last one
  const std::int64_t* clock_ns = nullptr;  ///< virtual time; null: CLOCK_MONOTONIC
  std::uint64_t sequence = 0;
  std::vector<ParameterNow> parameters;  ///< of the module, since the activation began
};

}  // namespace xauto::detail
