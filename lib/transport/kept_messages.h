// SPDX-License-Identifier: Apache-2.0
// Decoded messages whose memory is used again. A message of 6 MB is 1 500 pages: without this they are
// mapped, at a page fault each, for every message, and unmapped by whoever lets go of it, which may be
// a real-time thread.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "base/pi_mutex.h"
#include "base/thread_safety.h"
#include "model/message.h"

namespace xauto::transport {

/// Of one topic. Threads: any. Held by std::shared_ptr: messages may outlive the topic.
class KeptMessages : public std::enable_shared_from_this<KeptMessages> {
 public:
  static constexpr std::size_t kLeastBytes = std::size_t{64} << 10;  ///< smaller ones are not kept
  static constexpr std::size_t kMost = 4;  ///< that nobody has, beside those that are in use

  KeptMessages() { free_.reserve(kMost); }

  /// As spec.decode; throws what that throws.
  [[nodiscard]] std::shared_ptr<const void> decode(const detail::TopicSpec& spec,
                                                   std::span<const std::byte> bytes) {
    if (spec.decode_into == nullptr || bytes.size() < kLeastBytes) return spec.decode(bytes);
    std::shared_ptr<void> message = take();
    if (message != nullptr)
      spec.decode_into(message.get(), bytes);
    else
      message = std::const_pointer_cast<void>(spec.decode(bytes));
    const void* at = message.get();
    return {at, [home = shared_from_this(), message = std::move(message)](const void*) mutable {
              home->give(std::move(message));
            }};
  }

 private:
  [[nodiscard]] std::shared_ptr<void> take() {
    const Guard lock(mutex_);
    if (free_.empty()) return nullptr;
    std::shared_ptr<void> message = std::move(free_.back());
    free_.pop_back();
    return message;
  }
  void give(std::shared_ptr<void> message) {
    const Guard lock(mutex_);
    if (free_.size() < kMost) free_.push_back(std::move(message));
  }

  PiMutex mutex_;
  std::vector<std::shared_ptr<void>> free_ XAUTO_GUARDED_BY(mutex_);
};

}  // namespace xauto::transport
