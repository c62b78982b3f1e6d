// SPDX-License-Identifier: Apache-2.0
// The call to a backend that suspends or resumes, which may be the app's, and may never return.
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>

namespace xauto::runtime {

struct Placed;

/// Threads: `begin` and `end` the management thread, `stuck` one, `now` any.
class CallWatch {
 public:
  enum class Call : std::uint8_t { kNone, kSuspend, kResume };
  struct Seen {
    Call call = Call::kNone;
    const Placed* placed = nullptr;  ///< for whom
  };
  void begin(Call call, const Placed& placed, std::int64_t now_ns) {
    placed_.store(&placed);
    since_ns_.store(now_ns);
    call_.store(call);
  }
  void end() { call_.store(Call::kNone); }
  [[nodiscard]] Seen now() const { return {call_.load(), placed_.load()}; }
  /// One that has not returned for `patience_ns`, each once.
  [[nodiscard]] std::optional<Seen> stuck(std::int64_t now_ns, std::int64_t patience_ns) {
    const Call call = call_.load();
    const std::int64_t since_ns = since_ns_.load();
    if (call == Call::kNone || since_ns == told_ns_ || now_ns - since_ns <= patience_ns)
      return std::nullopt;
    told_ns_ = since_ns;
    return Seen{call, placed_.load()};
  }

 private:
  std::atomic<Call> call_{Call::kNone};
  std::atomic<const Placed*> placed_{nullptr};
  std::atomic<std::int64_t> since_ns_{0};
  std::int64_t told_ns_ = 0;  ///< of the thread of `stuck`: the last one that was began then
};

}  // namespace xauto::runtime
