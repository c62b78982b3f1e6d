// SPDX-License-Identifier: Apache-2.0
// The thread of a process that takes messages of other processes out of its queues and hands them
// to the channels inside.
#pragma once

#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "transport/doorbell.h"
#include "transport/shm_topic.h"

namespace xauto::transport {

/// Threads: any. Inputs with `blank` are read without their messages.
class Receiver {
 public:
  using Deliver = std::function<void(const detail::Envelope&)>;

  explicit Receiver(Doorbell& doorbell) : doorbell_(doorbell) {}
  ~Receiver() { stop(); }
  Receiver(const Receiver&) = delete;
  Receiver& operator=(const Receiver&) = delete;

  /// `tag` names what `remove` takes away again.
  void add(int tag, std::shared_ptr<Subscriber> subscriber, bool blank, Deliver deliver);
  /// Returns when none of these inputs is being delivered any more. Not from `deliver`.
  void remove(int tag);
  /// `enter`: called once on the new thread. kUnavailable: there is none.
  [[nodiscard]] Status start(std::function<void()> enter);
  void stop();
  /// Nothing waits in any queue, and nothing is being delivered.
  [[nodiscard]] bool idle() const;
  /// Messages lost in full queues.
  [[nodiscard]] std::uint64_t lost() const;

 private:
  struct Input {
    int tag;
    std::shared_ptr<Subscriber> subscriber;
    ShmSubscriber* shared_memory;  ///< the same, if it is one: asked without a virtual call
    bool blank;
    Deliver deliver;
  };
  bool pass();
  static std::optional<detail::Envelope> take(const Input& input);
  void run();

  Doorbell& doorbell_;
  mutable PiMutex mutex_;  ///< held during a pass
  std::vector<Input> inputs_ XAUTO_GUARDED_BY(mutex_);
  std::atomic<bool> stop_{false};
  std::uint64_t lost_before_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< of inputs that were removed
  std::thread thread_;
};

}  // namespace xauto::transport
