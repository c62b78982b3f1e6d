// SPDX-License-Identifier: Apache-2.0
// Life of a job, step 1: a message lands on a topic and its subscribers are told. Inside a process
// a message is a pointer; it is never copied and never written after it was published.
#pragma once

#include <functional>
#include <vector>

#include "model/message.h"

namespace xauto::transport {

/// Threads: subscribe before the first publish; publish from any thread, subscribers must be able
/// to take that. A subscriber is told on the publishing thread and must not block.
class Channel {
 public:
  using Subscriber = std::function<void(const detail::Envelope&)>;

  void subscribe(Subscriber subscriber) { subscribers_.push_back(std::move(subscriber)); }
  void publish(const detail::Envelope& envelope) const {
    for (const Subscriber& subscriber : subscribers_) subscriber(envelope);
  }

 private:
  std::vector<Subscriber> subscribers_;
};

}  // namespace xauto::transport
