// SPDX-License-Identifier: Apache-2.0
// Sources that are pushed into (xauto/source.h): where a message waits between the driver's thread
// and the one that releases it. Each run opens the app's inlets, and closes them at its end.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <xauto/source.h>

#include "base/pi_mutex.h"
#include "base/thread_safety.h"

namespace xauto::detail {

struct AppSpecErased;

/// Threads: any.
class Inlet {
 public:
  /// Only a run in lockstep lets messages wait.
  static constexpr std::size_t kMaxWaiting = 256;
  enum class Keep : std::uint8_t {
    kAll,
    kNewest,  ///< the profiler takes what there is when it is ready
    kNone,    ///< a recording comes instead
  };
  struct Waiting {
    std::shared_ptr<const void> message;
    std::int64_t at_ns = 0;  ///< CLOCK_MONOTONIC, of the push
    bool urgent = false;
  };
  /// What becomes of a push that says it is urgent.
  enum class Urgent : std::uint8_t {
    kTaken,
    kOrdinary,  ///< nobody schedules by keys, and nobody claims to
    kRefused,
  };
  /// What came closer together than was declared, in one run.
  struct Early {
    std::uint64_t count = 0, of = 0;
    std::int64_t shortest_ns = 0;
  };

  Inlet(std::string topic, std::int64_t distance_ns)
      : topic_(std::move(topic)), distance_ns_(distance_ns) {}
  [[nodiscard]] Status push(std::shared_ptr<const void> message, bool urgent = false);

  // The run's side. `bell` is advanced at every push, until `close`.
  void open(std::atomic<std::uint32_t>& bell, Keep keep);
  void take_urgent(Urgent how);  ///< kOrdinary at `open`
  /// Returns how many messages were not taken.
  std::size_t close();
  [[nodiscard]] std::optional<Waiting> take();
  /// When the oldest one came; INT64_MAX: none waits.
  [[nodiscard]] std::int64_t oldest_ns() const;
  [[nodiscard]] Early early() const;

 private:
  const std::string topic_;
  const std::int64_t distance_ns_;
  mutable PiMutex mutex_;
  std::atomic<std::uint32_t>* bell_ XAUTO_GUARDED_BY(mutex_) = nullptr;  ///< null: closed
  Keep keep_ XAUTO_GUARDED_BY(mutex_) = Keep::kAll;
  Urgent urgent_ XAUTO_GUARDED_BY(mutex_) = Urgent::kOrdinary;
  std::deque<Waiting> waiting_ XAUTO_GUARDED_BY(mutex_);
  std::int64_t last_ns_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< of the last push of this run; 0: none
  Early early_ XAUTO_GUARDED_BY(mutex_);
};

/// All inlets of an app, open as long as this lives. Threads: one.
class Inlets {
 public:
  Inlets(const AppSpecErased& app, Inlet::Keep keep);
  ~Inlets();
  Inlets(const Inlets&) = delete;
  Inlets& operator=(const Inlets&) = delete;

  struct Pushed {
    std::size_t source = 0;  ///< index into the app's
    Inlet::Waiting waiting;
  };
  [[nodiscard]] bool any() const { return !inlets_.empty(); }
  /// One more, for a source that is not the program's own to push into. It lives as long as this.
  [[nodiscard]] Inlet& add(std::size_t source, const std::string& topic);
  /// The oldest one of all.
  [[nodiscard]] std::optional<Pushed> take();
  /// Returns when something is pushed, or at `until_ns`, and now and then without a reason.
  /// `seen`: what `pushes` returned before the last look at what there is.
  [[nodiscard]] std::uint32_t pushes() const { return bell_.load(); }
  void wait(std::uint32_t seen, std::int64_t until_ns);
  /// Closes them and tells what was not as declared; a line each.
  [[nodiscard]] std::vector<std::string> close();

 private:
  struct Entry {
    std::size_t source;
    Inlet* inlet;
    std::string topic;
    std::int64_t distance_ns;
  };
  OneThread thread_;
  std::vector<Entry> inlets_;
  std::vector<std::unique_ptr<Inlet>> added_;
  std::atomic<std::uint32_t> bell_{0};
};

}  // namespace xauto::detail
