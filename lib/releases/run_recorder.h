// SPDX-License-Identifier: Apache-2.0
// The recording that a run makes: what its sources release, and if it is asked for what modules publish.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "grid/context.h"
#include "record/background.h"
#include "runtime/wiring.h"
#include "session/run_report.h"

namespace xauto::runtime {

/// Threads: `record` any, the others one.
class RunRecorder {
 public:
  /// Null where no recording is asked for.
  [[nodiscard]] static Result<std::unique_ptr<RunRecorder>> open(const Context& context,
                                                                 Wiring& wiring);
  /// The first failure ends the recording, not the run; `close` tells. In lockstep nothing is in
  /// real time, so there nothing need be lost.
  void record(std::size_t topic, std::int64_t now_ns, std::uint64_t sequence, const void* message);
  /// With an account of `releases` (of an app of one rate). Nothing is published any more, or it is not recorded.
  /// Returns why it is not whole; empty: it is.
  [[nodiscard]] std::string close(const std::vector<ReleaseRecord>& releases);
  /// What is not recorded, for people.
  [[nodiscard]] const std::vector<std::string>& notes() const { return notes_; }

 private:
  explicit RunRecorder(const Context& context) : context_(context) {}
  [[nodiscard]] Status record_topic(record::Recorder& recorder, Wiring& wiring, std::size_t topic);

  const Context& context_;
  std::unique_ptr<record::BackgroundRecorder> recorder_;
  std::vector<std::size_t> recorded_topic_;  ///< [topic] -> the recorder's index
  std::size_t releases_topic_ = 0;           ///< of the accounts
  std::int64_t wall_offset_ns_ = 0;          ///< the wall clock's time minus now_ns()
  std::vector<std::string> notes_;
  PiMutex mutex_;
  std::string error_ XAUTO_GUARDED_BY(mutex_);
  std::atomic<bool> records_{false};  ///< open, and nothing has gone wrong
};

}  // namespace xauto::runtime
