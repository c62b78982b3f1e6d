// SPDX-License-Identifier: Apache-2.0
// Records on a thread of its own: whoever releases a sensor never waits for a compressor or a disk.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include <xauto/result.h>

#include "base/pi_mutex.h"
#include "record/recording.h"

namespace xauto::record {

/// Threads: any, but `close` and the destructor one.
class BackgroundRecorder {
 public:
  /// So much may wait to be written: two seconds of three cameras at 30 Hz and 1.4 MB.
  static constexpr std::size_t kQueueBytes = 256u << 20;
  /// What has waited for so long is flushed, whether more comes or not: what a power cut may lose.
  static constexpr std::int64_t kFlushNs = 1'000'000'000;

  /// `recorder`: with its topics. kUnavailable: there is no thread for it.
  [[nodiscard]] static Result<std::unique_ptr<BackgroundRecorder>> start(
      Recorder recorder, std::size_t queue_bytes = kQueueBytes);
  ~BackgroundRecorder();
  BackgroundRecorder(const BackgroundRecorder&) = delete;
  BackgroundRecorder& operator=(const BackgroundRecorder&) = delete;

  enum class IfFull { kLose, kWait };
  /// A message of an app, as xauto_msgs.h encloses it. Where there is no room it is lost and counted,
  /// or the caller waits. After the first failure nothing is recorded any more.
  void write_enclosed(std::size_t topic, std::int64_t timestamp_ns, std::uint64_t number,
                      std::vector<std::byte> data, IfFull if_full);
  /// A message as it is.
  void write(std::size_t topic, std::int64_t timestamp_ns, std::vector<std::byte> data,
             IfFull if_full = IfFull::kWait);
  /// Writes what waits and closes the file. What went wrong first; or that messages were lost.
  [[nodiscard]] Status close();

 private:
  BackgroundRecorder(Recorder recorder, std::size_t queue_bytes);
  struct Item {
    std::size_t topic = 0;
    std::int64_t timestamp_ns = 0;
    std::optional<std::uint64_t> number;  ///< to be enclosed, with it
    std::vector<std::byte> data;
  };
  void put(Item item, IfFull if_full);
  void run();
  void write(Item item);
  void flush_if_due();
  void take(Status done);
  static void ring(std::atomic<std::uint32_t>& word);

  const std::size_t queue_bytes_;
  Recorder recorder_;  ///< the thread's, while it runs
  PiMutex mutex_;
  std::deque<Item> queue_ XAUTO_GUARDED_BY(mutex_);
  std::size_t bytes_ XAUTO_GUARDED_BY(mutex_) = 0;  ///< that wait, or are being written
  std::uint64_t lost_ XAUTO_GUARDED_BY(mutex_) = 0;
  bool closing_ XAUTO_GUARDED_BY(mutex_) = false;
  std::atomic<bool> failed_{false};
  std::atomic<std::uint32_t> filled_{0}, emptied_{0};  ///< futexes
  Status status_;                                      ///< the thread's, while it runs
  std::int64_t unflushed_since_ns_ = 0;                ///< likewise; 0: all is in the file
  std::thread thread_;
};

}  // namespace xauto::record
